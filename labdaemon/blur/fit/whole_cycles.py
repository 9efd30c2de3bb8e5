"""A sinusoid over whole cycles, phase unknown: the everyday case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from labdaemon.blur.axes import axes_from_moment, moment_matrix, orient_positive, principal_moments
from labdaemon.blur.motion import Defocus, Measurement, empty_measurement
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.settings import SOLVER, UNCERTAINTY, WHOLE_CYCLES
from labdaemon.blur.sharp.target import EllipseShape, SharpTarget
from labdaemon.blur.sharp.weights import noise_scale, nuisance_prior, pixel_weights
from labdaemon.blur.smear.forward_model import FitProblem, forward_model, prepare_fit
from labdaemon.blur.smear.gls import gls_refine
from labdaemon.blur.smear.initial_parameters import initial_parameters
from labdaemon.blur.smear.template_noise import correct_template_noise_bias
from labdaemon.blur.smear.uncertainty import quality_flags, robust_covariance, saturation_flags
from labdaemon.blur.solver.reduced_equations import Prior, Solution
from labdaemon.blur.solver.solve import gauss_newton_step, project_to_submodel, solve, warm_start
from labdaemon.blur.spectra import closed_form
from labdaemon.flags import Flag

# Steps of an approach that may be its last: a moment is nearly linear, a path's end less so.
LAST_PATH_STEP = np.full(5, WHOLE_CYCLES.last_step_px)
LAST_ORBIT_STEP = np.repeat([WHOLE_CYCLES.last_step_px, WHOLE_CYCLES.last_moment_step_px2], 3)
DIRECTION_SCAN = np.linspace(-1.0, 1.0, 91)


def measure_whole_cycles(
    sharp: SharpTarget, patch: Patch, problem: FitProblem, blur: Defocus, *, orbit: bool, flags: set[Flag]
) -> Measurement:
    """Fit an orbit by its second moment; then a straight path, where the minor axis does not show.

    Parameters
    ----------
    sharp, patch, problem, blur
        The target, the blurred patch, what `prepare_fit` made of them, and the frame's defocus.
    orbit
        False forces straight motion.
    flags
        Flags to start with.
    """
    k = problem.shape_count
    starts = initial_parameters(sharp, problem, blur, k)
    is_thin = False
    fast_fit = _fit_orbit_fast(sharp, problem, blur, starts[0]) if _is_plain(sharp) else None
    if fast_fit is not None:
        orbit_fit, is_thin = fast_fit
    else:
        orbit_fit = _fit_orbit(sharp, problem, blur, starts)
    for _ in range(2):
        if not _mask_depends_on_motion(sharp):
            break
        axes, _ = axes_from_moment(_reported_parameters(orbit_fit, k), np.eye(5))
        refined_problem = prepare_fit(sharp, patch, problem.initial_centre_px, known=(axes[:2], axes[2:4], axes[4:]))
        if refined_problem is None:
            break
        problem = refined_problem
        orbit_fit = _fit_orbit(sharp, problem, blur, [orbit_fit.p])
    if orbit_fit.dof <= 0:  # all is masked, or is bright enough to have been at white level
        return empty_measurement(sharp.name, flags | {Flag.NOT_FOUND})
    scale = noise_scale(sharp, orbit_fit)
    spread = robust_covariance(sharp, orbit_fit, problem.planes)
    lam, _, _, cov = principal_moments(orbit_fit.p[3 + k :], spread[3 + k :, 3 + k :])
    sd = np.sqrt(np.maximum(np.diag(cov), 0))
    # A round orbit and a defocus are indistinguishable: without controls, what one loses must not become the other.
    minor = lam[1] + (2 * (orbit_fit.p[2] - blur.mean_px2) if blur.anisotropy_px2 > 0 else 0.0)
    if (
        orbit
        and lam[0] > UNCERTAINTY.rest_sds * sd[0]
        and minor > UNCERTAINTY.rest_sds * np.hypot(sd[1], blur.anisotropy_px2)
    ):
        orbit_fit = gls_refine(
            sharp,
            problem,
            orbit_fit,
            forward_model(problem, closed_form.orbit_transfer, exact=True),
            orbit_fit.p[3 + k :],
            nuisance_prior(sharp, blur, 3),
        )
        spread = robust_covariance(sharp, orbit_fit, problem.planes)
        value, covariance = axes_from_moment(
            _reported_parameters(orbit_fit, k), spread[np.ix_(_reported_columns(k), _reported_columns(k))]
        )
        best, a, b = orbit_fit, value[2:4], value[4:]
    else:
        # Where a² is seen and b² is not, one step from the nearest straight path is exact to a hundredth of an sd.
        narrow = sharp.noise_known and orbit_fit.converged and abs(lam[1]) < UNCERTAINTY.rest_sds * sd[1]
        clear = narrow and lam[0] > UNCERTAINTY.rest_sds * sd[0]
        rest = _is_plain(sharp) and not is_thin and orbit_fit.converged and lam[0] < UNCERTAINTY.rest_sds * sd[0]
        best = _fit_straight(sharp, problem, blur, orbit_fit, scale, converged=is_thin or clear, held=rest)
        spread = robust_covariance(sharp, best, problem.planes)
        a, b, covariance = _straight_axes(best.p, spread, k, float(sd[1]))
    found_flags = quality_flags(sharp, best, a, b)
    if Flag.PART_CYCLES in flags and Flag.POOR_FIT not in sharp.flags:
        found_flags.discard(Flag.POOR_FIT)  # the part cycle explains what is left over
    flags = flags | found_flags
    size = float(np.hypot(*a))
    along = a / max(size, 1e-12)
    sd_along = float(np.sqrt(along @ covariance[2:4, 2:4] @ along))
    flags |= saturation_flags(problem.planes, min(sd_along, np.sqrt(sd[0])), size)
    # The amplitude shows by its square: it is seen when that exceeds three of its own standard deviations.
    sd_square = 2 * size * sd_along
    rest = lam[0] < UNCERTAINTY.rest_sds * sd[0]
    limit = float(np.hypot(sd_square, max(blur.anisotropy_px2, 0.0)))
    if rest or size**2 < UNCERTAINTY.rest_sds * limit:
        flags.add(Flag.AT_REST)
        covariance = _covariance_at_rest(covariance, size, max(limit, float(sd[0]) if rest else 0.0))
    return Measurement(
        sharp.name,
        best.p[:2].copy(),
        a,
        b,
        covariance,
        flags=frozenset(flags),
        defocus_px2=float(best.p[2]),
        chi2=best.chi2,
    )


def _is_plain(sharp: SharpTarget) -> bool:
    """A dot with reliable noise and nothing but paper texture on its paper: no fit of it needs more than one start."""
    return sharp.noise_known and isinstance(sharp.form, EllipseShape) and sharp.form.template_residual is None


def _fit_orbit_fast(
    sharp: SharpTarget, problem: FitProblem, blur: Defocus, start: FloatArray
) -> tuple[Solution, bool] | None:
    """The orbit's fit by way of one with the target's shape held: one step frees the shape. None where that fails.

    The second value is True where a long straight path was fitted first.
    """
    k = problem.shape_count
    prior = nuisance_prior(sharp, blur, 3)
    weights = pixel_weights(sharp, problem.planes)
    model = forward_model(problem, closed_form.orbit_transfer)
    fixed_problem = replace(problem, rest_spectra=problem.rest_spectra.fixed_shape)
    keep = [0, 1, 2, *range(3 + k, 6 + k)]
    held = Prior(prior.mean[keep], prior.precision[np.ix_(keep, keep)])

    def free_shape(at: FloatArray, moment: FloatArray, light: FloatArray) -> Solution | None:
        begin = np.concatenate((at[:3], np.zeros(k), moment))
        orbit_fit = gauss_newton_step(problem.planes, weights, model, begin, prior, light)
        kept = (
            orbit_fit.chi2 < UNCERTAINTY.poor_chi2
            and float(np.max(np.abs(orbit_fit.p[3 : 3 + k]))) < SOLVER.linear_step_px
        )
        return orbit_fit if kept else None

    values, vectors = np.linalg.eigh(moment_matrix(start[3 + k :]))
    if values[1] - values[0] >= WHOLE_CYCLES.min_fast_amplitude_px**2 and values[0] <= 0.1 * values[1] + 4.0:
        begin = np.concatenate((start[:3], np.sqrt(values[1]) * vectors[:, 1]))
        path = warm_start(
            problem.planes,
            weights,
            forward_model(fixed_problem, closed_form.straight_transfer),
            begin,
            Prior(held.mean[:5], held.precision[:5, :5]),
            LAST_PATH_STEP,
            bound=_clip_defocus,
        )
        if path is not None and float(np.hypot(*path[0][3:])) >= WHOLE_CYCLES.min_fast_amplitude_px:
            ax, ay = path[0][3:]
            orbit_fit = free_shape(path[0], np.array([ax**2, ax * ay, ay**2]), path[1])
            if orbit_fit is not None:
                lam, _, _, cov = principal_moments(orbit_fit.p[3 + k :], orbit_fit.covariance[3 + k :, 3 + k :])
                if lam[1] <= 2.0 * float(np.sqrt(cov[1, 1])):
                    return orbit_fit, True
    begin = np.concatenate((start[:3], start[3 + k :]))
    curve = warm_start(
        problem.planes,
        weights,
        forward_model(fixed_problem, closed_form.orbit_transfer),
        begin,
        held,
        LAST_ORBIT_STEP,
        bound=_orbit_bounds(0),
    )
    orbit_fit = free_shape(curve[0], curve[0][3:], curve[1]) if curve is not None else None
    return None if orbit_fit is None else (orbit_fit, False)


def _mask_depends_on_motion(sharp: SharpTarget) -> bool:
    form = sharp.form
    return isinstance(form, EllipseShape) and form.template_residual is not None and form.template_residual.needs_mask


def _orbit_bounds(k: int) -> Callable[[FloatArray], FloatArray]:
    """Keeps an orbit's parameters where its model is defined."""

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        low, axes = np.linalg.eigh(moment_matrix(p[3 + k :]))
        if low[0] < WHOLE_CYCLES.min_moment_eigenvalue_px2:
            fixed = axes @ np.diag(np.maximum(low, WHOLE_CYCLES.min_moment_eigenvalue_px2)) @ axes.T
            p[3 + k :] = fixed[0, 0], fixed[0, 1], fixed[1, 1]
        return _clip_defocus(p)

    return bound


