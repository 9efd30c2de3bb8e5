from __future__ import annotations

import itertools
import logging

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.service.supervise import Restarts, supervise


def run(failures: int, rule: Restarts, gap_s: float = 0.0) -> tuple[SimulatedClock, list[float]]:
    clock, starts = SimulatedClock(), []

    async def part() -> None:
        starts.append(clock.monotonic())
        await clock.sleep(gap_s)
        if len(starts) <= failures:
            raise OSError("broken")

    clock.run(supervise("part", part, clock, rule))
    return clock, starts


def test_it_is_restarted_with_growing_pauses(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.ERROR):
        _, starts = run(4, Restarts(limit=5, first_s=1.0, longest_s=4.0))
    assert [later - earlier for earlier, later in itertools.pairwise(starts)] == [1.0, 2.0, 4.0, 4.0]
    assert len(caplog.records) == 4


def test_what_fails_too_often_is_passed_on():
    with pytest.raises(OSError, match="broken"):
        run(10, Restarts(limit=3))


def test_failures_long_ago_do_not_count():
    _, starts = run(20, Restarts(limit=2, window_s=100.0), gap_s=60.0)
    assert len(starts) == 21
