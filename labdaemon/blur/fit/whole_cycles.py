"""A sinusoid over whole cycles, phase unknown: the everyday measurement."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.fit.accelerated import ACCELERATED
from labdaemon.blur.fit.direct import OrbitFit, SquaredAxes, WholeCycleFits
from labdaemon.blur.fit.texture import measure_texture
from labdaemon.blur.motion import Defocus, Measurement, empty_measurement
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.target import EllipseShape, SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.sharp.weights import nuisance_prior
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem, prepare_fit
from labdaemon.blur.smear.gls import gls_refine
from labdaemon.blur.smear.uncertainty import (
    anisotropy_covariance,
    covariance_at_rest,
    quality_flags,
    robust_covariance,
    saturation_flags,
    straight_path_covariance,
)
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.spectra import closed_form
from labdaemon.flags import Flag
from labdaemon.orbit_axes import axes_from_moment


def measure_whole_cycles(
    sharp: SharpTarget,
    patch: Patch,
    problem: FitProblem,
    blur: Defocus,
    *,
    orbit: bool,
    flags: set[Flag],
    fits: WholeCycleFits = ACCELERATED,
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
    fits
        The two fits: `DIRECT`, or `ACCELERATED` for the same result in less time.
    """
    orbit_fit, problem = _fit_orbit_and_mask(sharp, patch, problem, blur, fits)
    solution, k = orbit_fit.solution, problem.shape_count
    if solution.dof <= 0:  # all is masked, or is bright enough to have been at white level
        return empty_measurement(sharp.name, flags | {Flag.NOT_FOUND})
    if isinstance(sharp.form, TexturedPatch):
        return measure_texture(sharp, sharp.form, problem, blur, solution, orbit=orbit, flags=flags)
    covariance = robust_covariance(sharp, solution, problem.planes)
    axes = SquaredAxes.of_moment(solution.p[3 + k :], covariance[3 + k :, 3 + k :])
    if orbit and _shows_minor_axis(axes, solution, blur):
        best, a, b, covariance = _refine_orbit(sharp, problem, blur, solution)
    else:
        best = fits.straight(sharp, problem, blur, orbit_fit, axes)
        covariance = robust_covariance(sharp, best, problem.planes)
        a, b, covariance = straight_path_covariance(best.p, covariance, k, float(axes.sd_px2[1]))
    found_flags = quality_flags(sharp, best, a, b)
    if Flag.PART_CYCLES in flags and Flag.POOR_FIT not in sharp.flags:
        found_flags.discard(Flag.POOR_FIT)  # the part cycle explains the remaining residuals
    flags = flags | found_flags
    size = float(np.hypot(*a))
    along = a / max(size, 1e-12)
    sd_along = float(np.sqrt(along @ covariance[2:4, 2:4] @ along))
    flags |= saturation_flags(problem.planes, min(sd_along, np.sqrt(axes.sd_px2[0])), size)
    # The amplitude shows by its square: it is seen when that exceeds three of its own standard deviations.
    rest = axes.values_px2[0] < UNCERTAINTY.rest_sds * axes.sd_px2[0]
    covariance[2:4, 2:4] += anisotropy_covariance(a, blur.sd_anisotropy_px2)
    limit = float(np.hypot(2 * size * sd_along, max(blur.anisotropy_px2, 0.0)))
    if rest or size**2 < UNCERTAINTY.rest_sds * limit:
        flags.add(Flag.AT_REST)
        covariance = covariance_at_rest(covariance, size, max(limit, float(axes.sd_px2[0]) if rest else 0.0))
    centre, defocus_px2 = best.p[:2].copy(), float(best.p[2])
    return Measurement(
        sharp.name, centre, a, b, covariance, flags=frozenset(flags), defocus_px2=defocus_px2, chi2=best.chi2
    )


def _fit_orbit_and_mask(
    sharp: SharpTarget, patch: Patch, problem: FitProblem, blur: Defocus, fits: WholeCycleFits
) -> tuple[OrbitFit, FitProblem]:
    """Fit an orbit; where the mask of known paper depends on the motion, fit again under the mask of the result."""
    found = fits.orbit(sharp, problem, blur)
    form = sharp.form
    if not (
        isinstance(form, EllipseShape) and form.template_residual is not None and form.template_residual.needs_mask
    ):
        return found, problem
    for _ in range(2):
        axes, _ = axes_from_moment(found.solution.p[_reported(problem.shape_count)], np.eye(5))
        masked = prepare_fit(sharp, patch, problem.initial_centre_px, known=(axes[:2], axes[2:4], axes[4:]))
        if masked is None:
            break
        problem = masked
        found = fits.orbit(sharp, problem, blur, found.solution.p)
    return found, problem


def _shows_minor_axis(axes: SquaredAxes, solution: Solution, blur: Defocus) -> bool:
    """Whether both axes exceed the detection limit.

    A round orbit and a defocus are indistinguishable: without control targets, what the defocus loses must not become
    a minor axis.
    """
    minor = axes.values_px2[1] + (2 * (solution.p[2] - blur.mean_px2) if blur.anisotropy_px2 > 0 else 0.0)
    limit = UNCERTAINTY.rest_sds * np.hypot(axes.sd_px2[1], blur.anisotropy_px2)
    return axes.shows_major and bool(minor > limit)


def _refine_orbit(
    sharp: SharpTarget, problem: FitProblem, blur: Defocus, solution: Solution
) -> tuple[Solution, FloatArray, FloatArray, FloatArray]:
    """The orbit with the paper texture in its weights: solution, a, b and the (6, 6) covariance of x, y, a, b."""
    k = problem.shape_count
    model = fast_forward_model(problem, closed_form.orbit_transfer, exact=True)
    refined = gls_refine(sharp, problem, solution, model, solution.p[3 + k :], nuisance_prior(sharp, blur, 3))
    covariance = robust_covariance(sharp, refined, problem.planes)
    pick = _reported(k)
    value, covariance = axes_from_moment(refined.p[pick], covariance[np.ix_(pick, pick)])
    return refined, value[2:4], value[4:], covariance


def _reported(k: int) -> list[int]:
    """Columns of x, y, m0, m1, m2 among the parameters of an orbit's fit."""
    return [0, 1, 3 + k, 4 + k, 5 + k]
