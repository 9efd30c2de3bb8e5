"""Reported motions compared with the true ones."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labdaemon.blur import FloatArray
from labdaemon.orbit_size import semi_axes, semi_major_axis

NEAR_MM = 12.0
"""A reported target farther than this from a true one is another."""

HARMLESS = frozenset({"at_rest", "part_cycles"})
"""Flags that do not say the number is bad: it is compared all the same."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionComparison:
    """One target of one capture, as it moved and as it was measured.

    Attributes
    ----------
    diameter_mm
        Of the dot.
    true_a, true_b, a, b
        (3,) semi-amplitude vectors of sine and cosine, mm; a and b NaN where not measured.
    sd_mm
        Stated standard deviation of the major semi-axis' length.
    flags
        As reported.
    pulls
        Error over stated standard deviation of each component of the major semi-axis that has one.
    sign
        On which side of a the target is said to have been at the middle of the exposure: 1, −1, or 0 where it is not.
    """

    diameter_mm: float
    true_a: FloatArray
    true_b: FloatArray
    a: FloatArray
    b: FloatArray
    sd_mm: float
    flags: frozenset[str]
    pulls: tuple[float, ...] = ()
    sign: int = 0

    @property
    def compared(self) -> bool:
        """Whether the report has a number without a flag that spoils it."""
        return bool(np.isfinite(self.a).all()) and not self.flags - HARMLESS

    @property
    def true_mm(self) -> float:
        """True major semi-axis."""
        return semi_major_axis(self.true_a.tolist(), self.true_b.tolist())

    @property
    def error_mm(self) -> float:
        """Measured minus true major semi-axis."""
        return semi_major_axis(self.a.tolist(), self.b.tolist()) - self.true_mm

    @property
    def minor_error_mm(self) -> float:
        """Measured minus true minor semi-axis."""
        return float(np.linalg.norm(axes(self.a, self.b)[1]) - np.linalg.norm(axes(self.true_a, self.true_b)[1]))

    @property
    def direction_error_deg(self) -> float:
        """Angle between the measured and the true major axis."""
        u, v = axes(self.a, self.b)[0], axes(self.true_a, self.true_b)[0]
        sine = np.linalg.norm(np.cross(u, v))
        return math.degrees(math.atan2(float(sine), abs(float(u @ v))))

    @property
    def phase_error_deg(self) -> float:
        """Mean angle by which the measured phasor a + ib leads the true one."""
        overlap = np.vdot(self.true_a + 1j * self.true_b, self.a + 1j * self.b)
        return math.degrees(float(np.angle(overlap)))


def sign_is_right(pair: MotionComparison, cycles: float) -> bool:
    """Whether a stated sign is that of the side on which the target was, half of `cycles` after a phase of zero."""
    middle = math.pi * cycles
    side = math.sin(middle) * pair.true_a + math.cos(middle) * pair.true_b
    return pair.sign * float(pair.a @ side) > 0


def axes(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Major and minor semi-axis vectors of the orbit a·sin + b·cos."""
    major, minor = semi_axes(a.tolist(), b.tolist())
    return np.array(major), np.array(minor)


def read_truth(folder: Path) -> list[dict[str, Any]]:
    """Rows of a rendered folder's `truth.csv`, numbers as floats."""
    with (folder / "truth.csv").open(encoding="utf-8", newline="") as file:
        return [
            {k: v if k in ("capture", "target") else float(v) for k, v in row.items()} for row in csv.DictReader(file)
        ]


def pair_up(truth: Sequence[Mapping[str, Any]], rows: Iterable[Mapping[str, Any]]) -> list[MotionComparison]:
    """Match each true target with the nearest reported one of its capture.

    Parameters
    ----------
    truth
        From `read_truth`.
    rows
        Rows of `envelope.csv`: numbers as floats or None, flags as a list.
    """
    reported: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        reported.setdefault(str(row["capture"]), []).append(row)
    return [_pair(true, reported.get(str(true["capture"]), [])) for true in truth]


def _pair(true: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> MotionComparison:
    place = np.array([true["x_mm"], true["y_mm"], true["z_mm"]])
    found: Mapping[str, Any] = {}
    nearest = NEAR_MM
    for row in rows:
        distance = float(np.linalg.norm(_vector(row, "") - place))
        if distance < nearest:
            nearest, found = distance, row
    a, b = _vector(found, "a"), _vector(found, "b")
    if np.isfinite(a).all():
        b = np.nan_to_num(b)
    return MotionComparison(
        true["diameter_mm"],
        np.array([true["ax"], true["ay"], true["az"]]),
        np.array([true["bx"], true["by"], true["bz"]]),
        a,
        b,
        _sd(found, a, b),
        frozenset(found["flags"]) if found else frozenset({"not_found"}),
        _pulls(found, a, _vector(true, "a", ""), _vector(true, "b", "")),
        int(found.get("sign") or 0),
    )


def _pulls(row: Mapping[str, Any], a: FloatArray, true_a: FloatArray, true_b: FloatArray) -> tuple[float, ...]:
    """Of the components of an unphased a, whose sign is arbitrary."""
    if not np.isfinite(a).all():
        return ()
    major, sd = axes(true_a, true_b)[0], _vector(row, "sd_a")
    error = a - math.copysign(1.0, float(major @ a)) * major
    return tuple(float(e / s) for e, s in zip(error, sd, strict=True) if np.isfinite(s) and s > 0)


def _vector(row: Mapping[str, Any], prefix: str, unit: str = "_mm") -> FloatArray:
    values = [row.get(f"{prefix}{axis}{unit}") for axis in "xyz"]
    return np.array([math.nan if value is None else float(value) for value in values])


def _sd(row: Mapping[str, Any], a: FloatArray, b: FloatArray) -> float:
    """Of the major semi-axis' length, from those of its components (their correlations are not in the file)."""
    if not np.isfinite(a).all():
        return math.nan
    major = axes(a, b)[0]
    length = float(np.linalg.norm(major))
    along = np.abs(major) / length if length > 0 else np.full(3, 3**-0.5)
    # with a phase the major axis mixes a and b, whose standard deviations are nearly equal
    sd = np.nan_to_num(_vector(row, "sd_a"))
    return float(np.linalg.norm(along * sd))
