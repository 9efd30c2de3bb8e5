"""Time as an object that is passed in, so that 72 hours of campaign can run in a minute under test.

`now` is the wall clock and goes into records; `monotonic` measures durations and deadlines and never jumps.
"""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Coroutine
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class Clock(Protocol):
    """What code that waits or stamps times may ask for."""

    def now(self) -> datetime:
        """Wall-clock time in UTC; may jump."""
        ...

    def monotonic(self) -> float:
        """Seconds since an arbitrary start; never jumps."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Let this much of the clock's own time pass."""
        ...


class SystemClock:
    """The computer's own clock."""

    def now(self) -> datetime:
        return datetime.now(UTC)

    def monotonic(self) -> float:
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


def rfc3339(moment: datetime) -> str:
    """`2026-05-04T10:11:12.123456Z`, the form of every time in files and messages."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def parse_rfc3339(text: str) -> datetime:
    """The time that `rfc3339` wrote."""
    return datetime.fromisoformat(text)


class SimulatedClock:
    """Time that passes only when every task waits, and then at once.

    `run` gives a coroutine an event loop whose timers follow this clock, so `asyncio.sleep`, `asyncio.timeout` and all
    that is built on them need no change. Nothing may wait for another thread: it would wait for no time at all.

    Parameters
    ----------
    start
        Wall-clock time at which `monotonic` is 0.
    """

    def __init__(self, start: datetime = datetime(2026, 5, 4, 18, tzinfo=UTC)) -> None:
        self._start, self._passed_s, self._jumped_s = start, 0.0, 0.0

    def now(self) -> datetime:
        return self._start + timedelta(seconds=self._passed_s + self._jumped_s)

    def monotonic(self) -> float:
        return self._passed_s

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    def jump(self, seconds: float) -> None:
        """Set the wall clock forward (or back), as a person or a time server does; `monotonic` knows nothing of it."""
        self._jumped_s += seconds

    def advance(self, seconds: float) -> None:
        """Let this much time pass."""
        self._passed_s += seconds

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine to its end in simulated time.

        Raises
        ------
        RuntimeError
            Every task waits for something that no timer will bring about.
        """
        with self.runner() as runner:
            return runner.run(coroutine)

    def runner(self) -> asyncio.Runner:
        """Runs several coroutines one after the other; between them no time passes, and no task runs."""
        return asyncio.Runner(loop_factory=lambda: _SimulatedLoop(self))


class _JumpingSelector(selectors.SelectSelector):
    """Instead of waiting for a timer's time to come, lets it come."""

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None:
            raise RuntimeError("every task waits and no timer is set: nothing would ever happen again")
        if timeout > 0:
            self._clock.advance(timeout)
        return super().select(0)


class _SimulatedLoop(asyncio.SelectorEventLoop):
    """An event loop whose time is a clock's."""

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__(_JumpingSelector(clock))
        self._clock = clock

    def time(self) -> float:
        return self._clock.monotonic()
