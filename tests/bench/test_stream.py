"""The stream bench in small: the table's arithmetic, and a publication of a few events."""

from __future__ import annotations

import random

import pytest
from click.testing import CliRunner

from labdaemon.bench.stream import command as bench
from labdaemon.bench.stream import joiners
from labdaemon.bench.stream.hostile import LINES, _most_lines_a_minute
from labdaemon.bench.stream.options import SECTIONS, StreamOptions, section
from labdaemon.bench.stream.publication import publish
from labdaemon.bench.stream.publisher_child import TARGETS, envelopes
from labdaemon.bench.world.mutations import message
from labdaemon.bench.world.row import WorldRow
from labdaemon.events import parse_event


def test_every_section_has_rows() -> None:
    assert all(callable(section(name)) for name in SECTIONS)


def test_the_envelopes_are_envelopes() -> None:
    first, second = (parse_event(event.json) for event in envelopes(2))
    assert (first.kind, first.seq, second.seq) == ("envelope", 1, 2)
    assert len(first.data.targets) == TARGETS


@pytest.mark.parametrize(("which", "has_keys"), [("bare", False), ("ours", False), ("bare", True), ("ours", True)])
def test_all_events_come_however_many_subscribers_stall(which: str, has_keys: bool) -> None:
    found = publish(which, 5, 2, stalled=1, rounds=2, has_keys=has_keys)
    assert found.events == 10
    assert found.bytes_each > 100_000
    assert found.took_s > 0.0


def test_a_row_that_does_not_hold_is_the_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    for holds, status in ((True, 0), (False, 1)):
        row = WorldRow("throughput", "x", 1, "0.7", ">= 0.5", holds)
        monkeypatch.setattr(bench, "section", lambda name, row=row: lambda options: iter([row]))
        result = CliRunner().invoke(bench.command, ["--section", "throughput"])
        assert result.exit_code == status
        assert "| throughput | x | 1 | 0.7 |" in result.output


def test_lines_of_the_log_are_counted_by_server_and_minute() -> None:
    class Served:
        def log_lines(self) -> list[dict[str, str]]:
            line = {"level": "warning", "logger": "labdaemon.stream.peer_gate", "message": "tcp://a: refused"}
            return [
                line | {"at": "2026-01-01T00:00:01Z"},
                line | {"at": "2026-01-01T00:01:01Z"},
                line | {"at": "2026-01-01T00:01:02Z", "message": "tcp://b: refused"},
                line | {"at": "2026-01-01T00:01:03Z", "level": "info"},
            ]

    assert _most_lines_a_minute(Served()) == 1


def test_hostile_messages_fire_and_stop_nothing() -> None:
    source = random.Random(1)
    for _ in range(300):
        assert b'"method": "capture"' not in message(source)[-1]
    assert not [line for line in LINES if b"TRIG" in line or b"STOP" in line]


def test_late_joiners_in_small(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, few in {"JOINERS": 6, "RESTARTS": 1, "HISTORY_HOURS": 1, "CAPTURE_EACH_S": 1200}.items():
        monkeypatch.setattr(joiners, name, few)
    joined, back, replayed, stopped = joiners.rows(StreamOptions(subscribers=2))
    assert joined.result == "0 gaps"
    assert (back.tries, replayed.tries) == (1, 12)
    assert stopped.what.startswith("stop")
