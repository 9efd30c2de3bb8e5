"""Whether a gauge's readings use its range as they should: neither stuck nor clipped, and how coarse its steps are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MIN_EQUAL_READINGS = 16
"""So many equal readings and no other show a stuck gauge; fewer show nothing."""
CLIPPED_EXCESS = 0.03
"""Share of readings at one end of the range, beyond what a sine in steps would leave there, that means clipping."""


class RecordError(ValueError):
    """A record does not show the motion; the message says why, without the gauge's name."""


def check_range(values: FloatArray) -> None:
    """Check that readings are not stuck, and not clipped at an end of the gauge's range.

    Raises
    ------
    RecordError
        They are.
    """
    low, high = float(values.min()), float(values.max())
    if low == high:
        if values.size < MIN_EQUAL_READINGS:
            raise RecordError(f"{values.size} equal readings show neither motion nor noise")
        raise RecordError(f"stuck at {low:g}")
    for end in clipped_ends(values):
        raise RecordError(f"clipped at {end:g}")


def clipped_ends(values: FloatArray) -> list[float]:
    """Ends of the range, lowest and highest reading, at which readings pile up.

    A sine in coarse steps dwells at its ends too: only what exceeds that counts.
    """
    low, high = float(values.min()), float(values.max())
    if low == high:
        return []
    expected = math.acos(max(-1.0, 1.0 - 2.0 * smallest_step(values) / (high - low))) / math.pi
    counts = {end: int(np.sum(values == end)) for end in (low, high)}
    return [
        end for end, count in counts.items() if count > 2 and count > (1.5 * expected + CLIPPED_EXCESS) * values.size
    ]


def smallest_step(y: FloatArray) -> float:
    """Smallest step between readings: the converter's, where it is coarser than the noise."""
    steps = np.diff(np.unique(y))
    steps = steps[steps > 1e-9 * max(float(np.abs(y).max()), 1e-300)]
    return float(steps.min()) if steps.size else 0.0
