"""Whether a record's times and rate can show a motion, and whether the motion stays the same all through.

A gauge that falls silent, loses readings without losing their times, or has a clock of its own sends numbers that a
sine can be fitted to. The sine is then wrong, and its residuals do not say by how much: such records are refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labdaemon.record_range import RecordError

FloatArray = NDArray[np.float64]

MIN_READINGS_PER_CYCLE = 2.5
"""With fewer a sine and its alias look the same."""
FOLDING_ORDERS = (2, 3)
"""Harmonics that real motions have: sampled at one more than their number a cycle, they fall on the fundamental."""
MAX_SHARED_TIMES = 0.2
"""Share of readings with the time of the one before: above it packets have times, and readings have none."""
MAX_CLOCK_ERROR = 0.02
"""Relative difference of the frequency found from the one stated: no gauge's clock is so wrong."""
MIN_SEGMENT_READINGS = 16
"""Readings of a segment: four unknowns explain little of the noise of so many."""
MAX_SEGMENTS = 16
LEAST_FILLED = 0.75
"""Readings of a segment, over those of a mean one: one with a gap shows too little of a cycle."""
MIN_EXPLAINED = 2.0
"""Power of the segments' motions over that of what they leave, below which noise hides how steady they are."""
MAX_CHANGE = 0.3
"""Largest deviation of a segment's motion from the mean, over their size, that beats and settling leave."""
SIGNIFICANT_SDS = 6.0
"""And in standard deviations of what noise does to it."""


def check_times(t_s: FloatArray, y: FloatArray) -> None:
    """Check that a record has a time for each reading, in order.

    Raises
    ------
    RecordError
        It has not.
    """
    steps = np.diff(t_s) if t_s.ndim == 1 else np.empty(0)
    if t_s.ndim != 1 or t_s.shape != y.shape or not np.isfinite(t_s).all() or np.any(steps < 0):
        raise RecordError("the record's times do not ascend, or are not one for each reading")
    shared = float(np.mean(steps == 0)) if steps.size and steps.any() else 0.0
    if shared > MAX_SHARED_TIMES:
        raise RecordError(f"{shared:.0%} of the readings have the time of the one before: its driver stamps packets")


def check_rate(t_s: FloatArray, frequency_hz: float) -> None:
    """Check that the rate of readings shows a sine, and does not fold its harmonics onto it.

    Raises
    ------
    RecordError
        It does not.
    """
    if t_s.size < 2 or t_s[-1] <= t_s[0]:
        raise RecordError(f"{t_s.size} readings are too few")
    span_s = float(t_s[-1] - t_s[0])
    rate_hz = (t_s.size - 1) / span_s
    if not frequency_hz > 0 or rate_hz < MIN_READINGS_PER_CYCLE * frequency_hz:
        raise RecordError(f"{rate_hz:.3g} readings/s are too few for {frequency_hz:.4g} Hz")
    for order in FOLDING_ORDERS if span_s * frequency_hz >= 1.0 else ():
        if abs(rate_hz - (order + 1) * frequency_hz) * span_s < 1.0:
            raise RecordError(
                f"{rate_hz:.4g} readings/s are {order + 1} a cycle of {frequency_hz:.4g} Hz: harmonic {order} looks "
                "like the motion itself; choose another rate"
            )


def check_frequency(found_hz: float, stated_hz: float) -> None:
    """Check that a motion has the frequency that it is stated to have, as far as clocks agree.

    Raises
    ------
    RecordError
        It has another.
    """
    if abs(found_hz / stated_hz - 1.0) > MAX_CLOCK_ERROR:
        raise RecordError(f"it moves at {found_hz:.4g} Hz, not at {stated_hz:.4g} Hz: its clock or rate is wrong")


def check_steady(t_s: FloatArray, y: FloatArray, frequency_hz: float) -> None:
    """Check that the fundamental keeps amplitude and phase all through a record.

    Each segment is fitted by a sine, an offset and a drift of its own. A sine that is silent for a part, or jumps in
    phase, differs between them by as much as it is large. Where the segments' sines make up a small part of the record
    nothing is checked: the residuals are as large then, and so is the standard deviation.

    Parameters
    ----------
    t_s, y
        (n,) times and readings, all finite.
    frequency_hz
        Of the fundamental.

    Raises
    ------
    RecordError
        It does not.
    """
    cycles = float(t_s[-1] - t_s[0]) * frequency_hz
    count = min(int(cycles + 0.5), t_s.size // MIN_SEGMENT_READINGS, MAX_SEGMENTS)
    if count < 2:
        return
    edges = np.searchsorted(t_s, np.linspace(t_s[0], t_s[-1], count + 1)[1:-1])
    sines, powers = [], []
    for t, values in zip(np.split(t_s, edges), np.split(y, edges), strict=True):
        if t.size < LEAST_FILLED * t_s.size / count:
            continue
        angle = 2.0 * np.pi * frequency_hz * t
        design = np.stack([np.sin(angle), np.cos(angle), np.ones_like(t), t - t.mean()], axis=1)
        solution = np.linalg.lstsq(design, values)[0]
        left = values - design @ solution
        sines.append(complex(solution[0], solution[1]))
        powers.append((float(np.sum((design[:, :2] @ solution[:2]) ** 2)), float(left @ left), t.size))
    explained, unexplained, readings = (float(part) for part in np.sum(powers, axis=0)) if sines else (0.0, 0.0, 0.0)
    if len(sines) < 2 or not explained > MIN_EXPLAINED * unexplained:
        return
    each = np.array(sines)
    sd = np.sqrt(4.0 * unexplained / (readings - 4 * len(sines)) / (readings / len(sines)))
    size, change = float(np.sqrt(np.mean(np.abs(each) ** 2))), float(np.abs(each - each.mean()).max())
    if change > max(MAX_CHANGE * size, SIGNIFICANT_SDS * sd):
        raise RecordError(
            f"its motion at {frequency_hz:.4g} Hz changes by {change / size:.0%} during the record: it was silent or "
            "lost readings for a part, its clock is wrong, or the motion is not steady"
        )
