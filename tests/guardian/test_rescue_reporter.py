"""The guardian's reports: standard error, and a file that the next daemon reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labdaemon.guardian.rescue_reporter import RescueReporter


@pytest.fixture(autouse=True)
def no_syslog(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JOURNAL_STREAM", "8:1")


def test_the_outcome_is_left_for_the_next_daemon(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "guardian.json"
    reporter = RescueReporter("lab", str(file))
    reporter.say("the daemon is gone; stopping shaker")
    reporter.conclude("at rest", {"is_at_rest": True, "tries": 2})
    left = json.loads(file.read_text())
    assert left.pop("at").endswith("Z")
    assert left == {"is_at_rest": True, "tries": 2}
    assert list(tmp_path.iterdir()) == [file]
    assert capfd.readouterr().err.splitlines() == [
        "labdaemon guardian (lab): the daemon is gone; stopping shaker",
        "labdaemon guardian (lab): at rest",
    ]


def test_a_file_that_cannot_be_written_costs_no_stop(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    reporter = RescueReporter("lab", str(tmp_path / "gone" / "guardian.json"))
    reporter.conclude("at rest", {"is_at_rest": True})
    err = capfd.readouterr().err
    assert "cannot be written" in err
    assert "at rest" in err


def test_a_name_that_is_no_utf8_is_written_all_the_same(capfd: pytest.CaptureFixture[str]) -> None:
    RescueReporter("lab", None).conclude("/dev/\udcff does not open", {})
    assert "/dev/? does not open" in capfd.readouterr().err
