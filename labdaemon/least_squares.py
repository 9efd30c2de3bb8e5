"""The parts that every least-squares fit of this package shares: damped step, covariance, robust weights.

A fit minimises the weighted sum of squared residuals r by Gauss–Newton iterations. With the derivatives A and the
weights W the normal matrix is N = AᵀWA, the gradient g = AᵀWr, the step solves N·s = g, the covariance is N⁻¹. Near a
poor start the diagonal of N is raised by a factor 1 + λ, which shortens and turns the step (Marquardt 1963,
doi:10.1137/0111030). Both are computed on a scaled matrix with a unit diagonal, because the parameters have different
units.

`blur.solver` eliminates the illumination from N first (variable projection); what remains comes here. Robust weights
are functions of the normalised residual; iterated, they give M-estimates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

FloatArray = NDArray[np.float64]

FLOOR = 1e-30
"""Smallest diagonal element that is divided by: a parameter that nothing determines keeps its value. Numerics."""


def unit_scale(normal: FloatArray) -> FloatArray:
    """(k,) roots of the diagonal of a normal matrix (k, k): the inverse standard deviations of single parameters."""
    result: FloatArray = np.sqrt(np.maximum(np.diag(normal), FLOOR))
    return result


def damped_step(normal: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """(k,) step of damped Gauss–Newton.

    Parameters
    ----------
    normal, gradient
        (k, k) and (k,).
    damping
        λ: each diagonal element is raised by the factor 1 + λ.
    """
    scale = unit_scale(normal)
    damped, right = normal / (scale[:, None] * scale), gradient / scale
    damped.flat[:: len(damped) + 1] += damping
    try:
        step = np.linalg.solve(damped, right)
    except np.linalg.LinAlgError:  # a parameter does not show at all: it keeps its value
        step = np.linalg.lstsq(damped, right, rcond=1e-12)[0]
    result: FloatArray = step.astype(np.float64) / scale
    return result


def scaled_inverse(normal: FloatArray) -> FloatArray:
    """(k, k) covariance from a non-negative normal matrix; directions that nothing determines get no variance."""
    scale = 1 / np.sqrt(np.maximum(normal.diagonal(), FLOOR))
    both = scale[:, None] * scale
    factor, singular = lapack.dpotrf(normal * both, lower=1, clean=1)
    if singular:
        inverse = np.linalg.pinv(normal * both, rcond=1e-14, hermitian=True)
    else:
        root = lapack.dtrtri(factor, lower=1)[0]
        inverse = root.T @ root
    result: FloatArray = inverse * both
    return result


def huber_weight(residual: FloatArray, limit: float) -> FloatArray:
    """1 up to `limit`, then falling as 1/|r|: a bounded influence (Huber 1964, doi:10.1214/aoms/1177703732)."""
    result: FloatArray = np.minimum(1.0, limit / np.maximum(np.abs(residual), 1e-12))
    return result


def cauchy_weight(squared: FloatArray, scale2: float) -> FloatArray:
    """1/(1 + r²/c²) of squared residuals: the influence of far ones falls.

    Holland and Welsch 1977, doi:10.1080/03610927708827533.
    """
    result: FloatArray = 1.0 / (1.0 + squared / scale2)
    return result


def biweight(squared: FloatArray) -> FloatArray:
    """(1 − u²)² of squared residuals in units of the limit; 0 beyond it.

    Beaton and Tukey 1974, doi:10.1080/00401706.1974.10489171.
    """
    result: FloatArray = np.maximum(1 - squared, 0.0) ** 2
    return result
