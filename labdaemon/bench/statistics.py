"""ErrorStatistics of merit of a set of pairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from labdaemon.bench.bound import BoundTable
from labdaemon.bench.pairs import MotionComparison
from labdaemon.blur import FloatArray

SEEN_MM = 0.25
"""Amplitudes from which an error compares with the bound: below, the estimate is no longer unbiased (about 1 px)."""


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Errors of the semi-amplitude and what belongs to them. NaN where nothing was compared.

    Attributes
    ----------
    targets, compared
        How many there are, and of how many a number was reported without a flag that takes it back.
    mean_mm, sd_mm, p95_mm
        Of the error; the last bounds 95 % of the absolute errors.
    pull_rms
        Root mean square of error over stated standard deviation, for the components of targets not at rest.
    bound_ratio
        Root mean square of error over the Cramér–Rao bound, above `SEEN_MM`.
    bound_mm
        Root mean square of that bound.
    direction_p50_deg, direction_p95_deg
        Error of the direction, above `SEEN_MM`.
    direction_ratio, direction_bound_deg
        Root mean squares of that error over its Cramér–Rao bound, and of the bound.
    ideal_p95_mm, ideal_direction_p95_deg
        What 95 % of the errors of all, and of the directions above `SEEN_MM`, would lie within at the bound itself.
    minor_p95_mm
        95 % of the errors of the minor semi-axis lie within this.
    relative_p95
        95 % of the relative errors of the semi-amplitude lie within this, above `SEEN_MM`.
    """

    targets: int
    compared: int
    mean_mm: float
    sd_mm: float
    p95_mm: float
    pull_rms: float
    bound_ratio: float
    bound_mm: float
    direction_p50_deg: float
    direction_p95_deg: float
    direction_ratio: float
    direction_bound_deg: float
    ideal_p95_mm: float
    ideal_direction_p95_deg: float
    minor_p95_mm: float
    relative_p95: float


def figures(pairs: Sequence[MotionComparison], bounds: BoundTable | None = None) -> ErrorStatistics:
    """ErrorStatistics of merit.

    Parameters
    ----------
    pairs
        Targets, measured or not.
    bounds
        The Cramér–Rao bound for their light; None where it was not worked out.
    """
    good = [pair for pair in pairs if pair.compared]
    moving = [pair for pair in good if pair.true_mm >= SEEN_MM]
    error = np.array([pair.error_mm for pair in good])
    pulls = [pull for pair in good if "at_rest" not in pair.flags for pull in pair.pulls]
    limits = [bounds.at(pair.diameter_mm, pair.true_mm) for pair in moving] if bounds else []
    bound = np.array(limits, dtype=float)
    over = [pair.error_mm / limit for pair, limit in zip(moving, bound, strict=False)]
    direction_bound = [bounds.direction_deg(pair.diameter_mm, pair.true_mm) for pair in moving] if bounds else []
    every = [bounds.at(pair.diameter_mm, pair.true_mm) for pair in good] if bounds else []
    direction = [pair.direction_error_deg for pair in moving]
    return ErrorStatistics(
        targets=len(pairs),
        compared=len(good),
        mean_mm=float(error.mean()) if error.size else math.nan,
        sd_mm=float(error.std(ddof=1)) if error.size > 1 else math.nan,
        p95_mm=_quantile(np.abs(error), 0.95),
        pull_rms=_rms(pulls),
        bound_ratio=_rms(over),
        bound_mm=_rms(bound),
        direction_p50_deg=_quantile(direction, 0.5),
        direction_p95_deg=_quantile(direction, 0.95),
        direction_ratio=_rms([error / limit for error, limit in zip(direction, direction_bound, strict=False)]),
        direction_bound_deg=_rms(direction_bound),
        ideal_p95_mm=_normal_quantile(every, 0.95),
        ideal_direction_p95_deg=_normal_quantile(direction_bound, 0.95),
        minor_p95_mm=_quantile([abs(pair.minor_error_mm) for pair in good], 0.95),
        relative_p95=_quantile([abs(pair.error_mm) / pair.true_mm for pair in moving], 0.95),
    )


def median_phase_error_deg(pairs: Sequence[MotionComparison]) -> float:
    """Median absolute phase error of the pairs that can be compared."""
    return _quantile([abs(pair.phase_error_deg) for pair in pairs if pair.compared], 0.5)


def _rms(values: Sequence[float] | FloatArray) -> float:
    array = np.asarray(values, float)
    return float(np.sqrt(np.mean(array**2))) if array.size else math.nan


def _quantile(values: Sequence[float] | FloatArray, share: float) -> float:
    array = np.asarray(values, float)
    return float(np.quantile(array, share)) if array.size else math.nan


def _normal_quantile(sds: Sequence[float], share: float) -> float:
    """Quantile of the absolute values of independent normal errors with these standard deviations."""
    if not sds:
        return math.nan
    sd = np.asarray(sds, float)
    low, high = 0.0, 6.0 * float(sd.max())
    for _ in range(50):
        middle = 0.5 * (low + high)
        inside = float(np.mean(special.erf(middle / (math.sqrt(2.0) * sd))))
        low, high = (middle, high) if inside < share else (low, middle)
    return high
