"""Time as an object that is passed in, so that 72 hours of campaign can run in a minute under test.

`now` is the wall clock and goes into records; `monotonic` measures durations and deadlines and never jumps.
"""

from __future__ import annotations

import asyncio
import time
from datetime import UTC, datetime
from typing import Protocol


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
