"""A textured patch's motion over whole cycles: what its texture shows, and a statement of what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur.defocus_settings import DEFOCUS
from labdaemon.blur.fit.accelerated import nearest_straight_path
from labdaemon.blur.fit.direct import SquaredAxes, clip_defocus, fit_orbit, orbit_bounds
from labdaemon.blur.motion import Defocus, Measurement, empty_measurement
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.texture_structure import TextureStructure, texture_structure
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.sharp.weights import nuisance_prior
from labdaemon.blur.smear.defocus import default_defocus
from labdaemon.blur.smear.errors_in_variables import TextureEquations
from labdaemon.blur.smear.fit_problem import FitProblem, prepare_fit
from labdaemon.blur.smear.mixed_motion import motion_varies
from labdaemon.blur.smear.texture_fit import TextureFit, fit_texture
from labdaemon.blur.smear.uncertainty import (
    covariance_at_rest,
    quality_flags,
    saturation_flags,
    straight_path_covariance,
)
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.texture_settings import TEXTURE
from labdaemon.blur.unsolvable import solved
from labdaemon.flags import Flag
from labdaemon.orbit_axes import axes_from_moment, orient_positive


def measure_texture(
    sharp: SharpTarget,
    form: TexturedPatch,
    problem: FitProblem,
    blur: Defocus,
    first: Solution,
    *,
    orbit: bool,
    flags: set[Flag],
) -> Measurement:
    """Measure by the fit that accounts for the sharp frame's noise.

    Parameters
    ----------
    sharp, form, problem, blur
        The target, its form, the blurred patch, and the frame's defocus.
    first
        An orbit's fit by least squares: its weights and illumination are kept, its motion may be noise.
    orbit
        False forces straight motion.
    flags
        Flags to start with.
    """
    seen = fit_moment(sharp, form, problem, blur, first)
    if seen is None:
        return empty_measurement(sharp.name, flags | {Flag.NOT_FOUND})
    best, structure = seen
    k = problem.shape_count
    flags = flags | quality_flags(sharp, first, np.zeros(2), np.zeros(2))
    if not structure.shows_along:
        if motion_varies(problem, best, structure.across):
            flags.add(Flag.MIXED_MOTION)
        return _across_only(sharp, form, best, structure, k, flags | {Flag.UNDETERMINED}, first.chi2)
    return _whole_motion(sharp, form, problem, blur, first, best, orbit=orbit, flags=flags)


def fit_moment(
    sharp: SharpTarget, form: TexturedPatch, problem: FitProblem, blur: Defocus, first: Solution
) -> tuple[TextureFit, TextureStructure] | None:
    """Fit the second moment of the motion, as far as the texture shows it; None without texture or solution.

    Parameters
    ----------
    sharp, form, problem, blur, first
        As for `measure_texture`.
    """
    equations = TextureEquations(problem, form, first, closed_form.bounded_orbit_transfer)
    noise = _template_variance(sharp, form, first, equations)
    structure = texture_structure(form, noise)
    if not structure.shows_across:
        return None
    k = problem.shape_count
    basis = None if structure.shows_along else _visible_basis(structure.across, k)
    prior = nuisance_prior(sharp, blur, 3)
    starts = [first.p]
    if not structure.shows_along or np.max(np.abs(first.p[3 + k :])) < TEXTURE.rest_start_px2:
        starts.append(_at_rest(first.p, problem))
    starts = [_visible_start(start, problem, structure, k) for start in starts]
    power = equations.at(np.append(first.p, 1.0)).noise_power
    bound = orbit_bounds(k)
    tried = [
        solved(fit_texture)(equations, start, prior, bound=bound, basis=basis, noise_power=power) for start in starts
    ]
    fits = [one for one in tried if one is not None]
    if not fits:
        return None
    return min(fits, key=lambda one: one.cost), structure


def _whole_motion(
    sharp: SharpTarget,
    form: TexturedPatch,
    problem: FitProblem,
    blur: Defocus,
    first: Solution,
    best: TextureFit,
    *,
    orbit: bool,
    flags: set[Flag],
) -> Measurement:
    k = problem.shape_count
    moment, spread = best.p[3 + k :], best.covariance[3 + k :, 3 + k :]
    axes = SquaredAxes.of_moment(moment, spread)
    sd_major, sd_minor = (float(v) for v in axes.sd_px2[:2])
    start, step = nearest_straight_path(replace(first, p=best.p, covariance=best.covariance), k, 0.05)
    # The texture may show one direction far better than the other: what moves is what rest explains worse than a path.
    evidence = float(moment @ np.linalg.solve(spread, moment) - step[3 + k :] @ np.linalg.solve(spread, step[3 + k :]))
    moves = evidence > TEXTURE.rest_evidence
    if motion_varies(problem, best, start[3 + k :]):
        flags.add(Flag.MIXED_MOTION)
    sd_round = float(np.hypot(sd_minor, 2 * TEXTURE.extra_blur_sd_px2))
    if orbit and axes.shows_major and axes.values_px2[1] > UNCERTAINTY.rest_sds * sd_round:
        pick = [0, 1, 3 + k, 4 + k, 5 + k]
        value, covariance = axes_from_moment(best.p[pick], best.covariance[np.ix_(pick, pick)])
        centre, a, b = value[:2], value[2:4], value[4:]
    else:
        if moves:
            straight = TextureEquations(problem, form, first, closed_form.straight_transfer)
            path = fit_texture(straight, start, nuisance_prior(sharp, blur, 2), bound=clip_defocus)
            p, covariance = path.p, path.covariance
        else:
            p = start
            covariance = np.zeros((5 + k, 5 + k))
            covariance[: 3 + k, : 3 + k] = best.covariance[: 3 + k, : 3 + k]
        centre = p[:2]
        a, b, covariance = straight_path_covariance(p, covariance, k, sd_minor)
        if moves:
            a, covariance = _without_extra_blur(a, covariance, moment, spread)
    size = float(np.hypot(*a))
    along = a / max(size, 1e-12)
    sd_along = float(np.sqrt(max(float(along @ covariance[2:4, 2:4] @ along), 0.0)))
    sd_seen = min(sd_along, float(np.sqrt(sd_major))) if moves else float(np.sqrt(sd_major))
    flags |= saturation_flags(problem.planes, sd_seen, size)
    limit = 2 * size * sd_along
    if not moves or size**2 < UNCERTAINTY.rest_sds * limit:
        flags.add(Flag.AT_REST)
        covariance = covariance_at_rest(covariance, size, max(limit, sd_major))
    return Measurement(
        sharp.name,
        centre.copy(),
        a,
        b,
        covariance,
        flags=frozenset(flags),
        defocus_px2=float(best.p[2]),
        chi2=first.chi2,
    )


def _without_extra_blur(
    a: FloatArray, covariance: FloatArray, moment: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Major axis and covariance of a straight path, less the sharpness that the frame lost in all directions.

    Across a straight path the second moment shows nothing but extra blur. Its prior, the two components of the moment
    and their covariance give the part of it that is in the squared amplitude.

    Parameters
    ----------
    a, covariance
        (2,) and (6, 6) of the fit without extra blur.
    moment, spread
        (3,) second moment and its covariance.
    """
    size = float(np.hypot(*a))
    c, s = a / max(size, 1e-12)
    rays = np.array([[c * c, 2 * c * s, s * s], [s * s, -2 * c * s, c * c]])
    seen, variance = rays @ moment, rays @ spread @ rays.T
    across = max(float(variance[1, 1]), 1e-12)
    prior = (2 * TEXTURE.extra_blur_sd_px2) ** 2
    blur = float(seen[1]) * prior / (prior + across)
    shift = (1 - float(variance[0, 1]) / across) * blur
    extra = (1 - float(variance[0, 1]) / across) ** 2 * prior * across / (prior + across)
    extra += (DEFOCUS.anisotropy_fraction * blur) ** 2  # it need not be the same along the path
    longer = float(np.sqrt(max(size**2 - shift, size**2 / 4)))
    result = covariance.copy()
    result[2:4, 2:4] += extra / (4 * longer**2) * np.outer((c, s), (c, s))
    return a * (longer / max(size, 1e-12)), result


