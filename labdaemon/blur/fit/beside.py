"""A target with something hanging in front of it: its motion from the pixels that are not covered.

What covers is neither known nor of one kind: dark or light, a cable or a corner, with soft edges. What is known is the
target. Many motions are compared with the patch, each by the pixels that agree with it; the best are fitted with
weights that let go of what does not agree, ever more strictly; and what then still differs is the cover. The
measurement is the fit of the rest. Two margins around the cover must give the same, and how far they differ counts as
error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from labdaemon.blur.fit.cover import fixed
from labdaemon.blur.motion import ExtraBlur, Measurement, nothing
from labdaemon.blur.patch.light import light_level, render_light
from labdaemon.blur.patch.locate import Blob
from labdaemon.blur.patch.mosaic import Planes, deal, interleave, make_grid, split
from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch
from labdaemon.blur.sharp.target import Ellipse, SharpTarget
from labdaemon.blur.sharp.weights import nuisance_prior, pixel_weights
from labdaemon.blur.smear.model import Setting, blurred_model, standing
from labdaemon.blur.solver.normal import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.spectra import shapes
from labdaemon.flags import Flag

LENGTHS = (0.15, 0.35, 0.8, 1.4, 2.2)
"""Semi-amplitudes that are tried, in radii of the dot; rest is tried too."""
DIRECTIONS = 8
STEP = 0.3
"""How far apart places are tried, in radii."""
FIRST_SIGMAS = 25.0
"""Residuals from which a pixel counts as not the target's while motions are compared: they only come near."""
SIGMAS = (25.0, 12.0, 6.0)
"""The same while the best ones are fitted."""
FITTED = 6
"""Motions that are fitted."""
ODD_SIGMAS = 4.0
MARGINS = (2, 4)
"""How far a cover's soft edge may reach beyond what stands out of the noise, px."""
LEAST_SEEN = 0.03
"""Part of the smear's darkness that must be in view."""
MISSING = 0.08
"""Part of the target's darkness that no motion takes away or adds."""
RIM_PART = 0.3
"""Part of the motion by which another motion's outline may differ."""
GONE = 0.85
"""Part of it that is missing where there is no target at all, or nothing to be seen of it."""
CONTRAST_PART = 0.12
"""How far the contrast may differ from the sharp frame's: a cover that is taken for a dot has another."""
LOOSE_PX, LOOSE_PART = 0.3, 0.05
"""Standard deviation, in pixels or of the amplitude, of a measurement that is not worth giving; twice that at rest."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A smear beside what the patch shows.

    Attributes
    ----------
    dark
        (H, W) the smear, 0 on paper.
    looks
        (H, W) how dark the patch is.
    odd
        (H, W) bool, where they differ.
    """

    dark: FloatArray
    looks: FloatArray
    odd: BoolArray


def is_plain_dot(sharp: SharpTarget) -> bool:
    """Whether a target is known well enough: a dot on paper that shows nothing else, its noise given."""
    return isinstance(sharp.form, Ellipse) and sharp.form.relief is None and sharp.noise_known


def measure_beside(
    sharp: SharpTarget,
    patch: Patch,
    places_px: list[FloatArray],
    blur: ExtraBlur,
    found: Measurement,
    fit: Callable[[Setting], Measurement],
) -> Measurement | None:
    """Measure a target of which something hides a part.

    Parameters
    ----------
    sharp, patch, blur
        The target, its patch, the frame's defocus.
    places_px
        Where it may be.
    found
        What a fit of the whole patch says, if it says anything.
    fit
        Measures what a setting shows.

    Returns
    -------
    Measurement or None
        Flagged `occluded`, without numbers where what is in view does not settle the motion. None where nothing speaks
        for a cover.
    """
    left, top = patch.origin_px
    high, wide = patch.shape
    # The rest position is another guess, where the patch shows it.
    places_px = [p for p in places_px if left <= p[0] < left + wide and top <= p[1] < top + high]
    setting = _around(sharp, patch, places_px) if places_px else None
    if setting is None:
        return None
    planes = setting.planes
    best = _agreement(sharp, setting, places_px, blur)
    seen = _seen(sharp, planes, best.light, blurred_model(setting, shapes.straight)(best.p)[0])
    if not _is_cover(seen):
        return None
    if np.isfinite(found.centre_px).all():
        at = np.concatenate((found.centre_px, [found.extra_blur_px2], np.zeros(setting.shapes)))
        whole = _seen(sharp, planes, best.light, blurred_model(setting, fixed(found))(at)[0])
        # A fit that went astray says nothing.
        if abs(float(whole.dark.sum()) / float(seen.dark.sum()) - 1) < MISSING and not _is_cover(whole):
            return None
    lost = nothing(sharp.name, {Flag.OCCLUDED, Flag.NOT_FOUND})
    if not _is_target(sharp, planes, best):
        return lost
    rest = []
    for margin in MARGINS:
        hidden = ndimage.binary_dilation(seen.odd, iterations=margin)
        if seen.dark[~hidden].sum() < LEAST_SEEN * seen.dark.sum():
            return lost
        rest.append(fit(_without(setting, best, hidden, sharp, blur)))
    return _agreed(rest[0], rest[1], lost)


