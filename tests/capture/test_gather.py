"""Waits for several cameras at once: no task is left behind."""

from __future__ import annotations

import asyncio

import pytest

from labdaemon.capture.gather import gather_or_cancel, gather_to_completion
from labdaemon.clock import SimulatedClock
from labdaemon.errors import TransportError


class Waits:
    """Waits of different length, some of which fail; remembers how each ended."""

    def __init__(self) -> None:
        self.ended: list[str] = []

    async def wait(self, name: str, seconds: float, *, fails: bool = False) -> str:
        try:
            await asyncio.sleep(seconds)
        except asyncio.CancelledError:
            self.ended.append(f"{name} cancelled")
            raise
        self.ended.append(name)
        if fails:
            raise TransportError("no answer", device=name)
        return name


@pytest.mark.parametrize("gather", [gather_or_cancel, gather_to_completion])
def test_results_come_in_the_order_of_asking(gather) -> None:
    waits = Waits()
    assert SimulatedClock().run(gather([waits.wait("a", 3.0), waits.wait("b", 1.0)])) == ["a", "b"]
    assert waits.ended == ["b", "a"]


def test_the_first_error_ends_the_others_at_once() -> None:
    waits, clock = Waits(), SimulatedClock()
    with pytest.raises(TransportError, match="b: no answer"):
        clock.run(gather_or_cancel([waits.wait("a", 30.0), waits.wait("b", 1.0, fails=True)]))
    assert waits.ended == ["b", "a cancelled"]
    assert clock.monotonic() == pytest.approx(1.0)


def test_an_error_waits_until_all_have_come_to_their_own_end() -> None:
    """A transfer is not cut off because another camera failed."""
    waits, clock = Waits(), SimulatedClock()
    with pytest.raises(TransportError, match="b: no answer"):
        clock.run(gather_to_completion([waits.wait("a", 30.0), waits.wait("b", 1.0, fails=True)]))
    assert waits.ended == ["b", "a"]


def test_who_is_cancelled_leaves_nothing_running() -> None:
    waits, clock = Waits(), SimulatedClock()

    async def scenario() -> None:
        task = asyncio.create_task(gather_or_cancel([waits.wait("a", 30.0), waits.wait("b", 40.0)]))
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert len(asyncio.all_tasks()) == 1

    clock.run(scenario())
    assert sorted(waits.ended) == ["a cancelled", "b cancelled"]


def test_nothing_to_wait_for_is_an_empty_list() -> None:
    for gather in (gather_or_cancel, gather_to_completion):
        assert SimulatedClock().run(gather([])) == []
