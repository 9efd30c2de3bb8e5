"""The everyday fit, accelerated: the fits of ``direct`` behind the same signature.

Three shortcuts, each exact to about a hundredth of a standard deviation:

- The orbit of a plain dot is approached with the target's shape held, and one last step frees the shape.
- Next to a converged orbit the straight path follows from the orbit's normal equations, without another model.
- At rest the image does not depend on a, so a keeps the orbit's value and only its place is fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur.fit.direct import (
    OrbitFit,
    SquaredAxes,
    WholeCycleFits,
    clip_defocus,
    fit_orbit,
    orbit_bounds,
)
from labdaemon.blur.motion import Defocus
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import SOLVER, UNCERTAINTY, WHOLE_CYCLES
from labdaemon.blur.sharp.target import EllipseShape, SharpTarget
from labdaemon.blur.sharp.weights import noise_scale, nuisance_prior, pixel_weights
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.smear.gls import gls_refine
from labdaemon.blur.smear.initial_parameters import initial_parameters
from labdaemon.blur.solver.reduced_equations import Prior, Solution
from labdaemon.blur.solver.solve import gauss_newton_step, project_to_submodel, solve, warm_start
from labdaemon.blur.spectra import closed_form
from labdaemon.orbit_axes import moment_matrix

# Steps after which a warm start ends: a moment is nearly linear, the end of a path is less so.
LAST_PATH_STEP = np.full(5, WHOLE_CYCLES.last_step_px)
LAST_ORBIT_STEP = np.repeat([WHOLE_CYCLES.last_step_px, WHOLE_CYCLES.last_moment_step_px2], 3)
DIRECTION_SCAN = np.linspace(-1.0, 1.0, 91)


def fit_orbit_fast(sharp: SharpTarget, problem: FitProblem, blur: Defocus, start: FloatArray | None = None) -> OrbitFit:
    """Fit an orbit as `fit_orbit`; a plain dot by way of a fit with its shape held."""
    if start is None and _is_plain(sharp):
        begin = initial_parameters(sharp, problem, blur, problem.shape_count)[0]
        found = _fit_with_held_shape(sharp, problem, blur, begin)
        if found is not None:
            return found
    return fit_orbit(sharp, problem, blur, start)


def fit_straight_fast(
    sharp: SharpTarget, problem: FitProblem, blur: Defocus, orbit_fit: OrbitFit, axes: SquaredAxes
) -> Solution:
    """Fit a straight path as `fit_straight`; next to a converged orbit by projection."""
    k, orbit = problem.shape_count, orbit_fit.solution
    # Where a² is seen and b² is not, one step from the nearest straight path is exact to a hundredth of an sd.
    narrow = abs(axes.values_px2[1]) < UNCERTAINTY.rest_sds * axes.sd_px2[1]
    converged = orbit_fit.is_thin or (sharp.noise_known and orbit.converged and narrow and axes.shows_major)
    at_rest = axes.values_px2[0] < UNCERTAINTY.rest_sds * axes.sd_px2[0]
    held = _is_plain(sharp) and not orbit_fit.is_thin and orbit.converged and at_rest
    prior = nuisance_prior(sharp, blur, 2)
    least_px2 = WHOLE_CYCLES.fixed_moment_px2 if held else WHOLE_CYCLES.min_moment_px2
    start, step = nearest_straight_path(orbit, k, least_px2)
    if held:
        precision = prior.precision.copy()
        precision[3 + k :, 3 + k :] = np.eye(2) / WHOLE_CYCLES.fixed_moment_px2**2
        prior = Prior(np.concatenate((prior.mean[: 3 + k], start[3 + k :])), precision)
    if held or converged:
        jacobian = _moment_jacobian(start[3 + k :], k)
        best = project_to_submodel(orbit, nuisance_prior(sharp, blur, 3), start, step, jacobian, prior)
    else:
        weights = pixel_weights(sharp, problem.planes, noise_scale(sharp, orbit))
        model = fast_forward_model(problem, closed_form.straight_transfer)
        light = orbit.light - orbit.light_jacobian @ step
        best = solve(problem.planes, weights, model, start, prior, bound=clip_defocus, light=light)
    exact = fast_forward_model(problem, closed_form.straight_transfer, exact=True)
    ax, ay = best.p[3 + k :]
    return gls_refine(sharp, problem, best, exact, np.array([ax**2, ax * ay, ay**2]), prior)


def _is_plain(sharp: SharpTarget) -> bool:
    """A dot with reliable noise and nothing but paper texture on its paper: no fit of it needs more than one start."""
    return sharp.noise_known and isinstance(sharp.form, EllipseShape) and sharp.form.template_residual is None


def _fit_with_held_shape(sharp: SharpTarget, problem: FitProblem, blur: Defocus, start: FloatArray) -> OrbitFit | None:
    """Fit with the target's shape held, then release the shape in one step; None where that fails.

    A long blurred dot is first tried as a straight path, whose cost has fewer minima.
    """
    k = problem.shape_count
    prior = nuisance_prior(sharp, blur, 3)
    held = replace(problem, rest_spectra=problem.rest_spectra.fixed_shape)
    keep = [0, 1, 2, *range(3 + k, 6 + k)]
    held_prior = Prior(prior.mean[keep], prior.precision[np.ix_(keep, keep)])
    weights = pixel_weights(sharp, problem.planes)
    values, vectors = np.linalg.eigh(moment_matrix(start[3 + k :]))
    if values[1] - values[0] >= WHOLE_CYCLES.min_fast_amplitude_px**2 and values[0] <= 0.1 * values[1] + 4.0:
        begin = np.concatenate((start[:3], np.sqrt(values[1]) * vectors[:, 1]))
        path_prior = Prior(held_prior.mean[:5], held_prior.precision[:5, :5])
        model = fast_forward_model(held, closed_form.straight_transfer)
        path = warm_start(problem.planes, weights, model, begin, path_prior, LAST_PATH_STEP, bound=clip_defocus)
        if path is not None and float(np.hypot(*path[0][3:])) >= WHOLE_CYCLES.min_fast_amplitude_px:
            ax, ay = path[0][3:]
            solution = _release_shape(sharp, problem, prior, path[0], np.array([ax**2, ax * ay, ay**2]), path[1])
            if solution is not None:
                axes = SquaredAxes.of_moment(solution.p[3 + k :], solution.covariance[3 + k :, 3 + k :])
                if axes.values_px2[1] <= 2.0 * float(axes.sd_px2[1]):
                    return OrbitFit(solution, is_thin=True)
    begin = np.concatenate((start[:3], start[3 + k :]))
    model = fast_forward_model(held, closed_form.orbit_transfer)
    curve = warm_start(problem.planes, weights, model, begin, held_prior, LAST_ORBIT_STEP, bound=orbit_bounds(0))
    if curve is None:
        return None
    solution = _release_shape(sharp, problem, prior, curve[0], curve[0][3:], curve[1])
    return None if solution is None else OrbitFit(solution)


def _release_shape(
    sharp: SharpTarget, problem: FitProblem, prior: Prior, held: FloatArray, moment: FloatArray, light: FloatArray
) -> Solution | None:
    """One step that frees the shape; None where it is too long for a linear model, or the fit is poor."""
    k = problem.shape_count
    start = np.concatenate((held[:3], np.zeros(k), moment))
    model, weights = fast_forward_model(problem, closed_form.orbit_transfer), pixel_weights(sharp, problem.planes)
    solution = gauss_newton_step(problem.planes, weights, model, start, prior, light)
    short = float(np.max(np.abs(solution.p[3 : 3 + k]))) < SOLVER.linear_step_px
    return solution if solution.chi2 < UNCERTAINTY.poor_chi2 and short else None


def _moment_jacobian(a: FloatArray, k: int) -> FloatArray:
    """(6 + k, 5 + k) derivatives of an orbit's parameters by those of a straight path."""
    result = np.zeros((6 + k, 5 + k))
    result[: 3 + k, : 3 + k] = np.eye(3 + k)
    result[3 + k :, 3 + k :] = [[2 * a[0], 0.0], [a[1], a[0]], [0.0, 2 * a[1]]]
    return result