def _across_only(
    sharp: SharpTarget,
    form: TexturedPatch,
    best: TextureFit,
    structure: TextureStructure,
    k: int,
    flags: set[Flag],
    chi2: float,
) -> Measurement:
    """The component that the texture shows; the other one is as uncertain as the box is long."""
    across, along = structure.across, structure.along
    ray = np.array([across[0] ** 2, 2 * across[0] * across[1], across[1] ** 2])
    moment = best.p[3 + k :]
    square = float(ray @ moment)
    sd_square = float(np.sqrt(max(float(ray @ best.covariance[3 + k :, 3 + k :] @ ray), 0.0)))
    size = float(np.sqrt(max(square, 0.0)))
    sd_size = float(np.sqrt(size**2 + sd_square) - size) if square < 3 * sd_square else sd_square / (2 * size)
    unseen = max(form.half_size_px) ** 2 * np.outer(along, along)
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = best.covariance[:2, :2] + unseen
    covariance[2:4, 2:4] = sd_size**2 * np.outer(across, across) + unseen
    covariance[4:, 4:] = sd_square * np.outer(across, across) + unseen
    return Measurement(
        sharp.name,
        best.p[:2].copy(),
        orient_positive(size * across),
        np.zeros(2),
        covariance,
        flags=frozenset(flags),
        defocus_px2=float(best.p[2]),
        chi2=chi2,
    )


