"""The disc at rest: centre, ellipse and lens blur from one or several sharp frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.patch.grain import noise_of_residuals
from labdaemon.blur.patch.light import light_level
from labdaemon.blur.patch.locate import Blob, find_blob, masked
from labdaemon.blur.patch.mosaic import Grid, Planes, make_grid, split
from labdaemon.blur.patch.noise import estimate_noise
from labdaemon.blur.patch.pixels import BoolArray, Dot, FloatArray, NoiseModel, Patch
from labdaemon.blur.sharp.papermap import EDGE_PX, map_paper
from labdaemon.blur.sharp.relief import Relief, find_relief, paper_around
from labdaemon.blur.sharp.target import Ellipse, Lens, SharpTarget
from labdaemon.blur.sharp.weights import noise_weights
from labdaemon.blur.solver.normal import Prior, Solution
from labdaemon.blur.solver.solve import Model, one_step, solve
from labdaemon.blur.spectra import shapes
from labdaemon.blur.spectra.render import darkness, shifted, single
from labdaemon.errors import UsageError
from labdaemon.flags import Flag

COMMON = 6  # x, y, q0, q1, q2, blur variance, shared by all channels
SMEARED_PX2, SMEARED_PART = 1.0, 0.35  # one-sided blur of a sharp frame, as a², and its part in the residuals
MARGIN_PX = 16  # between a patch and its periodic images
SUSPECT_CHI2 = 1.5  # from which a sharp frame is tested for smear; neighbours judge noise to a factor of two
LEFT_BY_GRAIN = 0.75  # of the noise between neighbours; less than this it does not get by taking grain off
DOUBTFUL_CHI2 = 4.0  # of the fit against noise judged by neighbours, above which the residuals are not noise


def average(patches: Sequence[Patch]) -> tuple[Patch, int]:
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
    patch, count = average(patches)
    found = _attempt(dot, patches, patch, count, noise, wide=False)
    if not found.usable or found.chi2 < DOUBTFUL_CHI2 or dot.paper_px - EDGE_PX > _reach(dot):
        return found
    # A rough label is known by all that shows of it, its edge included.
    return _attempt(dot, patches, patch, count, noise, wide=True)


def _attempt(
    dot: Dot, patches: Sequence[Patch], patch: Patch, count: int, noise: NoiseModel | None, *, wide: bool
) -> SharpTarget:
    cut = _crop(dot, patch, wide=wide)
    if min(cut.shape) < 8:
        return _nothing(dot, patch, noise or NoiseModel(1.0, 0.0), noise is not None, saturated=False)
    area = np.pi * dot.semi_major_px * dot.semi_minor_px
    first = noise if noise is not None else estimate_noise([_crop(dot, one, wide=wide) for one in patches])
    blob = find_blob(cut, np.array([dot.x_px, dot.y_px]), area, None)
    if blob is None or not 0.3 < blob.area_px2 / area < 3.0:
        return _nothing(dot, cut, first, noise is not None, saturated=_all_hidden(cut))
    paper = paper_around(cut, np.array([dot.x_px, dot.y_px]), dot.semi_major_px)
    planes = split(masked(cut, ~paper))
    solution, lens = _fit(dot, planes, _mean_of(first, count), blob)
    relief = _relief(planes, paper, solution)
    grainy = relief is not None and relief.is_grain(float(np.max(solution.p[[2, 4]])))
    used, known = _noise(planes, solution, first, count, given=noise is not None, grainy=grainy)
    if grainy and used.texture > 0:
        relief = None
    target = _target(dot, planes, relief, solution, lens, used, known)
    if not known or not target.usable or relief is not None:
        return target
    radius = max(target.form.half_size_px)
    averaged = _mean_of(used, count)
    grain, seen = map_paper(patch, planes, solution, target.centre_px, radius, dot.paper_px, averaged)
    texture = used.texture if noise is not None and noise.texture else seen.texture
    return replace(target, paper=grain, noise=replace(used, texture=texture, texture_px=seen.texture_px))


def _mean_of(noise: NoiseModel, frames: int) -> NoiseModel:
    """Noise of a mean of frames; the paper's grain is the same in all."""
    return NoiseModel(noise.read_dn / np.sqrt(frames), noise.gain_dn / frames, noise.texture, noise.texture_px)


