"""Simulated time: it passes when every task waits, and then at once."""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.clock import SimulatedClock, SystemClock, parse_rfc3339, rfc3339


def test_hours_pass_at_once_and_in_order() -> None:
    clock, order = SimulatedClock(), []

    async def wait(hours: float) -> None:
        await clock.sleep(3600.0 * hours)
        order.append(hours)

    async def scenario() -> None:
        await asyncio.gather(wait(72.0), wait(1.0), wait(24.0))

    began = time.monotonic()
    clock.run(scenario())
    assert order == [1.0, 24.0, 72.0]
    assert clock.monotonic() == pytest.approx(72 * 3600.0)
    assert time.monotonic() - began < 60.0


def test_timeouts_follow_it() -> None:
    clock = SimulatedClock()

    async def scenario() -> None:
        async with asyncio.timeout(10.0):
            await clock.sleep(100.0)

    with pytest.raises(TimeoutError):
        clock.run(scenario())
    assert clock.monotonic() == pytest.approx(10.0)


def test_a_wait_that_nothing_will_end_is_an_error() -> None:
    clock = SimulatedClock()

    async def scenario() -> None:
        await asyncio.Event().wait()

    with pytest.raises(RuntimeError, match="every task waits"):
        clock.run(scenario())


def test_a_person_sets_the_wall_clock_and_intervals_stay() -> None:
    clock = SimulatedClock()
    clock.advance(5.0)
    before = clock.now()
    clock.jump(-3600.0)
    assert clock.now() - before == timedelta(hours=-1)
    assert clock.monotonic() == 5.0


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.datetimes(datetime(1971, 1, 1), datetime(2100, 1, 1)), st.integers(-14 * 60, 14 * 60))
def test_times_are_written_in_utc_and_read_back_exactly(moment: datetime, minutes: int) -> None:
    local = moment.replace(tzinfo=timezone(timedelta(minutes=minutes)))
    text = rfc3339(local)
    assert parse_rfc3339(text) == local
    assert parse_rfc3339(text).utcoffset() == timedelta()
    assert len(text) == len("2026-05-04T10:11:12.123456Z")


def test_written_times_sort_as_text() -> None:
    moments = [datetime(2026, 5, 4, 9, 59, 59, 999999, UTC), datetime(2026, 5, 4, 10, tzinfo=UTC)]
    assert sorted(map(rfc3339, moments)) == list(map(rfc3339, moments))


def test_the_systems_clock_knows_its_zone() -> None:
    clock = SystemClock()
    assert clock.now().utcoffset() is not None
    assert clock.monotonic() <= clock.monotonic()
