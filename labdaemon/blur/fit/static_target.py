"""Targets that do not move: they measure the shift and the defocus of a frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.blur.motion import Defocus, InitialGuess, StaticMeasurement
from labdaemon.blur.patch.illumination import solve_illumination
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.settings import STATIC_TARGET
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import nuisance_prior, pixel_weights
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem, prepare_fit
from labdaemon.blur.smear.template_noise import correct_template_noise_bias
from labdaemon.blur.smear.uncertainty import robust_covariance
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import DarknessModel, solve
from labdaemon.flags import Flag

UNKNOWN_DEFOCUS = Defocus(0.0, STATIC_TARGET.defocus_sd_px2)


def measure_static(sharp: SharpTarget, patch: Patch, *, initial_guess: InitialGuess | None = None) -> StaticMeasurement:
    """Shift and isotropic extra blur of a target that does not move.

    Parameters
    ----------
    sharp
        From `fit_sharp` or `make_textured_patch`.
    patch
        Part of the later frame that holds the target.
    initial_guess
        Where to look; None for its place in the sharp frame. Good to about 3 px.

    Returns
    -------
    StaticMeasurement
        NaN, with a flag, where it cannot be seen.
    """
    nan = np.full(2, np.nan)
    lost = StaticMeasurement(
        sharp.name,
        sharp.centre_px,
        nan,
        float("nan"),
        np.full((3, 3), np.nan),
        frozenset({Flag.NOT_FOUND}),
        float("nan"),
    )
    expected = np.asarray(initial_guess.centre_px if initial_guess is not None else sharp.centre_px, dtype=np.float64)
    if not sharp.usable:
        return lost
    problem = prepare_fit(sharp, patch, expected)
    if problem is None:
        return lost
    k = problem.shape_count
    first = np.concatenate((problem.initial_centre_px, [0.0], np.zeros(k)))

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[2] = np.clip(p[2], -2.0, 60.0)
        return p

    model, weights, prior = (
        fast_forward_model(problem, None),
        pixel_weights(sharp, problem.planes),
        nuisance_prior(sharp, UNKNOWN_DEFOCUS, 0),
    )

    def fit(begin: FloatArray, light: FloatArray | None = None) -> Solution:
        return solve(problem.planes, weights, model, begin, prior, bound=bound, light=light)

    best = _fit_without_shift(sharp, problem, first, weights, model, fit)
    tries = [(0.0, 0.0)] if problem.blob is not None else [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2)]
    for dx, dy in tries:
        if best is not None and best.chi2 < STATIC_TARGET.poor_chi2:
            break
        begin = first.copy()
        begin[:2] += (dx, dy)
        found = fit(begin)
        again = best is not None and float(np.hypot(*(found.p - best.p)[:2])) < STATIC_TARGET.same_shift_px
        if best is None or found.cost < best.cost:
            best = found
        if again:  # two ways that end in one place found the right one
            break
    assert best is not None
    best = correct_template_noise_bias(sharp, problem, best, None)
    covariance = robust_covariance(sharp, best, problem.planes)[:3, :3]
    covariance[:2, :2] += sharp.covariance_px2
    flags = {Flag.POOR_FIT} if best.chi2 > STATIC_TARGET.poor_chi2 and sharp.noise_known else set()
    return StaticMeasurement(
        sharp.name,
        sharp.centre_px,
        best.p[:2] - sharp.centre_px,
        float(best.p[2]),
        covariance,
        frozenset(flags),
        best.chi2,
    )


def _fit_without_shift(
    sharp: SharpTarget,
    problem: FitProblem,
    first: FloatArray,
    weights: Callable[[FloatArray], FloatArray],
    model: DarknessModel,
    fit: Callable[[FloatArray, FloatArray], Solution],
) -> Solution | None:
    """The fit of a frame that did not shift, as most do not: what it begins with is nearly its end. None if it did."""
    if np.abs(problem.initial_centre_px - sharp.centre_px).max() > STATIC_TARGET.max_unshifted_px:
        return None
    dark, _ = model(first)
    found = fit(first, solve_illumination(problem.planes, weights(np.maximum(problem.planes.values, 0)), dark))
    return found if np.abs(found.p[:2] - first[:2]).max() < STATIC_TARGET.max_unshifted_px else None