def _noise(
    planes: Planes, solution: Solution, first: NoiseModel, frames: int, *, given: bool, grainy: bool
) -> tuple[NoiseModel, bool]:
    """The noise model for later fits, and whether it can be relied on.

    The residuals of a dot that fits are noise and grain. They are not where the dot does not fit: where they are much
    larger than what neighbouring pixels of one colour differ by, and not `grainy`.
    """
    left = np.where(solution.weight > 0, solution.residual / np.sqrt(np.maximum(solution.weight, 1e-300)), 0.0)
    found = noise_of_residuals(planes, left, solution.signal, solution.weight, frames)
    if given:
        return NoiseModel(first.read_dn, first.gain_dn, first.texture or found.texture, found.texture_px), True
    if solution.chi2 > DOUBTFUL_CHI2 and not grainy:
        return first, False
    seen = solution.weight > 0
    paper = np.array(np.percentile(solution.signal[seen], 95) if seen.any() else 0.0)
    if found.variance(paper) < LEFT_BY_GRAIN * first.variance(paper):
        # Of strong grain a little too much taken off leaves next to nothing, and would have every pixel believed.
        read, gain = np.sqrt(LEFT_BY_GRAIN) * first.read_dn, LEFT_BY_GRAIN * first.gain_dn
        return NoiseModel(read, gain, found.texture, found.texture_px), True
    return found, True


def _reach(dot: Dot) -> float:
    """Half size of the part of the frame that is looked at."""
    return dot.semi_major_px + max(11.0, 0.8 * dot.semi_major_px)


def _crop(dot: Dot, patch: Patch, *, wide: bool) -> Patch:
    reach = _reach(dot)
    if not wide and dot.paper_px > dot.semi_major_px + 2 * EDGE_PX:
        # The blurred edge of the paper darkens what lies before it; narrow labels are masked pixel by pixel instead.
        reach = min(reach, max(dot.paper_px - EDGE_PX, dot.semi_major_px + EDGE_PX))
    left, top = int(np.floor(dot.x_px - reach)), int(np.floor(dot.y_px - reach))
    return patch.crop(left, top, int(np.ceil(dot.x_px + reach)) - left + 1, int(np.ceil(dot.y_px + reach)) - top + 1)


def _all_hidden(patch: Patch) -> bool:
    return bool(patch.valid.size and np.count_nonzero(patch.valid) < 0.2 * patch.valid.size)


def _nothing(dot: Dot, patch: Patch, noise: NoiseModel, known: bool, *, saturated: bool) -> SharpTarget:
    channels = np.unique(patch.channel).astype(np.int64)
    n = len(channels)
    lens = Lens(channels, np.zeros(n), np.zeros(n), np.zeros((n, 2)))
    form = Ellipse(np.array([dot.semi_major_px, 0.0, dot.semi_minor_px]), lens, np.zeros((4, 4)))
    flags = {Flag.NOT_FOUND} | ({Flag.SATURATED} if saturated else set())
    nan = np.full((2, 2), np.nan)
    return SharpTarget(dot.name, nan[0], nan, form, {}, noise, known, dot.paper_px, float("nan"), frozenset(flags))


def dot_model(planes: Planes, grid: Grid) -> Model:
    """Darkness of a resting dot and its derivatives.

    Parameters are x, y, q0, q1, q2, blur variance, then for each lattice the extra variance, the diffraction width
    and the offset in x and y.
    """
    n = planes.values.shape[0]
    f2 = grid.fx**2 + grid.fy**2
    f = np.sqrt(f2)
    flat = shapes.pixel(grid.fx, grid.fy)

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        dark, by_q = shapes.ellipse(grid.fx, grid.fy, p[2:5])
        own = p[COMMON:].reshape(n, 4)
        # 0 the dot, 1..6 by the common parameters, 7 by the lattice's own diffraction width
        spectra = np.empty((8, n, *f2.shape), dtype=np.complex128)
        for index in range(n):
            extra, width, ox, oy = own[index]
            gauss = shapes.gaussian(f2, p[5] + extra) * flat * np.exp(-2j * np.pi * (grid.fx * ox + grid.fy * oy))
            blur = gauss * shapes.diffraction(f, width)
            spectra[0, index] = dark * blur
            spectra[1, index] = -2j * np.pi * grid.fx * spectra[0, index]
            spectra[2, index] = -2j * np.pi * grid.fy * spectra[0, index]
            spectra[3:6, index] = by_q * blur
            spectra[6, index] = -2 * np.pi**2 * f2 * spectra[0, index]
            spectra[7, index] = dark * gauss * shapes.diffraction_slope(f, width)
        images = darkness(single(shifted(spectra, grid, planes, p[:2])), grid, planes)
        slopes = np.zeros((len(p), *images.shape[1:]))
        slopes[:COMMON] = images[1:7]
        for index in range(n):
            base = COMMON + 4 * index
            slopes[base, index] = images[6, index]
            slopes[base + 1, index] = images[7, index]
            slopes[base + 2, index] = images[1, index]
            slopes[base + 3, index] = images[2, index]
        return images[0], slopes

    return model