def _clip_defocus(p: FloatArray) -> FloatArray:
    """Keeps the extra blur where a frame can have it."""
    p = p.copy()
    p[2] = np.clip(p[2], WHOLE_CYCLES.min_defocus_px2, WHOLE_CYCLES.max_defocus_px2)
    return p


def _fit_orbit(sharp: SharpTarget, problem: FitProblem, blur: Defocus, starts: list[FloatArray]) -> Solution:
    model = forward_model(problem, closed_form.orbit_transfer)
    prior = nuisance_prior(sharp, blur, 3)
    bound = _orbit_bounds(problem.shape_count)
    best: Solution | None = None
    for start in starts:
        found = solve(problem.planes, pixel_weights(sharp, problem.planes), model, start, prior, bound=bound)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    if not sharp.noise_known:
        # The prior must be weighed against the noise as it is found.
        weights = pixel_weights(sharp, problem.planes, noise_scale(sharp, best))
        best = solve(problem.planes, weights, model, best.p, prior, bound=bound, light=best.light)
    return correct_template_noise_bias(sharp, problem, best, closed_form.orbit_transfer)


def _fit_straight(
    sharp: SharpTarget,
    problem: FitProblem,
    blur: Defocus,
    orbit_fit: Solution,
    scale: float,
    *,
    converged: bool,
    held: bool,
) -> Solution:
    """The straight path: next to the orbit where `converged`; with a as the orbit says where `held`: it does not show.

    There, where paper texture is to be weighed, its own step is the only look at the image.
    """
    k = problem.shape_count
    prior = nuisance_prior(sharp, blur, 2)
    start, step = _nearest_straight_path(
        orbit_fit, k, WHOLE_CYCLES.fixed_moment_px2 if held else WHOLE_CYCLES.min_moment_px2
    )
    if held:
        precision = prior.precision.copy()
        precision[3 + k :, 3 + k :] = np.eye(2) / WHOLE_CYCLES.fixed_moment_px2**2
        prior = Prior(np.concatenate((prior.mean[: 3 + k], start[3 + k :])), precision)
    if held or converged:
        best = project_to_submodel(
            orbit_fit, nuisance_prior(sharp, blur, 3), start, step, _moment_jacobian(start[3 + k :], k), prior
        )
    else:
        weights, model = (
            pixel_weights(sharp, problem.planes, scale),
            forward_model(problem, closed_form.straight_transfer),
        )
        light = orbit_fit.light - orbit_fit.light_jacobian @ step
        best = solve(problem.planes, weights, model, start, prior, bound=_clip_defocus, light=light)
    exact = forward_model(problem, closed_form.straight_transfer, exact=True)
    ax, ay = best.p[3 + k :]
    best = gls_refine(sharp, problem, best, exact, np.array([ax**2, ax * ay, ay**2]), prior)
    return correct_template_noise_bias(sharp, problem, best, closed_form.straight_transfer)


