"""The bench of the pages, small: its rows are measured, and a figure beyond its goal does not hold."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from labdaemon.bench import page
from labdaemon.bench.page import live_rows, report_rows
from labdaemon.bench.world.row import WorldRow
from labdaemon.testing.browser import browser_program


def test_a_small_report_is_written_timed_and_weighed() -> None:
    took, size = report_rows(captures=6, per_column=2)
    assert took.what == "report of 6 captures of 4 targets: time"
    assert size.holds
    assert 0.01 < float(size.result.split()[0]) < 0.5


def test_a_goal_that_is_missed_ends_with_status_1(monkeypatch: pytest.MonkeyPatch) -> None:
    missed = WorldRow("report", "time", 1, "61 s", "<= 60 s", holds=False)
    monkeypatch.setitem(page.SECTIONS, "report", lambda seed: iter([missed]))
    result = CliRunner().invoke(page.command, ["--section", "report"])
    assert result.exit_code == 1
    assert "| report | time | 1 | 61 s | <= 60 s | NO |" in result.output


@pytest.mark.slow
def test_the_live_page_is_measured_in_a_browser() -> None:
    if browser_program() is None:
        pytest.skip("no chromium is installed")
    rows = {row.what: row for row in live_rows(events=200, envelopes=2)}
    assert rows["page, style and scripts"].holds
    assert rows["requests to other hosts"].result == "0"
    assert rows["elements and listeners meanwhile"].holds
    heap = rows["heap after 20 and after 200 events"].result
    assert 0.5 < float(heap.split()[0]) < 100, "megabytes"
