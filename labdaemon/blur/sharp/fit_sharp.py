"""The disc at rest: centre, ellipse and lens blur from one or several sharp frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.label_settings import LABEL_EDGE
from labdaemon.blur.patch.colour_planes import ColourPlanes, FrequencyGrid, make_grid, make_planes
from labdaemon.blur.patch.illumination import paper_level
from labdaemon.blur.patch.label_outline import LabelOutline
from labdaemon.blur.patch.locate import Blob, find_blob, mask_pixels
from labdaemon.blur.patch.noise import estimate_noise
from labdaemon.blur.patch.paper_texture import estimate_residual_noise
from labdaemon.blur.patch.pixels import BoolArray, Dot, FloatArray, NoiseModel, Patch
from labdaemon.blur.settings import SHARP_FIT, TEXTURE_MAP
from labdaemon.blur.sharp.dot_skirt import without_skirts
from labdaemon.blur.sharp.target import EllipseShape, LensPsf, SharpTarget
from labdaemon.blur.sharp.template_residual import TemplateResidual, find_paper, find_template_residual
from labdaemon.blur.sharp.texture_map import map_paper_texture
from labdaemon.blur.sharp.weights import noise_weights
from labdaemon.blur.solver.reduced_equations import Prior, Solution
from labdaemon.blur.solver.solve import DarknessModel, gauss_newton_step, solve
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.spectra.render import render_darkness, shift_spectra, to_single
from labdaemon.errors import UsageError
from labdaemon.flags import Flag

COMMON_PARAMETERS = 6  # x, y, q0, q1, q2, blur variance, shared by all channels


def average_patches(patches: Sequence[Patch]) -> tuple[Patch, int]:
    """Mean of patches of the same rectangle; pixels valid in all. The second value is their number.

    Raises
    ------
    UsageError
        No patch, or patches of different rectangles.
    """
    if not patches:
        raise UsageError("no sharp patch was given; give at least one")
    first = patches[0]
    if any(p.shape != first.shape or p.origin_px != first.origin_px for p in patches):
        raise UsageError("sharp patches must cover the same rectangle of their frames")
    if len(patches) == 1:
        return first, 1
    valid = np.logical_and.reduce([p.valid for p in patches])
    values = np.mean([p.values for p in patches], axis=0)
    return Patch(values, first.channel, valid, first.origin_px), len(patches)


def fit_sharp(dot: Dot, patches: Sequence[Patch], *, noise: NoiseModel | None = None) -> SharpTarget:
    """Fit a dot at rest.

    Parameters
    ----------
    dot
        Where it was found, good to about a pixel.
    patches
        The same rectangle of one or several sharp frames, which are averaged. It should reach at least half a radius
        beyond the dot.
    noise
        Noise of a single frame; estimated from the patch if not given.

    Returns
    -------
    SharpTarget
        With `Flag.NOT_FOUND` where there is no dot to fit, `Flag.POOR_FIT` where it is not an ellipse behind a lens
        (another dot over it, a smeared sharp frame), `Flag.SATURATED` where white level hid too much.

    Raises
    ------
    UsageError
        No patch, or patches of different rectangles.
    DataError
        A patch off the frame, or an unknown colour filter.
    """
    patch, count = average_patches(patches)
    found = _fit_once(dot, patches, patch, count, noise, full_patch=False)
    if (
        not found.usable
        or found.chi2 < SHARP_FIT.max_noise_chi2
        or dot.paper_px - TEXTURE_MAP.edge_margin_px > _half_extent(dot)
    ):
        return found
    # A rough label is known by all that shows of it, its edge included.
    return _fit_once(dot, patches, patch, count, noise, full_patch=True)


def _fit_once(
    dot: Dot, patches: Sequence[Patch], patch: Patch, count: int, noise: NoiseModel | None, *, full_patch: bool
) -> SharpTarget:
    cut = _crop(dot, patch, full_patch=full_patch)
    if min(cut.shape) < 8:
        return _empty_target(dot, patch, noise or NoiseModel(1.0, 0.0), noise is not None, saturated=False)
    area = np.pi * dot.semi_major_px * dot.semi_minor_px
    first = noise if noise is not None else estimate_noise([_crop(dot, one, full_patch=full_patch) for one in patches])
    blob = find_blob(cut, np.array([dot.x_px, dot.y_px]), area, None)
    if blob is None or not 0.3 < blob.area_px2 / area < 3.0:
        return _empty_target(dot, cut, first, noise is not None, saturated=_all_hidden(cut))
    outline = LabelOutline(dot.label_px) if dot.label_px else None
    paper = find_paper(cut, np.array([dot.x_px, dot.y_px]), dot.semi_major_px)
    if outline is not None and not full_patch:
        paper &= _on_label(outline, dot, cut)
    planes = make_planes(mask_pixels(cut, ~paper))
    solution, lens = _fit_dot(dot, planes, _noise_of_mean(first, count), blob)
    template_residual = _template_residual(planes, paper, solution)
    texture_only = template_residual is not None and template_residual.is_paper_texture(
        float(np.max(solution.p[[2, 4]]))
    )
    used, noise_known = _select_noise(
        planes, solution, first, count, given=noise is not None, texture_only=texture_only
    )
    if texture_only and used.texture > 0:
        template_residual = None
    target = _build_target(dot, planes, template_residual, solution, lens, used, noise_known)
    target = replace(target, outline=outline)
    if not noise_known or not target.usable or template_residual is not None:
        return target
    radius, averaged = max(target.form.half_size_px), _noise_of_mean(used, count)
    bare = without_skirts(patch, target)
    texture_map, seen = map_paper_texture(bare, planes, solution, target.centre_px, radius, dot.paper_px, averaged)
    texture = used.texture if noise is not None and noise.texture else seen.texture
    return replace(target, texture_map=texture_map, noise=replace(used, texture=texture, texture_px=seen.texture_px))


def _on_label(outline: LabelOutline, dot: Dot, cut: Patch) -> BoolArray:
    """(h, w) pixels on the label, without its blurred end: the ground may be nearly as light as the label."""
    height, width = cut.shape
    x: FloatArray = np.arange(width, dtype=np.float64) + (cut.origin_px[0] - dot.x_px)
    y: FloatArray = (np.arange(height, dtype=np.float64) + (cut.origin_px[1] - dot.y_px))[:, None]
    result: BoolArray = outline.covers(x, y, LABEL_EDGE.sharp_margin_px) | (np.hypot(x, y) < dot.semi_major_px + 1.5)
    return result


def _noise_of_mean(noise: NoiseModel, frames: int) -> NoiseModel:
    """Noise of a mean of frames; the paper texture is the same in all."""
    return NoiseModel(noise.read_dn / np.sqrt(frames), noise.gain_dn / frames, noise.texture, noise.texture_px)


def _select_noise(
    planes: ColourPlanes, solution: Solution, first: NoiseModel, frames: int, *, given: bool, texture_only: bool
) -> tuple[NoiseModel, bool]:
    """The noise model for later fits, and whether it can be relied on.

    The residuals of a dot that fits are noise and paper texture. They are not where the dot does not fit: where they
    are much larger than what neighbouring pixels of one colour differ by, and not `texture_only`.
    """
    left = np.where(solution.weight > 0, solution.residual / np.sqrt(np.maximum(solution.weight, 1e-300)), 0.0)
    found = estimate_residual_noise(planes, left, solution.signal, solution.weight, frames)
    if given:
        return NoiseModel(first.read_dn, first.gain_dn, first.texture or found.texture, found.texture_px), True
    if solution.chi2 > SHARP_FIT.max_noise_chi2 and not texture_only:
        return first, False
    seen = solution.weight > 0
    paper = np.array(np.percentile(solution.signal[seen], 95) if seen.any() else 0.0)
    if found.variance(paper) < SHARP_FIT.min_noise_fraction * first.variance(paper):
        # A slightly overestimated strong texture leaves next to no noise, and every pixel would count as exact.
        read, gain = np.sqrt(SHARP_FIT.min_noise_fraction) * first.read_dn, SHARP_FIT.min_noise_fraction * first.gain_dn
        return NoiseModel(read, gain, found.texture, found.texture_px), True
    return found, True


def _half_extent(dot: Dot) -> float:
    """Half size of the part of the frame that is looked at."""
    return dot.semi_major_px + max(11.0, 0.8 * dot.semi_major_px)


def _crop(dot: Dot, patch: Patch, *, full_patch: bool) -> Patch:
    reach = _half_extent(dot)
    if not full_patch and dot.paper_px > dot.semi_major_px + 2 * TEXTURE_MAP.edge_margin_px:
        # The blurred edge of the paper darkens what lies before it; narrow labels are masked pixel by pixel instead.
        reach = min(
            reach, max(dot.paper_px - TEXTURE_MAP.edge_margin_px, dot.semi_major_px + TEXTURE_MAP.edge_margin_px)
        )
    left, top = int(np.floor(dot.x_px - reach)), int(np.floor(dot.y_px - reach))
    return patch.crop(left, top, int(np.ceil(dot.x_px + reach)) - left + 1, int(np.ceil(dot.y_px + reach)) - top + 1)


def _all_hidden(patch: Patch) -> bool:
    return bool(patch.valid.size and np.count_nonzero(patch.valid) < 0.2 * patch.valid.size)


def _empty_target(dot: Dot, patch: Patch, noise: NoiseModel, noise_known: bool, *, saturated: bool) -> SharpTarget:
    channels = np.unique(patch.channel).astype(np.int64)
    n = len(channels)
    lens = LensPsf(channels, np.zeros(n), np.zeros(n), np.zeros((n, 2)))
    form = EllipseShape(np.array([dot.semi_major_px, 0.0, dot.semi_minor_px]), lens, np.zeros((4, 4)))
    flags = {Flag.NOT_FOUND} | ({Flag.SATURATED} if saturated else set())
    nan = np.full((2, 2), np.nan)
    return SharpTarget(
        dot.name, nan[0], nan, form, {}, noise, noise_known, dot.paper_px, float("nan"), frozenset(flags)
    )


def unmeasurable_target(dot: Dot, flags: frozenset[Flag]) -> SharpTarget:
    """A target that was found but could not be fitted at rest: its place, its flags (or `poor_fit`), no numbers.

    Parameters
    ----------
    dot
        As found.
    flags
        What the fit says; empty where it had no solution.
    """
    lens = LensPsf(np.zeros(1, dtype=np.int64), np.zeros(1), np.zeros(1), np.zeros((1, 2)))
    form = EllipseShape(np.array([dot.semi_major_px, 0.0, dot.semi_minor_px]), lens, np.zeros((4, 4)))
    place, nan = np.array([dot.x_px, dot.y_px]), np.full((2, 2), np.nan)
    stated: frozenset[Flag] = (flags - {Flag.NOT_FOUND}) or frozenset({Flag.POOR_FIT})
    return SharpTarget(
        dot.name, place, nan, form, {}, NoiseModel(1.0, 0.0), False, chi2=float("nan"), flags=stated | {Flag.NOT_FOUND}
    )


def dot_model(planes: ColourPlanes, grid: FrequencyGrid) -> DarknessModel:
    """Darkness of a resting dot and its derivatives.

    Parameters are x, y, q0, q1, q2, blur variance, then for each colour plane the extra variance, the diffraction width
    and the offset in x and y.
    """
    n = planes.values.shape[0]
    f2 = grid.fx**2 + grid.fy**2
    f = np.sqrt(f2)
    flat = closed_form.pixel_transfer(grid.fx, grid.fy)

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        dark, by_q = closed_form.ellipse_spectrum(grid.fx, grid.fy, p[2:5])
        own = p[COMMON_PARAMETERS:].reshape(n, 4)
        # 0 the dot, 1..6 by the common parameters, 7 by the colour plane's own diffraction width
        spectra = np.empty((8, n, *f2.shape), dtype=np.complex128)
        for index in range(n):
            extra, width, ox, oy = own[index]
            gauss = (
                closed_form.gaussian_transfer(f2, p[5] + extra)
                * flat
                * np.exp(-2j * np.pi * (grid.fx * ox + grid.fy * oy))
            )
            blur = gauss * closed_form.diffraction_transfer(f, width)
            spectra[0, index] = dark * blur
            spectra[1, index] = -2j * np.pi * grid.fx * spectra[0, index]
            spectra[2, index] = -2j * np.pi * grid.fy * spectra[0, index]
            spectra[3:6, index] = by_q * blur
            spectra[6, index] = -2 * np.pi**2 * f2 * spectra[0, index]
            spectra[7, index] = dark * gauss * closed_form.diffraction_derivative(f, width)
        images = render_darkness(to_single(shift_spectra(spectra, grid, planes, p[:2])), grid, planes)
        slopes = np.zeros((len(p), *images.shape[1:]))
        slopes[:COMMON_PARAMETERS] = images[1:7]
        for index in range(n):
            base = COMMON_PARAMETERS + 4 * index
            slopes[base, index] = images[6, index]
            slopes[base + 1, index] = images[7, index]
            slopes[base + 2, index] = images[1, index]
            slopes[base + 3, index] = images[2, index]
        return images[0], slopes

    return model


def _fit_dot(dot: Dot, planes: ColourPlanes, noise: NoiseModel, blob: Blob) -> tuple[Solution, LensPsf]:
    n, height, width = planes.values.shape
    c, s = np.cos(dot.angle_rad), np.sin(dot.angle_rad)
    big, small = dot.semi_major_px, dot.semi_minor_px
    q = [big * c * c + small * s * s, (big - small) * c * s, big * s * s + small * c * c]
    near = blob.centre_px if np.hypot(*(blob.centre_px - (dot.x_px, dot.y_px))) < big else (dot.x_px, dot.y_px)
    start = np.concatenate(([near[0], near[1]], q, [0.8], np.tile([0.0, 0.5, 0.0, 0.0], n)))
    # A channel's own blur and offset are small; with one channel they are the common ones. The width is tied loosely.
    sd_own = np.array([0.7, 2.0, 0.5, 0.5]) if n > 1 else np.array([1e-4, 2.0, 1e-5, 1e-5])
    mean = np.concatenate((np.zeros(COMMON_PARAMETERS), np.tile([0.0, 0.0, 0.0, 0.0], n)))
    precision = np.concatenate((np.full(COMMON_PARAMETERS, 1e-10), np.tile(1 / sd_own**2, n)))
    prior = Prior(mean, np.diag(precision))

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[2], p[4] = max(p[2], 1.0), max(p[4], 1.0)
        p[5] = np.clip(p[5], -0.2, 60.0)
        p[COMMON_PARAMETERS + 1 :: 4] = np.clip(p[COMMON_PARAMETERS + 1 :: 4], 0.0, 8.0)
        return p

    weights = noise_weights(noise, planes)
    size = (height * planes.period + SHARP_FIT.margin_px, width * planes.period + SHARP_FIT.margin_px)
    model = dot_model(planes, make_grid(size))
    solution = solve(planes, weights, model, start, prior, bound=bound, max_iterations=40)
    if _lens_psf(planes, solution).resolves_pixels:
        model = dot_model(planes, make_grid(size, oversampling=2))
        solution = solve(planes, weights, model, solution.p, prior, bound=bound, light=solution.light)
    return solution, _lens_psf(planes, solution)


def _is_blurred(planes: ColourPlanes, solution: Solution) -> bool:
    """Whether a dot that fits badly moved while it was taken: blurred to one side, and badly fitted because of it."""
    size = [planes.period * length + SHARP_FIT.margin_px for length in planes.values.shape[1:]]
    grid = make_grid((size[0], size[1]))
    resting = dot_model(planes, grid)
    lens = _lens_psf(planes, solution)
    spectra, _ = EllipseShape(solution.p[2:5], lens, np.zeros((4, 4))).spectra(grid, planes.channel)
    own = solution.p[COMMON_PARAMETERS:].reshape(len(planes.channel), 4)
    centre = solution.p[:2] + own[:, 2:4].mean(axis=0)

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        dark, by_rest = resting(solution.p)
        squares = np.stack((grid.fx**2, 2 * grid.fx * grid.fy, grid.fy**2)) * (-(np.pi**2))
        by_moment = render_darkness(shift_spectra(squares[:, None] * spectra, grid, planes, centre), grid, planes)
        return dark, np.concatenate((by_rest[:5], by_moment))

    start = np.concatenate((solution.p[:5], np.zeros(3)))
    found = gauss_newton_step(
        planes, lambda _: solution.weight, model, start, Prior(start, np.eye(8) * 1e-10), solution.light
    )
    values = np.linalg.eigvalsh(np.array([[found.p[5], found.p[6]], [found.p[6], found.p[7]]]))
    step = found.p - start
    explained = float(step @ np.linalg.pinv(found.covariance, hermitian=True) @ step) / max(solution.cost, 1e-12)
    return bool(values[1] - values[0] > SHARP_FIT.blurred_px2 and explained > SHARP_FIT.blurred_cost_fraction)


def _lens_psf(planes: ColourPlanes, solution: Solution) -> LensPsf:
    own = solution.p[COMMON_PARAMETERS:].reshape(len(planes.channel), 4)
    return LensPsf(planes.channel, solution.p[5] + own[:, 0], own[:, 1], own[:, 2:4] - own[:, 2:4].mean(axis=0))


def _template_residual(planes: ColourPlanes, paper: BoolArray, solution: Solution) -> TemplateResidual | None:
    """What the fit left over, in units of the dot's darkness."""
    level = paper_level(planes, solution.light) * solution.light[:, 3, None, None]
    level = np.where(np.abs(level) > 1e-9, level, 1.0)
    weight = solution.weight
    residual = np.where(weight > 0, -solution.residual / np.sqrt(np.maximum(weight, 1e-300)) / level, 0.0)
    variance = np.where(weight > 0, 1 / np.maximum(weight, 1e-300) / level**2, 0.0)
    own = solution.p[COMMON_PARAMETERS:].reshape(len(planes.channel), 4)
    centre = solution.p[:2] + own[:, 2:4].mean(axis=0)
    return find_template_residual(planes, residual, variance, paper, centre)


