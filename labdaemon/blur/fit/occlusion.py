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

from labdaemon.blur.fit.refit import fixed_transfer
from labdaemon.blur.motion import Defocus, Measurement, empty_measurement
from labdaemon.blur.patch.colour_planes import ColourPlanes, make_grid, make_planes, merge_planes, split_planes
from labdaemon.blur.patch.illumination import paper_level, render_illumination
from labdaemon.blur.patch.locate import Blob
from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch
from labdaemon.blur.settings import OCCLUSION
from labdaemon.blur.sharp.target import EllipseShape, SharpTarget
from labdaemon.blur.sharp.weights import nuisance_prior, pixel_weights
from labdaemon.blur.smear.fast_forward_model import darkness_model, fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem, rest_spectra
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.spectra import closed_form
from labdaemon.flags import Flag
from labdaemon.least_squares import biweight


@dataclass(frozen=True, slots=True, eq=False)
class _OcclusionEvidence:
    """A modelled smear compared with the patch.

    Attributes
    ----------
    model
        (H, W) modelled darkness, 0 on paper.
    observed
        (H, W) observed darkness.
    outliers
        (H, W) bool, where the two differ significantly.
    """

    model: FloatArray
    observed: FloatArray
    outliers: BoolArray


def is_plain_dot(sharp: SharpTarget) -> bool:
    """Whether a target is known well enough: a dot on paper that shows nothing else, its noise given."""
    return isinstance(sharp.form, EllipseShape) and sharp.form.template_residual is None and sharp.noise_known


def fit_occluded(
    sharp: SharpTarget,
    patch: Patch,
    candidate_centres_px: list[FloatArray],
    blur: Defocus,
    found: Measurement,
    fit: Callable[[FitProblem], Measurement],
) -> Measurement | None:
    """Measure a target of which something hides a part.

    Parameters
    ----------
    sharp, patch, blur
        The target, its patch, the frame's defocus.
    candidate_centres_px
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
    candidate_centres_px = [p for p in candidate_centres_px if left <= p[0] < left + wide and top <= p[1] < top + high]
    problem = _prepare_neighbourhood(sharp, patch, candidate_centres_px) if candidate_centres_px else None
    if problem is None:
        return None
    planes = problem.planes
    best = _fit_consensus(sharp, problem, _distinct(candidate_centres_px, sharp), blur)
    if best is None:
        return None
    evidence = _compare(
        sharp, planes, best.light, fast_forward_model(problem, closed_form.straight_transfer)(best.p)[0]
    )
    if not _shows_occluder(evidence):
        return None
    if np.isfinite(found.centre_px).all():
        parameters = np.concatenate((found.centre_px, [found.defocus_px2], np.zeros(problem.shape_count)))
        whole_patch = _compare(
            sharp, planes, best.light, fast_forward_model(problem, fixed_transfer(found))(parameters)[0]
        )
        # A fit that did not converge to the target is no evidence.
        if abs(
            float(whole_patch.model.sum()) / float(evidence.model.sum()) - 1
        ) < OCCLUSION.missing_fraction and not _shows_occluder(whole_patch):
            return None
    unmeasured = empty_measurement(sharp.name, {Flag.OCCLUDED, Flag.NOT_FOUND})
    if not _has_ink_contrast(sharp, planes, best):
        return unmeasured
    margin_fits = []
    for margin in OCCLUSION.margins_px:
        hidden = ndimage.binary_dilation(evidence.outliers, iterations=margin)
        if evidence.model[~hidden].sum() < OCCLUSION.min_visible_fraction * evidence.model.sum():
            return unmeasured
        margin_fits.append(fit(_mask_occluder(problem, best, hidden, sharp, blur)))
    return _combine_margins(margin_fits[0], margin_fits[1], unmeasured)


def _prepare_neighbourhood(
    sharp: SharpTarget, patch: Patch, candidate_centres_px: list[FloatArray]
) -> FitProblem | None:
    """The paper around a target's likely places, with nothing hidden yet."""
    half = np.array(sharp.form.half_size_px)
    reach = np.ceil(np.minimum(3.2 * half + 8, np.maximum(0.95 * sharp.paper_px, half + 4)))
    low, high = np.min(candidate_centres_px, axis=0) - reach, np.max(candidate_centres_px, axis=0) + reach
    left, top = (int(v) for v in np.floor(low))
    width, height = (int(v) for v in np.ceil(high - low))
    cut = patch.crop(left, top, width, height)
    if min(cut.shape) < 5 or np.count_nonzero(cut.valid) < 0.3 * cut.values.size:
        return None
    planes = make_planes(cut)
    if not planes.valid.any() or np.percentile(planes.values[planes.valid], 80) <= 0:
        return None
    margin = sharp.form.psf_margin_px
    grid = make_grid((cut.shape[0] + margin, cut.shape[1] + margin), sharp.form.oversampling)
    return FitProblem(planes, grid, rest_spectra(sharp.form, grid, planes), np.asarray(candidate_centres_px[0]), None)


