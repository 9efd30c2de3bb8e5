"""Correlations of a target's nine numbers as one cell of text: with the standard deviations they are the covariance.

The numbers are x, y, z of the mean position, of a and of b, in this order. The text has the 36 correlations above the
diagonal, row by row, with four decimals; `nan` where a number has no standard deviation (the normal of one camera's
plane).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

COUNT = 9
_ABOVE = np.triu_indices(COUNT, 1)


def correlation_text(covariance: FloatArray) -> str | None:
    """The text of a covariance (9, 9); None where nothing has a standard deviation.

    A number whose variance is 0 is correlated with none.
    """
    variance = np.diag(covariance)
    is_known = np.isfinite(variance) & (variance >= 0)
    if not is_known.any():
        return None
    sd = np.sqrt(np.where(is_known & (variance > 0), variance, np.inf))
    correlation = np.where(np.outer(is_known, is_known), np.nan_to_num(covariance) / np.outer(sd, sd), np.nan)
    return " ".join("nan" if np.isnan(one) else f"{one + 0.0:.4f}" for one in np.clip(correlation[_ABOVE], -1, 1))


def covariance_of(sd: FloatArray, text: object) -> FloatArray:
    """(9, 9) covariance from standard deviations (9,) and the text; NaN where a standard deviation is.

    Without a text that can be read the correlations are taken as 0. Rounding may leave an eigenvalue below zero: the
    nearest matrix without one is returned, with the same variances.
    """
    correlation = np.eye(COUNT)
    values = _parsed(text)
    if values is not None:
        correlation[_ABOVE] = values
        correlation.T[_ABOVE] = values
        scale, vectors = np.linalg.eigh(correlation)
        whole = (vectors * np.maximum(scale, 0.0)) @ vectors.T
        root = np.sqrt(np.diag(whole))
        correlation = whole / np.outer(root, root)
    result: FloatArray = correlation * np.outer(sd, sd)
    return result


def _parsed(text: object) -> FloatArray | None:
    if not isinstance(text, str):
        return None
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        return None
    if values.shape != (len(_ABOVE[0]),):
        return None
    return np.clip(np.where(np.isfinite(values), values, 0.0), -1.0, 1.0)