def _fit(dot: Dot, planes: Planes, noise: NoiseModel, blob: Blob) -> tuple[Solution, Lens]:
    n, height, width = planes.values.shape
    c, s = np.cos(dot.angle_rad), np.sin(dot.angle_rad)
    big, small = dot.semi_major_px, dot.semi_minor_px
    q = [big * c * c + small * s * s, (big - small) * c * s, big * s * s + small * c * c]
    near = blob.centre_px if np.hypot(*(blob.centre_px - (dot.x_px, dot.y_px))) < big else (dot.x_px, dot.y_px)
    start = np.concatenate(([near[0], near[1]], q, [0.8], np.tile([0.0, 0.5, 0.0, 0.0], n)))
    # A channel's own blur and offset are small; with one channel they are the common ones. The width is tied loosely.
    sd_own = np.array([0.7, 2.0, 0.5, 0.5]) if n > 1 else np.array([1e-4, 2.0, 1e-5, 1e-5])
    mean = np.concatenate((np.zeros(COMMON), np.tile([0.0, 0.0, 0.0, 0.0], n)))
    precision = np.concatenate((np.full(COMMON, 1e-10), np.tile(1 / sd_own**2, n)))
    prior = Prior(mean, np.diag(precision))

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[2], p[4] = max(p[2], 1.0), max(p[4], 1.0)
        p[5] = np.clip(p[5], -0.2, 60.0)
        p[COMMON + 1 :: 4] = np.clip(p[COMMON + 1 :: 4], 0.0, 8.0)
        return p

    weights = noise_weights(noise, planes)
    size = (height * planes.period + MARGIN_PX, width * planes.period + MARGIN_PX)
    model = dot_model(planes, make_grid(size))
    solution = solve(planes, weights, model, start, prior, bound=bound, max_iterations=40)
    if _lens(planes, solution).sharp:
        model = dot_model(planes, make_grid(size, oversampling=2))
        solution = solve(planes, weights, model, solution.p, prior, bound=bound, light=solution.light)
    return solution, _lens(planes, solution)


def _is_smeared(planes: Planes, solution: Solution) -> bool:
    """Whether a dot that fits badly moved while it was taken: blurred to one side, and badly fitted because of it."""
    size = [planes.period * length + MARGIN_PX for length in planes.values.shape[1:]]
    grid = make_grid((size[0], size[1]))
    resting = dot_model(planes, grid)
    lens = _lens(planes, solution)
    spectra, _ = Ellipse(solution.p[2:5], lens, np.zeros((4, 4))).spectra(grid, planes.channel)
    own = solution.p[COMMON:].reshape(len(planes.channel), 4)
    centre = solution.p[:2] + own[:, 2:4].mean(axis=0)

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        dark, by_rest = resting(solution.p)
        squares = np.stack((grid.fx**2, 2 * grid.fx * grid.fy, grid.fy**2)) * (-(np.pi**2))
        by_moment = darkness(shifted(squares[:, None] * spectra, grid, planes, centre), grid, planes)
        return dark, np.concatenate((by_rest[:5], by_moment))

    start = np.concatenate((solution.p[:5], np.zeros(3)))
    found = one_step(planes, lambda _: solution.weight, model, start, Prior(start, np.eye(8) * 1e-10), solution.light)
    values = np.linalg.eigvalsh(np.array([[found.p[5], found.p[6]], [found.p[6], found.p[7]]]))
    step = found.p - start
    explained = float(step @ np.linalg.pinv(found.covariance, hermitian=True) @ step) / max(solution.cost, 1e-12)
    return bool(values[1] - values[0] > SMEARED_PX2 and explained > SMEARED_PART)