def nearest_straight_path(orbit_fit: Solution, k: int, least_px2: float) -> tuple[FloatArray, FloatArray]:
    """Straight path (x, y, extra variance, shape…, ax, ay) that an orbit's fit makes most likely, and the step to it.

    The cost is nearly quadratic in the second moment M, so that the best M = aaᵀ is found without the image.
    """
    moment = orbit_fit.p[3 + k :]
    precision = np.linalg.inv(orbit_fit.covariance[3 + k :, 3 + k :])
    _, vectors = np.linalg.eigh(moment_matrix(moment))
    middle, width = float(np.arctan2(vectors[1, 1], vectors[0, 1])), np.pi / 2
    for _ in range(2):
        angle = middle + width * DIRECTION_SCAN
        c, s = np.cos(angle), np.sin(angle)
        rays = np.stack((c * c, c * s, s * s), axis=1)
        along = rays @ precision
        square = np.maximum(along @ moment / np.maximum(np.einsum("ij,ij->i", along, rays), 1e-300), least_px2)
        away = square[:, None] * rays - moment
        best = int(np.argmin(np.einsum("ij,ij->i", away @ precision, away)))
        middle, width = float(angle[best]), width / 40
    step = orbit_fit.covariance[:, 3 + k :] @ precision @ away[best]
    a = np.sqrt(square[best]) * np.array([np.cos(middle), np.sin(middle)])
    return np.concatenate(((orbit_fit.p + step)[: 3 + k], a)), step


ACCELERATED = WholeCycleFits(fit_orbit_fast, fit_straight_fast)
