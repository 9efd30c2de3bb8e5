"""What the set-up reads when nothing moves: scatter against the stated sd, and the smallest motion it can detect.

Captures at rest show what the stated standard deviations are worth. The mean position of a target must scatter from
capture to capture by its stated sd. Its amplitude is never negative, so that at rest it is not zero on average: 95 % of
the readings lie below the detection limit (the notion is that of Currie 1968, doi 10.1021/ac60259a007).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labdaemon.errors import UsageError
from labdaemon.flags import Flag
from labdaemon.orbit_size import semi_major_axis

MIN_CAPTURES = 2
"""Captures that a scatter needs."""
QUANTILE = 0.95
UNUSABLE = frozenset({Flag.NOT_FOUND.value, Flag.OCCLUDED.value, Flag.SATURATED.value, Flag.PAPER_EDGE.value})
"""Flags of readings that say nothing of noise."""


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """Readings at rest of one camera (px) or of the envelopes (mm).

    Attributes
    ----------
    source
        Name of the camera, or "envelope".
    unit
        "px" or "mm".
    captures, targets, readings
        How many; readings without a number are not counted.
    position_sd, stated_position_sd
        Scatter of the mean position of a target between captures, common shift of all targets removed, and the sd
        stated for it (root mean squares over targets and axes).
    amplitude_median, detection_limit
        Of the amplitude: half of the readings, and 95 % of them, lie below.
    at_rest_share
        Share of readings that are flagged `at_rest`, as all should be.
    false_motion
        ``capture target`` of readings without any flag.
    """

    source: str
    unit: str
    captures: int
    targets: int
    readings: int
    position_sd: float
    stated_position_sd: float
    amplitude_median: float
    detection_limit: float
    at_rest_share: float
    false_motion: tuple[str, ...]

    @property
    def position_ratio(self) -> float:
        """Scatter ÷ stated sd; 1 where the stated sd is true."""
        return self.position_sd / self.stated_position_sd if self.stated_position_sd > 0 else math.nan


def noise_floor(rows: Iterable[Mapping[str, Any]], unit: str, source: str) -> NoiseFloor:
    """Statistics of rows of `envelope.csv` (unit "mm") or of one camera in `measurements.csv` (unit "px").

    Raises
    ------
    UsageError
        Fewer than two captures, or no target that was measured in two.
    """
    axes = "xyz" if unit == "mm" else "xy"
    usable = [row for row in rows if _vector(row, "a", axes, unit) is not None and not UNUSABLE & set(row["flags"])]
    captures = list(dict.fromkeys(str(row["capture"]) for row in usable))
    if len(captures) < MIN_CAPTURES:
        raise UsageError(
            f"{source}: a scatter needs {MIN_CAPTURES} captures at rest with targets, there are {len(captures)}"
        )
    scatter, stated = _position_scatter(usable, captures, axes, unit, source)
    amplitudes = [_amplitude(row, axes, unit) for row in usable]
    return NoiseFloor(
        source,
        unit,
        len(captures),
        len({row["target"] for row in usable}),
        len(usable),
        scatter,
        stated,
        float(np.median(amplitudes)),
        float(np.quantile(amplitudes, QUANTILE)),
        float(np.mean([Flag.AT_REST.value in row["flags"] for row in usable])),
        tuple(f"{row['capture']} {row['target']}" for row in usable if not row["flags"]),
    )


def _position_scatter(
    rows: Sequence[Mapping[str, Any]], captures: Sequence[str], axes: str, unit: str, source: str
) -> tuple[float, float]:
    """Root mean square scatter of a target's position, less the shift common to a capture, and the stated one."""
    places: dict[str, dict[str, np.ndarray[Any, np.dtype[np.float64]]]] = defaultdict(dict)
    variances = []
    for row in rows:
        place, sd = _vector(row, "", axes, unit), _vector(row, "sd_", axes, unit, empty=0.0)
        if place is not None and sd is not None:
            places[str(row["target"])][str(row["capture"])] = place
            variances.append(float(np.mean(sd[sd > 0] ** 2)) if (sd > 0).any() else math.nan)
    whole = [name for name, seen in places.items() if len(seen) == len(captures)]
    if not whole:
        raise UsageError(f"{source}: no target was measured in all {len(captures)} captures")
    cube = np.array([[places[name][capture] for capture in captures] for name in whole])
    rest = cube - cube.mean(axis=1, keepdims=True)
    freedom = len(captures) - 1.0
    if len(whole) > 1:  # camera and structure shift as one between captures; with one target that cannot be seen
        rest = rest - rest.mean(axis=0, keepdims=True)
        freedom *= (len(whole) - 1.0) / len(whole)
    moving = np.array([np.ptp(cube[..., axis]) > 0 for axis in range(len(axes))])
    scatter = math.sqrt(float(np.sum(rest**2)) / (len(whole) * freedom * max(int(moving.sum()), 1)))
    return scatter, math.sqrt(float(np.nanmean(variances)))


def _amplitude(row: Mapping[str, Any], axes: str, unit: str) -> float:
    a, b = _vector(row, "a", axes, unit, empty=0.0), _vector(row, "b", axes, unit, empty=0.0)
    assert a is not None
    assert b is not None
    pad = [0.0] * (3 - len(axes))
    return semi_major_axis([*a.tolist(), *pad], [*b.tolist(), *pad])


def _vector(
    row: Mapping[str, Any], prefix: str, axes: str, unit: str, *, empty: float | None = None
) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    values = [row.get(f"{prefix}{axis}_{unit}") for axis in axes]
    if empty is not None:
        values = [empty if value is None else value for value in values]
    return None if any(value is None for value in values) else np.array(values, dtype=np.float64)