def _moment_jacobian(a: FloatArray, k: int) -> FloatArray:
    """(6 + k, 5 + k) derivatives of an orbit's parameters by those of a straight path."""
    result = np.zeros((6 + k, 5 + k))
    result[: 3 + k, : 3 + k] = np.eye(3 + k)
    result[3 + k :, 3 + k :] = [[2 * a[0], 0.0], [a[1], a[0]], [0.0, 2 * a[1]]]
    return result


def _nearest_straight_path(orbit_fit: Solution, k: int, least_px2: float) -> tuple[FloatArray, FloatArray]:
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


def _reported_columns(k: int) -> list[int]:
    return [0, 1, 3 + k, 4 + k, 5 + k]


def _reported_parameters(orbit_fit: Solution, k: int) -> FloatArray:
    result: FloatArray = orbit_fit.p[_reported_columns(k)]
    return result


def _straight_axes(
    p: FloatArray, spread: FloatArray, k: int, sd_minor_px2: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    pick = [0, 1, 3 + k, 4 + k]
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = spread[np.ix_(pick, pick)]
    a = p[3 + k :]
    if not np.array_equal(orient_positive(a), a):
        covariance[:2, 2:4] *= -1
        covariance[2:4, :2] *= -1
        a = -a
    across = np.array([-a[1], a[0]]) / max(float(np.hypot(*a)), 1e-12)
    # b² is known to ± its own standard deviation, so |b| may be as large as the root of that.
    covariance[4:, 4:] = sd_minor_px2 * np.outer(across, across)
    return a, np.zeros(2), covariance


def _covariance_at_rest(covariance: FloatArray, size: float, sd_square: float) -> FloatArray:
    """Covariance with that of a replaced: near rest only a² is known, and its direction is not."""
    result = covariance.copy()
    sd = np.sqrt(size**2 + sd_square) - size
    result[2:4, :] = result[:, 2:4] = 0.0
    result[2:4, 2:4] = sd**2 * np.eye(2)
    return result
