"""The guardian's ear: heartbeats from a pipe, however they are cut, and what their lack means."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.guardian import heartbeat_monitor
from labdaemon.guardian.guarded_process import GuardedProcess
from labdaemon.guardian.heartbeat_monitor import LEAVE_S, HeartbeatMonitor, read_setup
from labdaemon.guardian.recipe import PortSetup, StopRecipe, read_message, to_json
from labdaemon.guardian.rescue import RescueOutcome
from labdaemon.guardian.silence_timer import now

RECIPE = StopRecipe("shaker", "/dev/ttyUSB0", PortSetup(), (), None, ())


def setup(**more: Any) -> dict[str, Any]:
    return {
        "daemon": os.getpid(), "recipe": to_json(RECIPE), "silence_s": 1.0, "patience_s": 10.0, "report": None,
        "rig": "lab",
    } | more  # fmt: skip


class FakeProcess(GuardedProcess):
    """A daemon that needs no end."""

    def __init__(self) -> None:
        self.pid, self._file = 4242, None
        self.ended: list[float] = []

    def end(self, patience_s: float) -> bool:
        self.ended.append(patience_s)
        return False


@pytest.fixture(autouse=True)
def no_syslog(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard error is log enough here."""
    monkeypatch.setenv("JOURNAL_STREAM", "8:1")


@pytest.fixture
def monitor() -> HeartbeatMonitor:
    return HeartbeatMonitor(setup(), FakeProcess())


@pytest.fixture
def pipes() -> Iterator[tuple[int, int, int, int]]:
    """Source to read and to write, answers to read and to write."""
    source, to_source = os.pipe()
    from_answers, answers = os.pipe()
    os.set_blocking(answers, False)
    descriptors = [source, to_source, from_answers, answers]
    yield source, to_source, from_answers, answers
    for one in descriptors:
        try:
            os.close(one)
        except OSError:  # the test has closed it already
            continue


def line(**message: Any) -> bytes:
    return json.dumps(message).encode() + b"\n"


def test_heartbeats_are_numbered(monitor: HeartbeatMonitor) -> None:
    assert monitor.feed(line(beat=1, moving=False) + line(beat=2, moving=True), now()) == [1, 2]


@settings(max_examples=30, deadline=None, derandomize=True)
@given(cuts=st.lists(st.integers(0, 200), max_size=6))
def test_a_pipe_may_cut_anywhere(cuts: list[int]) -> None:
    monitor = HeartbeatMonitor(setup(), FakeProcess())
    data = b"".join(line(beat=number, moving=True) for number in range(5))
    places = sorted({min(cut, len(data)) for cut in cuts} | {0, len(data)})
    beats = [beat for a, b in pairwise(places) for beat in monitor.feed(data[a:b], now())]
    assert beats == list(range(5))


@pytest.mark.parametrize("rubbish", [b"\n", b"{\n", b"[1]\n", b"\xff\xfe\n", b'{"beat": "x"}\n', b'{"moving": 1}\n'])
def test_lines_that_say_nothing_are_passed_over(monitor: HeartbeatMonitor, rubbish: bytes) -> None:
    assert monitor.feed(rubbish + line(beat=3, moving=True), now()) == [3]


def test_who_leaves_is_given_longer(monitor: HeartbeatMonitor) -> None:
    monitor.feed(line(leaves=True), now())
    assert monitor.silence_s == LEAVE_S


def test_a_goodbye_ends_it_without_a_rescue(monitor: HeartbeatMonitor, pipes: tuple[int, int, int, int]) -> None:
    source, to_source, _, answers = pipes
    os.write(to_source, line(beat=1, moving=True) + line(bye=True))
    assert monitor.run(source, answers) == 0
    assert isinstance(monitor._guarded, FakeProcess)
    assert monitor._guarded.ended == []


@pytest.mark.parametrize(("is_at_rest", "status"), [(True, 0), (False, 1)])
def test_a_pipe_that_ends_without_a_goodbye_is_a_rescue(
    monitor: HeartbeatMonitor,
    pipes: tuple[int, int, int, int],
    monkeypatch: pytest.MonkeyPatch,
    is_at_rest: bool,
    status: int,
) -> None:
    source, to_source, from_answers, answers = pipes
    rescued = []

    def rescue(recipe: StopRecipe, *_: Any, **options: Any) -> RescueOutcome:
        rescued.append((recipe.device, options["patience_s"]))
        return RescueOutcome(is_at_rest, 2, 0.5, "no answer")

    monkeypatch.setattr(heartbeat_monitor, "rescue", rescue)
    os.write(to_source, line(beat=7, moving=True))
    os.close(to_source)
    assert monitor.run(source, answers) == status
    assert rescued == [("shaker", 10.0)]
    assert read_message(os.read(from_answers, 1000))["heard"] == 7


def test_silence_with_the_table_moving_is_a_rescue(
    pipes: tuple[int, int, int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    source, to_source, _, answers = pipes
    monitor = HeartbeatMonitor(setup(silence_s=0.05), FakeProcess())
    monkeypatch.setattr(heartbeat_monitor, "TICK_S", 0.01)
    monkeypatch.setattr(heartbeat_monitor, "rescue", lambda *_, **__: RescueOutcome(True, 1, 0.1, ""))
    os.write(to_source, line(beat=1, moving=True))
    assert monitor.run(source, answers) == 0
    assert isinstance(monitor._guarded, FakeProcess)
    assert monitor._guarded.ended == [0.0], "a daemon that is silent is given no time"


def test_the_first_line_is_read_alone(pipes: tuple[int, int, int, int]) -> None:
    """What follows in the pipe is heartbeats, which must not be swallowed."""
    source, to_source, _, _ = pipes
    os.write(to_source, line(daemon=1) + line(beat=1))
    assert read_setup(source) == {"daemon": 1}
    assert read_message(os.read(source, 1000)) == {"beat": 1}


def test_a_daemon_that_was_gone_before_it_had_sent_a_line_needs_no_guardian(pipes: tuple[int, int, int, int]) -> None:
    source, to_source, _, _ = pipes
    os.write(to_source, b'{"daemon"')
    os.close(to_source)
    assert read_setup(source) == {}