def _template_variance(sharp: SharpTarget, form: TexturedPatch, first: Solution, equations: TextureEquations) -> float:
    """Variance of the sharp patch's darkness: by the residuals or by its own fine structure, whichever is less.

    Both are upper bounds: residuals hold what the model lacks, and fine structure may be texture.
    """
    level = float(np.mean(first.signal[first.weight > 0])) if np.any(first.weight > 0) else 0.0
    own = float(sharp.noise.variance(np.array([level]))[0])
    here = equations.at(np.append(first.p, 1.0))
    used = first.weight > 0
    found = here.noise_power / max(float(np.mean(first.weight[used])), 1e-300) if used.any() else own
    return min(own, found) / form.frames / max(form.spread_dn, 1e-12) ** 2


def _visible_basis(across: FloatArray, k: int) -> FloatArray:
    """(7 + k, 5 + k − …) directions of the parameters that structure along `across` alone determines."""
    columns = []
    for index in range(7 + k):
        one = np.zeros(7 + k)
        if index in (1, 4 + k, 5 + k):
            continue
        if index == 0:
            one[:2] = across
        elif index == 3 + k:
            one[3 + k : 6 + k] = across[0] ** 2, across[0] * across[1], across[1] ** 2
        else:
            one[index] = 1.0
        columns.append(one)
    return np.stack(columns, axis=1)


def _visible_start(p: FloatArray, problem: FitProblem, structure: TextureStructure, k: int) -> FloatArray:
    """Parameters with the invisible components removed: the shift along the stripes, and the motion along them."""
    if structure.shows_along:
        return p.copy()
    p, across = p.copy(), structure.across
    shift = (p[:2] - problem.initial_centre_px) @ across
    p[:2] = problem.initial_centre_px + shift * across
    ray = np.array([across[0] ** 2, across[0] * across[1], across[1] ** 2])
    square = float(np.array([1, 2, 1]) * ray @ p[3 + k :])
    p[3 + k :] = square * ray
    return p


def _at_rest(p: FloatArray, problem: FitProblem) -> FloatArray:
    """The same place without motion or distortion: where noise has led a fit away from rest, this finds back."""
    result = p.copy()
    result[:2] = problem.initial_centre_px
    result[3:] = 0.0
    return result


def measure_moment(sharp: SharpTarget, patch: Patch) -> tuple[FloatArray, FloatArray] | None:
    """Second moment (m0, m1, m2) of a textured patch's motion, px², and its (3, 3) covariance.

    Near rest this has no bias, while an amplitude cannot be less than 0. None where the texture does not show both
    directions, or the fit has no solution.

    Parameters
    ----------
    sharp, patch
        A target made by `make_textured_patch`, and the blurred patch.
    """
    problem = prepare_fit(sharp, patch, sharp.centre_px) if sharp.usable else None
    if problem is None or not isinstance(sharp.form, TexturedPatch):
        return None
    blur = default_defocus(sharp)
    seen = fit_moment(sharp, sharp.form, problem, blur, fit_orbit(sharp, problem, blur).solution)
    if seen is None or not seen[1].shows_along:
        return None
    first = 3 + problem.shape_count
    return seen[0].p[first:], seen[0].covariance[first:, first:]
