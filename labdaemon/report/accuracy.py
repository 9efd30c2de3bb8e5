"""How far results are from a truth that is known: simulated rigs and rendered folders only.

Each true target is matched to the nearest reported one. Errors are of the semi-amplitude, the length of the orbit's
major semi-axis, so they need no phase.
"""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.orbit_size import semi_axes

FLOOR_MM = 0.2
"""Semi-amplitudes below this are left out of the statistics: they are about to be `at_rest`."""
NEAR_MM = 12.0
"""A reported target further from the true one than this is not the same."""


@dataclass(frozen=True, slots=True)
class TargetComparison:
    """A target's semi-amplitude as measured and as it was, millimetres; `measured_mm` None without a number."""

    target: str
    true_mm: float
    measured_mm: float | None
    sd_mm: float | None
    flags: tuple[str, ...]

    @property
    def error_mm(self) -> float | None:
        """Measured minus true."""
        return None if self.measured_mm is None else self.measured_mm - self.true_mm


@dataclass(frozen=True, slots=True)
class CaptureAccuracy:
    """Errors of one capture.

    Attributes
    ----------
    targets, unflagged
        How many targets there are, and how many were reported without a flag other than `at_rest`.
    compared
        Unflagged targets that truly moved by `FLOOR_MM` or more: the ones in the statistics.
    mean_mm, sd_mm, p95_mm
        Of the error; the last is the bound that 95 % of absolute errors keep. NaN when nothing was compared.
    """

    capture: str
    targets: int
    unflagged: int
    compared: int
    mean_mm: float
    sd_mm: float
    p95_mm: float
    pairs: tuple[TargetComparison, ...]


def compare(capture: str, rows: Iterable[Mapping[str, Any]], truth: Iterable[Mapping[str, Any]]) -> CaptureAccuracy:
    """Compare one capture.

    Parameters
    ----------
    rows
        Its rows of `envelope.csv` (numbers as floats or None, flags as a list).
    truth
        A mapping a target with ``target``, ``x_mm`` … and ``ax_mm`` … ``bz_mm`` (or ``ax`` … ``bz``).
    """
    reported = list(rows)
    pairs = tuple(_pair(true, reported) for true in truth)
    return summary(capture, pairs)


def summary(capture: str, pairs: Sequence[TargetComparison]) -> CaptureAccuracy:
    """Statistics of pairs that may come from several captures."""
    good = [pair for pair in pairs if pair.measured_mm is not None and not set(pair.flags) - {"at_rest"}]
    errors = [pair.error_mm for pair in good if pair.error_mm is not None and pair.true_mm >= FLOOR_MM]
    return CaptureAccuracy(
        capture=capture,
        targets=len(pairs),
        unflagged=len(good),
        compared=len(errors),
        mean_mm=statistics.fmean(errors) if errors else math.nan,
        sd_mm=statistics.stdev(errors) if len(errors) > 1 else math.nan,
        p95_mm=float(np.quantile(np.abs(errors), 0.95)) if errors else math.nan,
        pairs=tuple(pairs),
    )


def row_axes(row: Mapping[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Major and minor semi-axis of a row's orbit a·sin + b·cos, (3,) each; None when it has no numbers."""
    a, b = _vector(row, "a"), _vector(row, "b")
    if np.isnan(a).any():
        return None
    b = np.nan_to_num(b)
    major, minor = semi_axes(a.tolist(), b.tolist())
    return np.array(major), np.array(minor)


def semi_amplitude_sd_mm(row: Mapping[str, Any]) -> float | None:
    """Standard deviation of the major semi-axis' length, from those of a's components; None where unknown."""
    axes, sd = row_axes(row), _vector(row, "sd_a")
    if axes is None or np.isnan(sd).all():
        return None
    length = float(np.linalg.norm(axes[0]))
    along = axes[0] / length if length > 0 else np.full(3, 3**-0.5)
    return float(np.sqrt(np.sum((along * np.nan_to_num(sd)) ** 2)))


def read_truth(path: Path) -> dict[str, list[dict[str, Any]]]:
    """`truth.csv` of a rendered folder, by capture.

    Raises
    ------
    DataError
        Not there, or not such a file.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.DictReader(file))
        truth: dict[str, list[dict[str, Any]]] = {}
        for line in lines:
            numbers = {key: float(value) for key, value in line.items() if key not in {"capture", "target"} and value}
            truth.setdefault(line["capture"], []).append({"target": line.get("target", ""), **numbers})
    except (OSError, KeyError, ValueError) as exc:
        raise DataError(f"is no truth to compare with ({exc})", file=path) from None
    return truth


def _pair(true: Mapping[str, Any], reported: Sequence[Mapping[str, Any]]) -> TargetComparison:
    place = _vector(true, "", unit=True)
    axes = row_axes(true)
    true_mm = float(np.linalg.norm(axes[0])) if axes is not None else math.nan
    distances = [float(np.linalg.norm(_vector(row, "", unit=True) - place)) for row in reported]
    near = [(distance, index) for index, distance in enumerate(distances) if distance < NEAR_MM]
    if near:
        row = reported[min(near)[1]]
    else:  # a row that lost its place still counts by name, with its flag
        row = next((row for row in reported if row.get("target") == true.get("target")), {})
    found = row_axes(row) if near else None
    return TargetComparison(
        str(true.get("target", "")),
        true_mm,
        None if found is None else float(np.linalg.norm(found[0])),
        semi_amplitude_sd_mm(row) if near else None,
        tuple(row.get("flags") or (() if near else ("not_found",))),
    )


def _vector(row: Mapping[str, Any], prefix: str, *, unit: bool = False) -> NDArray[np.float64]:
    values = [row.get(f"{prefix}{axis}_mm", None if unit else row.get(f"{prefix}{axis}")) for axis in "xyz"]
    return np.array([math.nan if value is None else float(value) for value in values])
