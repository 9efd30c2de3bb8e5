"""How long the daemon has been silent, counted only while the guardian itself could have heard it."""

from __future__ import annotations

import time
from typing import NamedTuple

LONGEST_TICK_S = 0.5
"""A tick that took longer shows that the whole machine stood still (a paused virtual machine, a swap storm), not that
the daemon was silent: it counts as this long."""
STANDSTILL_S = 3.0
"""One that took so long was most likely a suspend: some kernels let the monotonic clock run on through it."""
SUSPENDED_S = 0.05
"""A suspend moves the two clocks apart by more than this."""


class ClockReading(NamedTuple):
    """Both clocks at one moment: only ``boot_s`` advances while the machine is suspended."""

    monotonic_s: float
    boot_s: float


def now() -> ClockReading:
    """The present moment."""
    return ClockReading(time.monotonic(), time.clock_gettime(time.CLOCK_BOOTTIME))


class SilenceTimer:
    """Counts the daemon's silence.

    Parameters
    ----------
    began
        Moment from which it counts.

    Attributes
    ----------
    silent_s
        Seconds of silence.
    longest_s
        Longest time between two heartbeats that counted, seconds.
    """

    def __init__(self, began: ClockReading) -> None:
        self._last = self._last_heartbeat = began
        self._may_ask = True
        self.silent_s: float = 0.0
        self.longest_s: float = 0.0

    def tick(self, at: ClockReading) -> float:
        """Time has passed; the silence so far, seconds.

        A suspend begins it anew: the daemon is asked once more, and only once.
        """
        tick_s = at.monotonic_s - self._last.monotonic_s
        suspended_s = at.boot_s - self._last.boot_s - tick_s
        if self._may_ask and (suspended_s > SUSPENDED_S or tick_s > STANDSTILL_S):
            self.silent_s, self._may_ask, self._last_heartbeat = 0.0, False, at
        else:
            self.silent_s += min(tick_s, LONGEST_TICK_S)
        self._last = at
        return self.silent_s

    def record_heartbeat(self, at: ClockReading, *, counts: bool = True) -> None:
        """A heartbeat has come; the time since the last one is kept if it counts."""
        self.tick(at)
        if counts:
            self.longest_s = max(self.longest_s, at.monotonic_s - self._last_heartbeat.monotonic_s)
        self._last_heartbeat = at
        self.silent_s, self._may_ask = 0.0, True
