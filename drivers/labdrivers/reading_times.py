"""When the readings of a stream without time stamps were taken, from the arrival of its blocks.

The gauge's rate gives the distance between readings, the arrivals say where they lie: a block may come late, never
early, so the least delay counts. A delay that passes was the wire's or the host's; one that stays means that readings
were lost, and leaves a gap.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

GAP_S = 0.025
"""A lasting delay up to this is a clock that differs and a host that is busy, not a gap."""


class ReadingTimes:
    """Arrivals of a stream's blocks.

    Parameters
    ----------
    rate_hz
        Readings a second.
    keep_s
        How long arrivals are kept.
    """

    def __init__(self, rate_hz: float, keep_s: float) -> None:
        self._rate_hz = rate_hz
        # A block has one reading at least, so that these cover the readings that are kept.
        self._blocks: deque[tuple[int, float]] = deque(maxlen=max(int(keep_s * rate_hz), 1))

    def clear(self) -> None:
        """Begin a new stream."""
        self._blocks.clear()

    def note(self, total: int, arrived_s: float) -> None:
        """A block has come, and with it the stream has had `total` readings."""
        self._blocks.append((total, arrived_s))

    def of_latest(self, count: int) -> FloatArray:
        """Times of the latest `count` readings on the clock of the arrivals, (count,), ascending."""
        if not self._blocks or count <= 0:
            return np.empty(0)
        blocks = np.array(self._blocks)
        totals, arrived_s = blocks[:, 0].astype(np.int64), blocks[:, 1]
        number = np.arange(int(totals[-1]) - count, int(totals[-1]))
        first = int(np.searchsorted(totals, number[0], side="right"))
        totals, arrived_s = totals[first:], arrived_s[first:]
        # Least delay of this block and all later ones: what is left of a delay that passes.
        delay_s = np.minimum.accumulate((arrived_s - (totals - 1) / self._rate_hz)[::-1])[::-1]
        if delay_s[-1] - delay_s[0] <= GAP_S:
            return np.asarray(delay_s[0] + number / self._rate_hz, np.float64)
        block = np.searchsorted(totals, number, side="right")
        return np.asarray(delay_s[block] + number / self._rate_hz, np.float64)
