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
SHAPE_READINGS_PER_CYCLE = 40.0
"""Readings of a cycle from which differences of neighbours show noise and jumps, not the motion."""
JUMP, LEAST_JUMPS = 0.7, 2
"""Part of the range between neighbours that no motion goes, and how often it happens to a number that overflows."""
JUMP_OVER_STEP = 20.0
"""And how many times longer it is than most steps: noise alone jumps as well."""
MAX_MISFIT = 0.05
"""Residuals, over the range, with which a model still says where its ends are."""


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


def check_shape(y: FloatArray, model: FloatArray, readings_per_cycle: float) -> None:
    """Check that readings follow a fitted motion to its ends, and do not jump over their whole range.

    An amplifier that clips before the converter adds its noise leaves no equal readings, but more of them near an end
    than the fitted harmonics explain. Few readings a cycle jump by themselves, and nothing is checked.

    Parameters
    ----------
    y, model
        (n,) readings in the order of their times, without outliers, and the fitted motion.
    readings_per_cycle
        Of the fundamental.

    Raises
    ------
    RecordError
        They do not follow it, or jump.
    """
    if readings_per_cycle < SHAPE_READINGS_PER_CYCLE:
        return
    steps, jump = np.abs(np.diff(y)), JUMP * float(np.ptp(y))
    jumps = int(np.sum(steps > jump))
    if jumps >= LEAST_JUMPS and jump > JUMP_OVER_STEP * float(np.median(steps)):
        raise RecordError(f"jumps over its whole range {jumps} times: a number overflows, or its bytes are swapped")
    if float(np.std(y - model)) > MAX_MISFIT * float(np.ptp(y)):
        return
    # A fourth difference takes the motion out and leaves 70 times the noise's variance.
    noise = float(np.median(np.abs(np.diff(y, 4)))) / (0.6745 * math.sqrt(70.0))
    width = 6.0 * max(noise, smallest_step(y))
    for one, its in ((y, model), (-y, -model)):
        seen, expected = np.mean(one > one.max() - width), np.mean(its > its.max() - width)
        if seen > 1.5 * expected + 2.0 * CLIPPED_EXCESS:
            raise RecordError(f"clipped near {float(y[np.argmax(one)]):.4g}")


def smallest_step(y: FloatArray) -> float:
    """Smallest step between readings: the converter's, where it is coarser than the noise."""
    steps = np.diff(np.unique(y))
    steps = steps[steps > 1e-9 * max(float(np.abs(y).max()), 1e-300)]
    return float(steps.min()) if steps.size else 0.0