def _fit_consensus(
    sharp: SharpTarget, problem: FitProblem, candidate_centres_px: list[FloatArray], blur: Defocus
) -> Solution | None:
    """The straight motion that most pixels agree with; None where none agrees better than bare paper."""
    planes = problem.planes
    k = problem.shape_count
    model, base = fast_forward_model(problem, closed_form.straight_transfer), pixel_weights(sharp, planes)
    light = _paper_illumination(sharp, planes)
    rough = _Disagreement(sharp, _first_plane(sharp, problem), OCCLUSION.ranking_limit)
    radius = float(np.sqrt(np.prod(sharp.form.half_size_px)))
    tried = [
        np.concatenate((place, [blur.mean_px2], np.zeros(k), a))
        for place in candidate_centres_px
        for a in _trial_motions(radius)
    ]
    costs = [rough(p, light[:1]) for p in tried]
    gain = planes.period**2 * (rough.of_paper(light[:1]) - min(costs))
    least = OCCLUSION.min_visible_fraction * np.pi * radius**2
    if gain < least * OCCLUSION.ranking_limit**2 and _dark_pixels(planes, light) < least:
        return None  # nothing of the target shows
    tried = [tried[index] for index in np.argsort(costs, kind="stable")]
    near = [
        p + np.concatenate((d, np.zeros(len(p) - 2)))
        for p in tried[: OCCLUSION.fitted_motions]
        for d in _trial_offsets(OCCLUSION.trial_step * radius)
    ]
    near.sort(key=lambda p: rough(p, light[:1]))
    strict = _Disagreement(sharp, problem, OCCLUSION.biweight_limits[-1])
    prior = nuisance_prior(sharp, blur, 2)
    first, *stricter = OCCLUSION.biweight_limits

    def fitted(p: FloatArray, its_light: FloatArray, sigmas: float, iterations: int = 30) -> Solution:
        weights = _biweight(planes, base, sigmas)
        return solve(planes, weights, model, p, prior, light=its_light, max_iterations=iterations)

    def remains(found: Solution) -> float:
        return strict(found.p, found.light)

    # Most starts lead to the same motion: only what differs, and differs little from the patch, is fitted further.
    begun = [fitted(p, light, first, OCCLUSION.first_iterations) for p in near[: OCCLUSION.fitted_motions]]
    kept = _distinct_motions(begun, remains)
    for sigmas in stricter if min(one.chi2 for one in begun) < OCCLUSION.hopeless_chi2 else ():
        kept = [fitted(one.p, one.light, sigmas) for one in kept]
    return min(kept, key=remains)


class _Disagreement:
    """How far pixels differ from a motion, each by `sigmas` standard deviations at most, squared and summed."""

    def __init__(self, sharp: SharpTarget, problem: FitProblem, sigmas: float) -> None:
        self._planes, self._limit = problem.planes, sigmas**2
        self._weights = pixel_weights(sharp, problem.planes)
        self._darkness = darkness_model(problem, closed_form.straight_transfer)

    def __call__(self, p: FloatArray, light: FloatArray) -> float:
        return self._cost(self._darkness(p), light)

    def of_paper(self, light: FloatArray) -> float:
        """Of bare paper."""
        return self._cost(np.zeros(self._planes.values.shape), light)

    def _cost(self, dark: FloatArray, light: FloatArray) -> float:
        signal = render_illumination(self._planes, light, dark)
        squared = self._weights(np.maximum(signal, 0)) * (self._planes.values - signal) ** 2
        return float(np.minimum(squared, self._limit).sum())