def _around(sharp: SharpTarget, patch: Patch, places_px: list[FloatArray]) -> Setting | None:
    """The paper around a target's likely places, with nothing hidden yet."""
    half = np.array(sharp.form.half_size_px)
    reach = np.ceil(np.minimum(3.2 * half + 8, np.maximum(0.95 * sharp.paper_px, half + 4)))
    low, high = np.min(places_px, axis=0) - reach, np.max(places_px, axis=0) + reach
    left, top = (int(v) for v in np.floor(low))
    width, height = (int(v) for v in np.ceil(high - low))
    cut = patch.crop(left, top, width, height)
    if min(cut.shape) < 5 or np.count_nonzero(cut.valid) < 0.3 * cut.values.size:
        return None
    planes = split(cut)
    if not planes.valid.any() or np.percentile(planes.values[planes.valid], 80) <= 0:
        return None
    margin = sharp.form.skirt_px
    grid = make_grid((cut.shape[0] + margin, cut.shape[1] + margin), sharp.form.oversampling)
    return Setting(planes, grid, standing(sharp.form, grid, planes), np.asarray(places_px[0]), None)


def _agreement(sharp: SharpTarget, setting: Setting, places_px: list[FloatArray], blur: ExtraBlur) -> Solution:
    """The straight motion that most pixels agree with."""
    planes = setting.planes
    k = setting.shapes
    model, base = blurred_model(setting, shapes.straight), pixel_weights(sharp, planes)
    light = _paper(sharp, planes)

    def disagreement(p: FloatArray, light: FloatArray, sigmas: float) -> float:
        signal = render_light(planes, light, model(p)[0])
        squared = base(np.maximum(signal, 0)) * (planes.values - signal) ** 2
        return float(np.minimum(squared, sigmas**2).sum())

    radius = float(np.sqrt(np.prod(sharp.form.half_size_px)))
    tried = [np.concatenate((place, [blur.mean_px2], np.zeros(k), a)) for place in places_px for a in _motions(radius)]
    tried.sort(key=lambda p: disagreement(p, light, FIRST_SIGMAS))
    near = [p + np.concatenate((d, np.zeros(len(p) - 2))) for p in tried[:FITTED] for d in _steps(STEP * radius)]
    near.sort(key=lambda p: disagreement(p, light, FIRST_SIGMAS))
    prior = nuisance_prior(sharp, blur, 2)
    best: Solution | None = None
    least = np.inf
    for start in near[:FITTED]:
        p, its_light = start, light
        for sigmas in SIGMAS:
            found = solve(planes, _lenient(planes, base, sigmas), model, p, prior, light=its_light)
            p, its_light = found.p, found.light
        remains = disagreement(p, its_light, SIGMAS[-1])
        if best is None or remains < least:
            best, least = found, remains
    assert best is not None
    return best


def _seen(sharp: SharpTarget, planes: Planes, light: FloatArray, dark: FloatArray) -> _Seen:
    """Compare a smear with the patch."""
    signal = render_light(planes, light, dark)
    weight = pixel_weights(sharp, planes)(np.maximum(signal, 0))
    residual = interleave(planes, (planes.values - signal) * np.sqrt(weight))
    smooth = ndimage.uniform_filter(residual, 3) * 3.0
    odd = ndimage.binary_opening(np.abs(smooth) > ODD_SIGMAS, iterations=1)
    odd = ndimage.binary_closing(np.pad(odd, 3), iterations=2)[3:-3, 3:-3]
    paper = light_level(planes, light)
    depth = np.maximum(paper, 1e-9) * np.maximum(light[:, 3, None, None], 0.05)
    looks = np.where(planes.valid, (paper - planes.values) / depth, dark)
    return _Seen(interleave(planes, dark), interleave(planes, looks), odd)


def _paper(sharp: SharpTarget, planes: Planes) -> FloatArray:
    """(n, 4) light of the patch's white paper with the sharp frame's contrast."""
    light = np.zeros((len(planes.values), 4))
    for row, (values, valid, channel) in enumerate(zip(planes.values, planes.valid, planes.channel, strict=True)):
        light[row, 0] = np.percentile(values[valid], 80) if valid.any() else 1.0
        light[row, 3] = sharp.contrast.get(int(channel), 0.9)
    return light


