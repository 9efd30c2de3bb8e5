"""The everyday fit, without shortcuts: an orbit by its second moment, then a straight path by its vector.

Over whole cycles the image depends on a and b by M = aaᵀ + bbᵀ alone (`labdaemon.blur.smear.forward_model`), and it is
analytic in M. The orbit is therefore fitted first, from the moments of the blurred dot. Where its minor axis does not
show, the path is fitted again as a straight one: with one parameter less the covariance is smaller.

These two functions are the definition. ``accelerated`` has faster ones of the same signature; a test holds that both
give the same measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from labdaemon.blur.motion import Defocus
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import UNCERTAINTY, WHOLE_CYCLES
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import noise_scale, nuisance_prior, pixel_weights
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.smear.gls import gls_refine
from labdaemon.blur.smear.initial_parameters import initial_parameters
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.spectra import closed_form
from labdaemon.orbit_axes import moment_matrix, principal_moments


@dataclass(frozen=True, slots=True, eq=False)
class OrbitFit:
    """An orbit fitted by its second moment.

    Attributes
    ----------
    solution
        Parameters x, y, defocus, shape…, m0, m1, m2.
    is_thin
        Whether a long straight path led to it, so that its minor axis is known not to show.
    """

    solution: Solution
    is_thin: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SquaredAxes:
    """Squared semi-axes of an orbit: eigenvalues of aaᵀ + bbᵀ, px², (2,) larger first, and their sd (2,)."""

    values_px2: FloatArray
    sd_px2: FloatArray

    @staticmethod
    def of_moment(moment: FloatArray, covariance: FloatArray) -> SquaredAxes:
        """From (3,) m0, m1, m2 and their (3, 3) covariance."""
        values, _, _, cov = principal_moments(moment, covariance)
        return SquaredAxes(values, np.sqrt(np.maximum(np.diag(cov), 0)))

    @property
    def shows_major(self) -> bool:
        """Whether the major axis exceeds the detection limit."""
        return bool(self.values_px2[0] > UNCERTAINTY.rest_sds * self.sd_px2[0])


class FitOrbit(Protocol):
    """Fits an orbit; `start` (p,) replaces the moments of the blurred dot as initial parameters."""

    def __call__(
        self, sharp: SharpTarget, problem: FitProblem, blur: Defocus, start: FloatArray | None = None
    ) -> OrbitFit:
        """Fit."""
        ...


class FitStraight(Protocol):
    """Fits a straight path next to an orbit whose minor axis does not show."""

    def __call__(
        self, sharp: SharpTarget, problem: FitProblem, blur: Defocus, orbit_fit: OrbitFit, axes: SquaredAxes
    ) -> Solution:
        """Fit; the last two parameters are ax and ay."""
        ...


@dataclass(frozen=True, slots=True)
class WholeCycleFits:
    """The two fits of a motion over whole cycles."""

    orbit: FitOrbit
    straight: FitStraight


def fit_orbit(sharp: SharpTarget, problem: FitProblem, blur: Defocus, start: FloatArray | None = None) -> OrbitFit:
    """Fit an orbit by its second moment from every initial value, and keep the best."""
    model = fast_forward_model(problem, closed_form.orbit_transfer)
    prior, weights = nuisance_prior(sharp, blur, 3), pixel_weights(sharp, problem.planes)
    bound = orbit_bounds(problem.shape_count)
    starts = initial_parameters(sharp, problem, blur, problem.shape_count) if start is None else [start]
    fits = [solve(problem.planes, weights, model, one, prior, bound=bound) for one in starts]
    best = min(fits, key=lambda fit: fit.cost)
    if not sharp.noise_known:
        # The prior must be weighed against the noise that the residuals show.
        weights = pixel_weights(sharp, problem.planes, noise_scale(sharp, best))
        best = solve(problem.planes, weights, model, best.p, prior, bound=bound, light=best.light)
    return OrbitFit(best)


def fit_straight(
    sharp: SharpTarget, problem: FitProblem, blur: Defocus, orbit_fit: OrbitFit, axes: SquaredAxes
) -> Solution:
    """Fit a straight path from the orbit's major axis, then once more with the paper texture in the weights."""
    k, orbit = problem.shape_count, orbit_fit.solution
    _, vectors = np.linalg.eigh(moment_matrix(orbit.p[3 + k :]))
    a = np.sqrt(max(float(axes.values_px2[0]), WHOLE_CYCLES.min_moment_px2)) * vectors[:, 1]
    weights = pixel_weights(sharp, problem.planes, noise_scale(sharp, orbit))
    model, prior = fast_forward_model(problem, closed_form.straight_transfer), nuisance_prior(sharp, blur, 2)
    start = np.concatenate((orbit.p[: 3 + k], a))
    best = solve(problem.planes, weights, model, start, prior, bound=clip_defocus, light=orbit.light)
    exact = fast_forward_model(problem, closed_form.straight_transfer, exact=True)
    ax, ay = best.p[3 + k :]
    return gls_refine(sharp, problem, best, exact, np.array([ax**2, ax * ay, ay**2]), prior)


def orbit_bounds(k: int) -> Callable[[FloatArray], FloatArray]:
    """Function that keeps an orbit's parameters where its model is defined."""

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        low, axes = np.linalg.eigh(moment_matrix(p[3 + k :]))
        if low[0] < WHOLE_CYCLES.min_moment_eigenvalue_px2:
            fixed = axes @ np.diag(np.maximum(low, WHOLE_CYCLES.min_moment_eigenvalue_px2)) @ axes.T
            p[3 + k :] = fixed[0, 0], fixed[0, 1], fixed[1, 1]
        return clip_defocus(p)

    return bound


def clip_defocus(p: FloatArray) -> FloatArray:
    """Parameters with the defocus inside the range that a frame can have."""
    p = p.copy()
    p[2] = np.clip(p[2], WHOLE_CYCLES.min_defocus_px2, WHOLE_CYCLES.max_defocus_px2)
    return p


DIRECT = WholeCycleFits(fit_orbit, fit_straight)
