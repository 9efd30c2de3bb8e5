"""Correlations of a target's numbers as columns of a row: with the standard deviations they are covariances.

The numbers are x, y, z of the mean position, and of the vectors a and b. Correlations within the position (3) and
within the motion (15) are kept, with four decimals; those between position and motion are not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NUMBERS = tuple(f"{name}{axis}" for name in ("", "a", "b") for axis in "xyz")
"""Names of the nine numbers, as in the columns of `envelope.csv` less their unit."""
POSITION, MOTION = slice(0, 3), slice(3, 9)
PAIRS = tuple(
    (i, j) for block in (POSITION, MOTION) for i in range(block.start, block.stop) for j in range(i + 1, block.stop)
)
CORRELATIONS = tuple(f"cor_{NUMBERS[i]}_{NUMBERS[j]}" for i, j in PAIRS)
"""Names of the columns."""


def correlations_of(covariance: FloatArray) -> dict[str, float | None]:
    """Correlations by column; None where a number has no standard deviation (the normal of one camera's plane).

    A number whose variance is 0 is correlated with none.

    Parameters
    ----------
    covariance
        (9, 9) of the nine numbers.
    """
    variance = np.diag(covariance)
    sd = np.sqrt(np.where(variance > 0, variance, np.inf))
    found: dict[str, float | None] = {}
    for name, (i, j) in zip(CORRELATIONS, PAIRS, strict=True):
        value = float(covariance[i, j] / (sd[i] * sd[j]))
        is_known = bool(np.isfinite(variance[i]) and np.isfinite(variance[j]) and np.isfinite(value))
        found[name] = round(min(max(value, -1.0), 1.0), 4) + 0.0 if is_known else None
    return found


def correlations_in(row: Mapping[str, Any]) -> dict[str, float]:
    """The correlations that a row has."""
    return {name: float(row[name]) for name in CORRELATIONS if row.get(name) is not None}


def covariance_of(sd: FloatArray, correlations: Mapping[str, float]) -> FloatArray:
    """(9, 9) covariance from standard deviations (9,) and correlations; NaN where a standard deviation is.

    What is not known counts as 0. Rounding may leave an eigenvalue below zero: the nearest matrix without one is
    returned, with the same variances.
    """
    matrix = np.eye(len(NUMBERS))
    for name, (i, j) in zip(CORRELATIONS, PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = correlations.get(name, 0.0)
    if correlations:
        scale, vectors = np.linalg.eigh(matrix)
        whole = (vectors * np.maximum(scale, 0.0)) @ vectors.T
        root = np.sqrt(np.diag(whole))
        matrix = whole / np.outer(root, root)
    result: FloatArray = matrix * np.outer(sd, sd)
    return result