def _first_plane(sharp: SharpTarget, problem: FitProblem) -> FitProblem:
    """The problem on one colour plane, which is enough to rank motions."""
    planes = problem.planes.first
    return replace(problem, planes=planes, rest_spectra=rest_spectra(sharp.form, problem.grid, planes))


def _distinct_motions(found: list[Solution], cost: Callable[[Solution], float]) -> list[Solution]:
    """The best of some fits, without those that are nearly the same as a better one."""
    kept: list[Solution] = []
    for one in sorted(found, key=cost):
        place, a = one.p[:2], one.p[-2:]
        if all(
            np.hypot(*(place - other.p[:2])) + min(np.hypot(*(a - other.p[-2:])), np.hypot(*(a + other.p[-2:])))
            > OCCLUSION.same_motion_px
            for other in kept
        ):
            kept.append(one)
    return kept[: OCCLUSION.refined_motions]


def _distinct(places: list[FloatArray], sharp: SharpTarget) -> list[FloatArray]:
    """The places without those that are nearly the same as an earlier one."""
    least = 0.1 * OCCLUSION.trial_step * min(sharp.form.half_size_px)
    kept: list[FloatArray] = []
    for place in places:
        if all(np.hypot(*(place - other)) > least for other in kept):
            kept.append(place)
    return kept


def _compare(sharp: SharpTarget, planes: ColourPlanes, light: FloatArray, dark: FloatArray) -> _OcclusionEvidence:
    """Compare a smear with the patch."""
    signal = render_illumination(planes, light, dark)
    weight = pixel_weights(sharp, planes)(np.maximum(signal, 0))
    residual = merge_planes(planes, (planes.values - signal) * np.sqrt(weight))
    smooth = ndimage.uniform_filter(residual, 3) * 3.0
    outliers = ndimage.binary_opening(np.abs(smooth) > OCCLUSION.outlier_limit, iterations=1)
    outliers = ndimage.binary_closing(np.pad(outliers, 3), iterations=2)[3:-3, 3:-3]
    paper = paper_level(planes, light)
    depth = np.maximum(paper, 1e-9) * np.maximum(light[:, 3, None, None], 0.05)
    observed = np.where(planes.valid, (paper - planes.values) / depth, dark)
    return _OcclusionEvidence(merge_planes(planes, dark), merge_planes(planes, observed), outliers)


def _paper_illumination(sharp: SharpTarget, planes: ColourPlanes) -> FloatArray:
    """(n, 4) light of the patch's white paper with the sharp frame's contrast."""
    light = np.zeros((len(planes.values), 4))
    for row, (values, valid, channel) in enumerate(zip(planes.values, planes.valid, planes.channel, strict=True)):
        light[row, 0] = np.percentile(values[valid], 80) if valid.any() else 1.0
        light[row, 3] = sharp.contrast.get(int(channel), 0.9)
    return light


def _dark_pixels(planes: ColourPlanes, light: FloatArray) -> int:
    """Number of pixels at least half as dark as ink: a blurred dot has some, wherever it is not covered."""
    level = paper_level(planes, light)
    dark = planes.values < level * (1.0 - 0.5 * light[:, 3, None, None])
    return int(np.count_nonzero(dark & planes.valid))


def _trial_motions(radius: float) -> list[FloatArray]:
    angles = np.pi * np.arange(OCCLUSION.trial_directions) / OCCLUSION.trial_directions
    return [np.full(2, 0.1)] + [
        length * radius * np.array([np.cos(angle), np.sin(angle)])
        for length in OCCLUSION.trial_amplitudes
        for angle in angles
    ]


def _trial_offsets(size: float) -> list[FloatArray]:
    return [size * np.array([x, y], dtype=float) for x in (-1, 0, 1) for y in (-1, 0, 1)]