def _build_target(
    dot: Dot,
    planes: ColourPlanes,
    template_residual: TemplateResidual | None,
    solution: Solution,
    lens: LensPsf,
    noise: NoiseModel,
    noise_known: bool,
) -> SharpTarget:
    chi2 = (
        _chi2_with(noise, planes, solution) if noise_known and template_residual is None else solution.chi2
    )  # paper texture is noise too
    scale = (
        max(solution.chi2, 1.0) if template_residual is None else 1.0
    )  # but shared by neighbours, so that it weighs more
    covariance = solution.covariance * scale
    n = planes.values.shape[0]
    # The blur that a fit of motion can confuse with motion is the mean over channels, extra and diffraction together.
    slope = np.zeros((4, len(solution.p)))
    slope[0, 2] = slope[1, 3] = slope[2, 4] = slope[3, 5] = 1.0
    for index in range(n):
        slope[3, COMMON_PARAMETERS + 4 * index] = 1 / n
        slope[3, COMMON_PARAMETERS + 4 * index + 1] = 0.45 * solution.p[COMMON_PARAMETERS + 4 * index + 1] / n
    q = solution.p[2:5]
    form = EllipseShape(q, lens, slope @ covariance @ slope.T, template_residual)
    flags = set()
    axes = np.linalg.eigvalsh(np.array([[q[0], q[1]], [q[1], q[2]]]))
    seen = [bool(w.any()) for w in solution.weight]
    contrast = {int(c): float(k) for c, k, ok in zip(planes.channel, solution.light[:, 3], seen, strict=True) if ok}
    fitted = 0.5 < axes[0] / dot.semi_minor_px < 2 and np.all(np.isfinite(solution.p)) and min(contrast.values()) > 0.02
    if not fitted:
        flags.add(Flag.NOT_FOUND)
    if chi2 > SHARP_FIT.max_noise_chi2 and template_residual is None:
        flags.add(Flag.POOR_FIT)
    if chi2 > SHARP_FIT.blur_test_chi2 and _is_blurred(planes, solution):
        flags.add(Flag.POOR_FIT)
    # The channels' offsets are relative to the target's own centre: on average there is none.
    mean = np.zeros((2, len(solution.p)))
    mean[0, 0] = mean[1, 1] = 1.0
    mean[0, COMMON_PARAMETERS + 2 :: 4] = mean[1, COMMON_PARAMETERS + 3 :: 4] = 1 / n
    centre, cov = mean @ solution.p, mean @ covariance @ mean.T
    return SharpTarget(dot.name, centre, cov, form, contrast, noise, noise_known, dot.paper_px, chi2, frozenset(flags))


def _chi2_with(noise: NoiseModel, planes: ColourPlanes, solution: Solution) -> float:
    """Residual variance over what noise and paper texture make of it."""
    used = solution.weight > 0
    raw = solution.residual[used] ** 2 / solution.weight[used]
    return float(np.sum(raw * noise_weights(noise, planes)(solution.signal)[used])) / max(solution.dof, 1)
