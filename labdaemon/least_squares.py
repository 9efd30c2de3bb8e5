"""What the least-squares fits of this package share: damped iterations, step, covariance, robust weights.

A fit minimises the weighted sum of squared residuals r by Gauss–Newton iterations. With the derivatives A and the
weights W the normal matrix is N = AᵀWA, the gradient g = AᵀWr, the step solves N·s = g, the covariance is N⁻¹. Near a
poor start the diagonal of N is raised by a factor 1 + λ, which shortens and turns the step (Marquardt 1963,
doi:10.1137/0111030). Both are computed on a scaled matrix with a unit diagonal, because the parameters have different
units.

Unknowns of which each concerns few observations are eliminated from N first (variable projection): `blur.solver` does
it with the illumination of each colour plane, `geometry.normal_equations` with the points of a network. What remains
comes here. Robust weights are functions of the normalised residual; iterated, they give M-estimates.

`minimise` iterates for orientation, resection, lens conversion and bundle adjustment. Two loops are their own, because
they do something else: `blur.solver.solve` changes its weights on the way and takes a last step without looking again,
`geometry.motion_adjustment` has weights that depend on the unknowns, so that no two of its sums of squares compare.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

FloatArray = NDArray[np.float64]

FLOOR = 1e-30
"""Smallest diagonal element that is divided by: a parameter that nothing determines keeps its value. Numerics."""

SHOWS = 1e-14
"""Eigenvalue of a scaled normal matrix, in parts of its largest, below which a direction does not show. Numerics."""


class Linearisation(Protocol):
    """A fit at one state: what `minimise` compares, and whatever the next step is made from."""

    @property
    def cost(self) -> float:
        """Weighted sum of squared residuals there."""
        ...


L = TypeVar("L", bound=Linearisation)


@dataclass(frozen=True, slots=True)
class DampingRule:
    """How λ follows success and failure.

    Attributes
    ----------
    start
        Of the first step.
    relaxed
        Factor after a step that lowered the cost.
    raised
        Factor after one that did not.
    least, most
        A relaxed λ is no smaller, and no larger one is tried: the cost does not fall whatever the step.
    least_raised
        A raised λ is no smaller: it would take many factors to show.
    """

    start: float = 1e-6
    relaxed: float = 0.1
    raised: float = 10.0
    least: float = 1e-12
    most: float = 1e6
    least_raised: float = 1e-6


@dataclass(frozen=True, slots=True)
class Minimum(Generic[L]):
    """Where the iterations ended.

    Attributes
    ----------
    at
        The fit there.
    steps
        How many steps were tried.
    converged
        Whether a last step was so small that no other would matter.
    """

    at: L
    steps: int
    converged: bool


def minimise(
    here: L,
    try_step: Callable[[L, float], tuple[L | None, bool]],
    *,
    rule: DampingRule | None = None,
    max_steps: int,
) -> Minimum[L]:
    """Damped Gauss–Newton: steps that lower the cost are taken, others are tried again shorter.

    Parameters
    ----------
    here
        The fit at its start.
    try_step
        Takes a fit and λ; returns the fit a step further (None where there is none), and whether that step is so small
        that it is the last.
    rule
        How λ changes.
    max_steps
        Give up after so many.
    """
    rule = rule or DampingRule()
    damping = rule.start
    for steps in range(1, max_steps + 1):
        there, is_last = try_step(here, damping)
        # A last step may raise the cost by rounding: it is taken all the same, since nothing better will come.
        if there is not None and (there.cost <= here.cost or is_last):
            here, damping = there, max(damping * rule.relaxed, rule.least)
        elif damping > rule.most:
            return Minimum(here, steps, False)
        else:
            damping = max(damping * rule.raised, rule.least_raised)
        if is_last:
            return Minimum(here, steps, True)
    return Minimum(here, max_steps, False)


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
    """(k, k) covariance from a non-negative normal matrix; directions that nothing determines get no variance.

    Rounding may leave a small negative eigenvalue where a direction hardly shows. Its variance is that of the positive
    one: large, and never negative.
    """
    scale = 1 / np.sqrt(np.maximum(normal.diagonal(), FLOOR))
    both = scale[:, None] * scale
    factor, singular = lapack.dpotrf(normal * both, lower=1, clean=1)
    if singular:
        values, vectors = np.linalg.eigh(normal * both)
        shows = np.abs(values) > SHOWS * np.abs(values).max()
        inverse = (vectors[:, shows] / np.abs(values[shows])) @ vectors[:, shows].T
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
