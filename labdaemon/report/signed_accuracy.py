"""How far signed motion is from a truth that is known: a and b as vectors, and the phase of each target.

Only where the light or the openings' phases show the phase: without it a and b are an orbit's axes, and are compared by
their length alone (`labdaemon.report.accuracy`).
"""

from __future__ import annotations

import cmath
import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from labdaemon.report.accuracy import FLOOR_MM

WRONG_DEG = 30.0
"""A phase that is off by more than this is another solution (a twin), not noise."""

AXES = "xyz"


@dataclass(frozen=True, slots=True)
class SignedAccuracy:
    """Errors of a capture's signed vectors.

    Attributes
    ----------
    compared
        Targets without a flag that truly moved by `FLOOR_MM` or more.
    flagged
        Targets that moved so much, and have a flag.
    wrong
        Compared targets whose phase is another solution's.
    p95_mm
        Bound that 95 % of the compared targets' errors of a and b keep, each the length of the difference.
    median_deg, p95_deg
        Of the absolute phase error; NaN when nothing was compared.
    """

    capture: str
    compared: int
    flagged: int
    wrong: int
    p95_mm: float
    median_deg: float
    p95_deg: float


def compare_signed(
    capture: str, rows: Iterable[Mapping[str, Any]], truth: Iterable[Mapping[str, Any]]
) -> SignedAccuracy:
    """Compare one capture's targets with the truth, by name.

    Parameters
    ----------
    rows
        Its rows of the envelope event or of `envelope.csv` (numbers as floats or None, flags as a list).
    truth
        A mapping a target with ``target`` and ``ax_mm`` … ``bz_mm`` (or ``ax`` … ``bz``).
    """
    true = {str(one["target"]): _motion(one) for one in truth}
    errors_mm: list[float] = []
    errors_deg: list[float] = []
    flagged = 0
    for row in rows:
        known, found = true.get(str(row["target"])), _motion(row)
        if known is None or np.linalg.norm(known) < FLOOR_MM:
            continue
        if row.get("flags") or found is None:
            flagged += 1
            continue
        errors_mm.append(float(np.linalg.norm(found - known)))
        # The phase by which the measured motion leads the true one, over all axes.
        errors_deg.append(abs(math.degrees(cmath.phase(complex(np.vdot(_phasors(found), _phasors(known)))))))
    return SignedAccuracy(
        capture,
        len(errors_mm),
        flagged,
        sum(error > WRONG_DEG for error in errors_deg),
        float(np.quantile(errors_mm, 0.95)) if errors_mm else math.nan,
        statistics.median(errors_deg) if errors_deg else math.nan,
        float(np.quantile(errors_deg, 0.95)) if errors_deg else math.nan,
    )


def signed_lines(accuracies: Iterable[SignedAccuracy]) -> list[str]:
    """A table of errors in text; empty without captures."""
    lines = [
        f"{one.capture:<24}{one.compared:>9}{one.flagged:>9}{one.wrong:>13}{_number(one.p95_mm, '.4f'):>11}"
        f"{_number(one.median_deg, '.2f'):>14}{_number(one.p95_deg, '.2f'):>12}"
        for one in accuracies
    ]
    if not lines:
        return []
    words = ("compared", 9), ("flagged", 9), ("wrong phase", 13), ("95 % mm", 11), ("median deg", 14), ("95 % deg", 12)
    head = f"{'capture':<24}" + "".join(f"{word:>{width}}" for word, width in words)
    about = f"Signed a and b, where light shows the phase: unflagged targets of {FLOOR_MM:g} mm and more,"
    return [f"{about} length of the error of (a, b), and the phase's:", head, *lines]


def _motion(row: Mapping[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """(6,) a and b, mm; a component that one camera cannot see is 0. None without numbers."""
    values = [row.get(f"{part}{axis}_mm", row.get(f"{part}{axis}")) for part in "ab" for axis in AXES]
    if values[0] is None:
        return None
    return np.array([0.0 if value is None else float(value) for value in values])


def _phasors(motion: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.complex128]]:
    """(3,) a + i·b of d = a sin ωt + b cos ωt = Im((a + i·b) exp(iωt))."""
    return np.asarray(motion[:3] + 1j * motion[3:], np.complex128)


def _number(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)