def _biweight(
    planes: ColourPlanes, base: Callable[[FloatArray], FloatArray], sigmas: float
) -> Callable[[FloatArray], FloatArray]:
    """Tukey's biweight: weights (1 − u²)² that vanish for residuals beyond `sigmas` standard deviations.

    Beaton and Tukey 1974, doi:10.1080/00401706.1974.10489171.
    """

    def weights(signal: FloatArray) -> FloatArray:
        weight = base(np.maximum(signal, 0))
        squared = weight * (planes.values - signal) ** 2 / sigmas**2
        return np.asarray(weight * biweight(squared))

    return weights


def _shows_occluder(evidence: _OcclusionEvidence) -> bool:
    """Whether what differs is no part of another motion of the target.

    A motion that is not as assumed moves darkness about in the smear's half-dark rim. It touches neither the paper
    around nor the core that is always covered, and it leaves the whole as dark as it is.
    """
    area = float(evidence.model.sum())
    radius = float(np.sqrt(max(area, 0.0) / np.pi))
    smear, core = evidence.model > 0.02, evidence.model > 0.985
    length = max((int(np.ptp(np.nonzero(smear.any(axis=axis)))) for axis in (0, 1)), default=0) if smear.any() else 0
    # The outline of another motion may differ from this one's by a part of the motion.
    rim = 3 + int(OCCLUSION.outline_fraction * max(length / 2 - radius, 0.0))
    outside = np.count_nonzero(evidence.outliers & ~ndimage.binary_dilation(smear, iterations=rim))
    inside = np.count_nonzero(evidence.outliers & ndimage.binary_erosion(core, iterations=rim))
    around = ndimage.binary_dilation(smear, iterations=max(rim, int(radius / 2)))
    missing = 1 - float(evidence.observed[around].sum()) / max(area, 1.0)
    if missing > OCCLUSION.absent_fraction:
        return False
    return bool(
        outside > max(0.05 * area, 12) or inside > max(0.02 * area, 8) or abs(missing) > OCCLUSION.missing_fraction
    )


def _has_ink_contrast(sharp: SharpTarget, planes: ColourPlanes, solution: Solution) -> bool:
    """Whether the smear is as dark as the target's ink."""
    known = np.array([sharp.contrast.get(int(channel), np.nan) for channel in planes.channel])
    ratio = solution.light[:, 3] / known
    return bool(np.abs(np.nanmedian(ratio) - 1) < OCCLUSION.max_contrast_change)


def _mask_occluder(
    problem: FitProblem, solution: Solution, hidden: BoolArray, sharp: SharpTarget, blur: Defocus
) -> FitProblem:
    """The setting with the cover masked and the motion that was found to start from."""
    planes = problem.planes
    p, a = solution.p, solution.p[-2:]
    moment = sharp.form.moment_px2 + blur.mean_px2 * np.eye(2) + np.outer(a, a) / 2
    left, top = planes.origin_px
    box = (left, top, left + hidden.shape[1], top + hidden.shape[0])
    blob = Blob(hidden, p[:2].copy(), moment, box, 0.0, False)
    return replace(
        problem,
        planes=replace(planes, valid=planes.valid & ~split_planes(planes, hidden)),
        initial_centre_px=p[:2].copy(),
        blob=blob,
    )


def _combine_margins(near: Measurement, far: Measurement, unmeasured: Measurement) -> Measurement:
    """The measurement with the wider margin, and what the narrower one says otherwise as error; or nothing."""
    if Flag.POOR_FIT in far.flags or not all(np.isfinite(one.covariance_px2[:4, :4]).all() for one in (near, far)):
        return unmeasured
    sign = -1.0 if float(near.a_px @ far.a_px) < 0 else 1.0
    away = np.concatenate((near.centre_px - far.centre_px, sign * near.a_px - far.a_px, sign * near.b_px - far.b_px))
    covariance = far.covariance_px2 + np.outer(away, away)
    sd = float(np.sqrt(np.linalg.eigvalsh(covariance[2:4, 2:4])[1]))
    loosest = (
        2 * OCCLUSION.max_sd_px
        if Flag.AT_REST in far.flags
        else max(OCCLUSION.max_sd_px, OCCLUSION.max_sd_fraction * float(np.hypot(*far.a_px)))
    )
    if sd > loosest:
        return unmeasured
    return replace(far, covariance_px2=covariance, flags=far.flags | {Flag.OCCLUDED})