def _motions(radius: float) -> list[FloatArray]:
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return [np.full(2, 0.1)] + [
        length * radius * np.array([np.cos(angle), np.sin(angle)]) for length in LENGTHS for angle in angles
    ]


def _steps(size: float) -> list[FloatArray]:
    return [size * np.array([x, y], dtype=float) for x in (-1, 0, 1) for y in (-1, 0, 1)]


def _lenient(
    planes: Planes, base: Callable[[FloatArray], FloatArray], sigmas: float
) -> Callable[[FloatArray], FloatArray]:
    """Weights that let go of pixels that disagree by more than some standard deviations."""

    def weights(signal: FloatArray) -> FloatArray:
        weight = base(np.maximum(signal, 0))
        squared = weight * (planes.values - signal) ** 2 / sigmas**2
        return np.asarray(weight * np.maximum(1 - squared, 0.0) ** 2)

    return weights


def _is_cover(seen: _Seen) -> bool:
    """Whether what differs is no part of another motion of the target.

    A motion that is not as assumed moves darkness about in the smear's half-dark rim. It touches neither the paper
    around nor the core that is always covered, and it leaves the whole as dark as it is.
    """
    area = float(seen.dark.sum())
    radius = float(np.sqrt(max(area, 0.0) / np.pi))
    smear, core = seen.dark > 0.02, seen.dark > 0.985
    length = max((int(np.ptp(np.nonzero(smear.any(axis=axis)))) for axis in (0, 1)), default=0) if smear.any() else 0
    # Another motion's outline may lie by a part of the motion beside this one's.
    rim = 3 + int(RIM_PART * max(length / 2 - radius, 0.0))
    outside = np.count_nonzero(seen.odd & ~ndimage.binary_dilation(smear, iterations=rim))
    inside = np.count_nonzero(seen.odd & ndimage.binary_erosion(core, iterations=rim))
    around = ndimage.binary_dilation(smear, iterations=max(rim, int(radius / 2)))
    missing = 1 - float(seen.looks[around].sum()) / max(area, 1.0)
    if missing > GONE:
        return False
    return bool(outside > max(0.05 * area, 12) or inside > max(0.02 * area, 8) or abs(missing) > MISSING)


def _is_target(sharp: SharpTarget, planes: Planes, solution: Solution) -> bool:
    """Whether the smear is as dark as the target's ink."""
    known = np.array([sharp.contrast.get(int(channel), np.nan) for channel in planes.channel])
    ratio = solution.light[:, 3] / known
    return bool(np.abs(np.nanmedian(ratio) - 1) < CONTRAST_PART)


def _without(setting: Setting, solution: Solution, hidden: BoolArray, sharp: SharpTarget, blur: ExtraBlur) -> Setting:
    """The setting with the cover masked and the motion that was found to start from."""
    planes = setting.planes
    p, a = solution.p, solution.p[-2:]
    moment = sharp.form.moment_px2 + blur.mean_px2 * np.eye(2) + np.outer(a, a) / 2
    left, top = planes.origin_px
    box = (left, top, left + hidden.shape[1], top + hidden.shape[0])
    blob = Blob(hidden, p[:2].copy(), moment, box, 0.0, False)
    return replace(
        setting, planes=replace(planes, valid=planes.valid & ~deal(planes, hidden)), start_px=p[:2].copy(), blob=blob
    )


def _agreed(near: Measurement, far: Measurement, lost: Measurement) -> Measurement:
    """The measurement with the wider margin, and what the narrower one says otherwise as error; or nothing."""
    if Flag.POOR_FIT in far.flags or not all(np.isfinite(one.covariance_px2[:4, :4]).all() for one in (near, far)):
        return lost
    sign = -1.0 if float(near.a_px @ far.a_px) < 0 else 1.0
    away = np.concatenate((near.centre_px - far.centre_px, sign * near.a_px - far.a_px, sign * near.b_px - far.b_px))
    covariance = far.covariance_px2 + np.outer(away, away)
    sd = float(np.sqrt(np.linalg.eigvalsh(covariance[2:4, 2:4])[1]))
    loosest = 2 * LOOSE_PX if Flag.AT_REST in far.flags else max(LOOSE_PX, LOOSE_PART * float(np.hypot(*far.a_px)))
    if sd > loosest:
        return lost
    return replace(far, covariance_px2=covariance, flags=far.flags | {Flag.OCCLUDED})