def _lens(planes: Planes, solution: Solution) -> Lens:
    own = solution.p[COMMON:].reshape(len(planes.channel), 4)
    return Lens(planes.channel, solution.p[5] + own[:, 0], own[:, 1], own[:, 2:4] - own[:, 2:4].mean(axis=0))


def _relief(planes: Planes, paper: BoolArray, solution: Solution) -> Relief | None:
    """What the fit left over, in units of the dot's darkness."""
    level = light_level(planes, solution.light) * solution.light[:, 3, None, None]
    level = np.where(np.abs(level) > 1e-9, level, 1.0)
    weight = solution.weight
    residual = np.where(weight > 0, -solution.residual / np.sqrt(np.maximum(weight, 1e-300)) / level, 0.0)
    variance = np.where(weight > 0, 1 / np.maximum(weight, 1e-300) / level**2, 0.0)
    own = solution.p[COMMON:].reshape(len(planes.channel), 4)
    centre = solution.p[:2] + own[:, 2:4].mean(axis=0)
    return find_relief(planes, residual, variance, paper, centre)


def _target(
    dot: Dot, planes: Planes, relief: Relief | None, solution: Solution, lens: Lens, noise: NoiseModel, known: bool
) -> SharpTarget:
    chi2 = _chi2_with(noise, planes, solution) if known and relief is None else solution.chi2  # grain is noise too
    scale = max(solution.chi2, 1.0) if relief is None else 1.0  # but shared by neighbours, so that it weighs more
    covariance = solution.covariance * scale
    n = planes.values.shape[0]
    # The blur that a fit of motion can confuse with motion is the mean over channels, extra and diffraction together.
    slope = np.zeros((4, len(solution.p)))
    slope[0, 2] = slope[1, 3] = slope[2, 4] = slope[3, 5] = 1.0
    for index in range(n):
        slope[3, COMMON + 4 * index] = 1 / n
        slope[3, COMMON + 4 * index + 1] = 0.45 * solution.p[COMMON + 4 * index + 1] / n
    q = solution.p[2:5]
    form = Ellipse(q, lens, slope @ covariance @ slope.T, relief)
    flags = set()
    axes = np.linalg.eigvalsh(np.array([[q[0], q[1]], [q[1], q[2]]]))
    seen = [bool(w.any()) for w in solution.weight]
    contrast = {int(c): float(k) for c, k, ok in zip(planes.channel, solution.light[:, 3], seen, strict=True) if ok}
    fitted = 0.5 < axes[0] / dot.semi_minor_px < 2 and np.all(np.isfinite(solution.p)) and min(contrast.values()) > 0.02
    if not fitted:
        flags.add(Flag.NOT_FOUND)
    if chi2 > DOUBTFUL_CHI2 and relief is None:
        flags.add(Flag.POOR_FIT)
    if chi2 > SUSPECT_CHI2 and _is_smeared(planes, solution):
        flags.add(Flag.POOR_FIT)
    # The channels' offsets are relative to the target's own centre: on average there is none.
    mean = np.zeros((2, len(solution.p)))
    mean[0, 0] = mean[1, 1] = 1.0
    mean[0, COMMON + 2 :: 4] = mean[1, COMMON + 3 :: 4] = 1 / n
    centre, cov = mean @ solution.p, mean @ covariance @ mean.T
    return SharpTarget(dot.name, centre, cov, form, contrast, noise, known, dot.paper_px, chi2, frozenset(flags))


def _chi2_with(noise: NoiseModel, planes: Planes, solution: Solution) -> float:
    """Residual variance over what noise and grain make of it."""
    used = solution.weight > 0
    raw = solution.residual[used] ** 2 / solution.weight[used]
    return float(np.sum(raw * noise_weights(noise, planes)(solution.signal)[used])) / max(solution.dof, 1)
