from __future__ import annotations

import itertools
import logging

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.errors import ConfigError, InterlockError, ServiceFailure, StorageFull, StorageUnavailable
from labdaemon.journal.storage import JournalError
from labdaemon.service.supervise import RestartPolicy, as_failure, supervise


def run(failures: int, rule: RestartPolicy, gap_s: float = 0.0) -> tuple[SimulatedClock, list[float]]:
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
        _, starts = run(4, RestartPolicy(limit=5, first_s=1.0, longest_s=4.0))
    assert [later - earlier for earlier, later in itertools.pairwise(starts)] == [1.0, 2.0, 4.0, 4.0]
    assert len(caplog.records) == 4


def test_what_fails_too_often_is_passed_on():
    with pytest.raises(OSError, match="broken"):
        run(10, RestartPolicy(limit=3))


def test_failures_long_ago_do_not_count():
    _, starts = run(20, RestartPolicy(limit=2, window_s=100.0), gap_s=60.0)
    assert len(starts) == 21


def test_a_disk_that_takes_nothing_is_waited_for_without_a_limit():
    clock, starts = SimulatedClock(), []

    async def part() -> None:
        starts.append(clock.monotonic())
        if len(starts) <= 100:
            raise ExceptionGroup("tasks", [StorageFull("full"), StorageUnavailable("locked")])

    clock.run(supervise("part", part, clock, RestartPolicy(limit=2)))
    assert len(starts) == 101


@pytest.mark.parametrize("error", [JournalError("damaged"), ConfigError("wrong"), InterlockError("moves")])
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_running_service_never_ends_with_status_2(error: Exception, wrapped: bool):
    failure = as_failure(ExceptionGroup("tasks", [ExceptionGroup("more", [error])]) if wrapped else error)
    assert failure.exit_status == 1
    assert str(error) in str(failure)
    assert isinstance(failure, InterlockError | ServiceFailure)
