"""Locate each target in a blurred frame, where its mean position may be many dots away from rest.

Most frames show every target near its rest position, and a search around each of them is enough. Where one is missing
(or two claim the same smear) every smear of the frame is listed, and a displacement field that is nearly affine
over the structure assigns them: neighbours on a structure have nearly the same displacement, and a smear belongs to
one target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from labdaemon.blur import FloatArray
from labdaemon.imaging import GreyImage, LazyImage
from labdaemon.processing.few_missing import (
    UNCLAIMED_SCORE,
    find_predicted,
    match_unclaimed,
    predicted_places,
    without_found,
)
from labdaemon.processing.matched_filter import (
    BlurredTarget,
    GreyLike,
    MotionFilter,
    match_everywhere,
    match_near,
    motion_filters,
    reduce,
)

LEAST_SCORE = 0.6
"""Correlation below which a place does not look like a dot. Real labels with a rim near the dot score 0.75 to 0.97."""
CONTRAST_RATIO = (0.5, 1.8)
"""How far the contrast may differ from the sharp frame's: light changes by less, clutter by more."""
NARROW_RADII = 1.5
"""How far around its place a target is looked for at first, in dot radii."""
SIZE_STEP = 1.15
"""Ratio between the radii for which filters are made."""
CLASS_STEP = 1.35
"""Ratio between the radii of the size classes in which a whole frame is searched."""
STRAIN = 0.25
"""Largest displacement gradient over the structure."""
SAMPLE_STEP = 7
"""One pixel in so many rows and columns is sampled for the brightness of an image."""
UNCLAIMED_FILTERS = 29
"""Filters by which an unclaimed blurred dot is noticed: rest, and straight motions of up to 1.7 radii."""
RANDOM_FIELDS = 2000  # draws of three targets: some are right even where most candidates are wrong
REFITTED_FIELDS = 60  # the best of the draws, since refitting costs more than drawing
SMEARS_PER_TARGET = 10
"""Smears a target is tried with."""


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedTarget:
    """A target at rest, as the search expects it in a later frame.

    Attributes
    ----------
    centre_px
        (2,) where it would be if it had not moved.
    semi_major_px, semi_minor_px, angle_rad
        Its ellipse.
    contrast
        Paper less ink in the sharp frame, relative to what is bright in it.
    """

    centre_px: FloatArray
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float
    contrast: float

    @property
    def radius_px(self) -> float:
        return (self.semi_major_px + self.semi_minor_px) / 2


@dataclass(frozen=True, slots=True, eq=False)
class ReducedImage:
    """A grey image reduced for the search, and its scale."""

    image: LazyImage
    scale: int

    def shapes(self, target: ExpectedTarget) -> tuple[MotionFilter, ...]:
        """Filters for a target's ellipse. Nearly equal dots share them, and all but the flattest pass as round."""
        radius = np.sqrt(target.semi_major_px * target.semi_minor_px) / self.scale
        radius = SIZE_STEP ** round(np.log(radius) / np.log(SIZE_STEP))
        ratio = round(10 * target.semi_minor_px / target.semi_major_px) / 10
        if ratio > 0.75:
            return motion_filters(float(radius), float(radius), 0.0)
        stretch = np.sqrt(max(ratio, 0.1))
        angle = np.radians(15) * (round(target.angle_rad / np.radians(15)) % 12)
        return motion_filters(float(radius / stretch), float(radius * stretch), float(angle))


def reduce_for_search(grey: GreyLike, targets: Sequence[ExpectedTarget]) -> ReducedImage:
    """Scale an image to its own brightness and reduce it until the smallest dot is some seven pixels across."""
    scale = max(1, int(min(target.semi_minor_px for target in targets) / 3.5)) if targets else 1
    sample = grey.sample if isinstance(grey, LazyImage) else grey[::SAMPLE_STEP, ::SAMPLE_STEP].ravel()
    white = float(np.percentile(sample, 99)) if sample.size else 0.0
    # Frames differ in light: contrasts are compared as parts of what is bright in each.
    unit = np.float32(white if white > 0 else 1.0)

    def make(x0: int, y0: int, x1: int, y1: int) -> GreyImage:
        return reduce(grey[y0 * scale : y1 * scale, x0 * scale : x1 * scale], scale) / unit

    height, width = grey.shape
    return ReducedImage(LazyImage((height // scale, width // scale), make, sample / unit), scale)


def measure_contrast(grey: GreyLike, targets: Sequence[ExpectedTarget]) -> FloatArray:
    """Contrast of each target in the frame it is sharp in, (n,), to be compared with later frames."""
    if not targets:
        return np.empty(0)
    small = reduce_for_search(grey, targets)
    found = [match_near(small.image, small.scale, t.centre_px, t.radius_px / 2, small.shapes(t)[:1]) for t in targets]
    return np.array([smear.contrast if smear else np.nan for smear in found])


def locate_targets(grey: GreyLike, targets: Sequence[ExpectedTarget]) -> list[BlurredTarget | None]:
    """Locate each target's smear in a blurred frame.

    Parameters
    ----------
    grey
        (h, w) blurred frame, colours balanced; of a `LazyImage` only the targets' surroundings are made, unless
        a target is missing there.
    targets
        What to look for.

    Returns
    -------
    list of BlurredTarget or None
        In the order of `targets`; None where there is nothing like it.
    """
    if not targets:
        return []
    small = reduce_for_search(grey, targets)
    near = _search_near(small, targets)
    if all(smear is not None for smear in near) and not _losing_claims(near, targets):
        return near
    unshared = _without_losing_claims(near, targets)
    few = _search_predicted(small, targets, unshared)
    if few is not None:
        return few
    wide = _search_everywhere(small, targets)
    return wide if _total(wide) > _total(unshared) else unshared


def _total(found: Sequence[BlurredTarget | None]) -> float:
    return sum(smear.score for smear in found if smear is not None)


def is_plausible(smear: BlurredTarget, target: ExpectedTarget) -> bool:
    """Whether a smear could be this target's: dot-like and of its contrast."""
    low, high = CONTRAST_RATIO
    return smear.score >= LEAST_SCORE and low * target.contrast < smear.contrast < high * target.contrast


def _search_near(small: ReducedImage, targets: Sequence[ExpectedTarget]) -> list[BlurredTarget | None]:
    found: list[BlurredTarget | None] = []
    for target in targets:
        reach = NARROW_RADII * target.radius_px
        smear = match_near(small.image, small.scale, target.centre_px, reach, small.shapes(target))
        found.append(smear if smear is not None and is_plausible(smear, target) else None)
    return found


def _search_predicted(
    small: ReducedImage, targets: Sequence[ExpectedTarget], found: Sequence[BlurredTarget | None]
) -> list[BlurredTarget | None] | None:
    """What is missing, where the others say that it is; None where a search of the whole frame is needed."""
    radii = np.array([target.radius_px for target in targets])
    predicted = predicted_places(np.array([target.centre_px for target in targets]), radii, found)
    if predicted is None:
        return None

    def near(index: int, place: FloatArray, reach: float) -> BlurredTarget | None:
        one = match_near(small.image, small.scale, place, reach, small.shapes(targets[index]))
        return one if one is not None and is_plausible(one, targets[index]) else None

    def unclaimed(index: int, place: FloatArray, reach: float) -> BlurredTarget | None:
        # Of the shorter motions: an unclaimed dot resembles one of them enough to be noticed.
        shapes = small.shapes(targets[index])[:UNCLAIMED_FILTERS]
        half = int(reach / small.scale) + max(shapes[-1].template.shape)
        x, y = (int(v) for v in place / small.scale)
        left, top = max(x - half, 0), max(y - half, 0)
        window = without_found(
            small.image[top : y + half + 1, left : x + half + 1], (left, top), small.scale, radii, found
        )
        one = match_unclaimed(window, (left, top), small.scale, place, reach, shapes)
        if one is None or not is_plausible(one, targets[index]):
            return None
        again = targets[index].radius_px / 2
        closer = match_unclaimed(window, (left, top), small.scale, one.centre_px, again, small.shapes(targets[index]))
        return closer if closer is not None and closer.score >= UNCLAIMED_SCORE else None

    return find_predicted(predicted, radii, found, near, unclaimed)


def _losing_claims(found: Sequence[BlurredTarget | None], targets: Sequence[ExpectedTarget]) -> set[int]:
    """Targets that claim a smear which another target claims, too, and which lies nearer to the other."""
    owners = [i for i, smear in enumerate(found) if smear is not None]
    losers: set[int] = set()
    if len(owners) < 2:
        return losers
    places = np.array([smear.centre_px for smear in found if smear is not None])
    reach = min(target.radius_px for target in targets)
    for p, q in KDTree(places).query_pairs(reach):
        i, j = owners[p], owners[q]
        moved = [float(np.hypot(*(places[k] - targets[owners[k]].centre_px))) for k in (p, q)]
        losers.add(i if moved[0] > moved[1] else j)
    return losers


def _without_losing_claims(
    found: Sequence[BlurredTarget | None], targets: Sequence[ExpectedTarget]
) -> list[BlurredTarget | None]:
    losers = _losing_claims(found, targets)
    return [None if i in losers else smear for i, smear in enumerate(found)]


def _search_everywhere(small: ReducedImage, targets: Sequence[ExpectedTarget]) -> list[BlurredTarget | None]:
    """List all smears of the frame, find the displacement field that explains most targets, and assign."""
    smears: list[BlurredTarget] = []
    weight = np.zeros((len(targets), 0))
    for members in _size_classes(targets):
        typical = sorted(members, key=lambda i: targets[i].semi_minor_px / targets[i].semi_major_px)[len(members) // 2]
        listed = match_everywhere(small.image[:, :], small.scale, small.shapes(targets[typical]), LEAST_SCORE)
        mine = np.zeros((len(targets), len(listed)))
        for i in members:
            mine[i] = [smear.score if is_plausible(smear, targets[i]) else 0.0 for smear in listed]
        smears += listed
        weight = np.concatenate([weight, mine], axis=1)
    if not smears:
        return [None] * len(targets)
    places = np.array([target.centre_px for target in targets])
    centres = np.array([smear.centre_px for smear in smears])
    chosen = assign(places, centres, weight, least_px=min(target.radius_px for target in targets))
    found: list[BlurredTarget | None] = []
    for target, j in zip(targets, chosen, strict=True):
        if j < 0:
            found.append(None)
            continue
        reach = target.radius_px / 2
        closer = match_near(small.image, small.scale, smears[j].centre_px, reach, small.shapes(target))
        found.append(closer if closer is not None and closer.score >= smears[j].score else smears[j])
    return found


def _size_classes(targets: Sequence[ExpectedTarget]) -> list[list[int]]:
    """Targets of nearly equal size, which one set of filters finds."""
    classes: dict[int, list[int]] = {}
    for index, target in enumerate(targets):
        classes.setdefault(round(np.log(target.radius_px) / np.log(CLASS_STEP)), []).append(index)
    return list(classes.values())


def assign(places: FloatArray, centres: FloatArray, weight: FloatArray, *, least_px: float) -> NDArray[np.intp]:
    """Assign smears to targets by a displacement field that is nearly affine.

    Parameters
    ----------
    places
        (n, 2) rest positions.
    centres
        (m, 2) smears.
    weight
        (n, m) how well each could be each; 0 for impossible.
    least_px
        Displacements that differ by this much are as good as equal.

    Returns
    -------
    array
        (n,) index of each target's smear, −1 for none. No smear is given twice.
    """
    count = len(places)
    spacing = 20 * least_px
    if count > 1:
        apart = np.asarray(KDTree(places).query(places, k=2)[0])
        spacing = float(np.median(apart[:, 1]))
    tolerance = max(least_px, 0.15 * spacing)
    distance = np.hypot(*(centres[None] - places[:, None]).transpose(2, 0, 1))
    attractive = weight * np.exp(-distance / (4 * spacing))
    options = np.argsort(-attractive, axis=1)[:, :SMEARS_PER_TARGET]
    option_weight = np.take_along_axis(weight, options, axis=1)
    field = _best_field(places, centres[options], option_weight, tolerance, spacing)
    chosen = np.full(count, -1)
    for width in (2.0, 2.0, 1.5):
        predicted = places + field
        gap = np.hypot(*(centres[None] - predicted[:, None]).transpose(2, 0, 1))
        gain = weight * np.exp(-0.5 * (gap / (width * tolerance)) ** 2) * (gap < 2.5 * tolerance)
        rows, columns = linear_sum_assignment(-gain)
        chosen = np.full(count, -1)
        good = gain[rows, columns] > 0
        chosen[rows[good]] = columns[good]
        field = _smooth(places, centres, chosen, field)
    return chosen


def _best_field(
    places: FloatArray, options: FloatArray, weight: FloatArray, tolerance: float, spacing: float
) -> FloatArray:
    """(n, 2) displacement of the affine field, out of many random ones, that explains most targets, moved least."""
    count = len(places)
    usable = np.flatnonzero(weight.max(axis=1) > 0)
    fields = [np.zeros((1, count, 2))]
    if usable.size:
        # Every target with every choice of its own as a pure translation; then triples as affine fields.
        shifts = (options - places[:, None])[usable].reshape(-1, 2)[weight[usable].ravel() > 0]
        fields.append(np.repeat(shifts[:, None], count, axis=1))
    if usable.size >= 3:
        rng = np.random.default_rng(0)
        triples = usable[np.argsort(rng.random((RANDOM_FIELDS, usable.size)), axis=1)[:, :3]]
        draw = np.log(np.maximum(weight[triples], 1e-12)) + rng.gumbel(size=(RANDOM_FIELDS, 3, weight.shape[1]))
        base = np.concatenate([places[triples], np.ones((RANDOM_FIELDS, 3, 1))], axis=2)
        moved = options[triples, np.argmax(draw, axis=2)] - places[triples]
        sound = np.abs(np.linalg.det(base)) > spacing**2 / 2
        gradient = np.linalg.solve(base[sound], moved[sound])
        gradient = gradient[np.linalg.norm(gradient[:, :2], axis=(1, 2)) < STRAIN]
        fields.append(np.concatenate([places, np.ones((count, 1))], axis=1) @ gradient)
    candidates = np.concatenate(fields)
    merit = _merit(places, options, weight, candidates, tolerance, spacing)
    # A translation that explains one storey is where an affine field that explains them all can grow from.
    grown = [_grow(places, options, weight, candidates[k], tolerance) for k in np.argsort(-merit)[:REFITTED_FIELDS]]
    candidates = np.concatenate([candidates[np.argmax(merit)][None], np.stack(grown)])
    best: FloatArray = candidates[np.argmax(_merit(places, options, weight, candidates, tolerance, spacing))]
    return best


def _merit(
    places: FloatArray, options: FloatArray, weight: FloatArray, fields: FloatArray, tolerance: float, spacing: float
) -> FloatArray:
    """(k,) how much of the targets each of (k, n, 2) displacement fields explains, less a little for its size."""
    gap2 = ((options[None] - places[None, :, None] - fields[:, :, None]) ** 2).sum(axis=3)
    explained = (weight[None] * np.exp(-0.5 * gap2 / tolerance**2)).max(axis=2).sum(axis=1)
    effort = np.hypot(fields[..., 0], fields[..., 1]).mean(axis=1) / spacing
    merit: FloatArray = explained - 0.2 * np.minimum(effort, 3.0)
    return merit


def _grow(
    places: FloatArray, options: FloatArray, weight: FloatArray, field: FloatArray, tolerance: float
) -> FloatArray:
    """Refit an affine field to the smears it explains, and to those that it then explains."""
    every = np.arange(len(places))
    for _ in range(6):
        gap2 = ((options - places[:, None] - field[:, None]) ** 2).sum(axis=2)
        pull = weight * np.exp(-0.5 * gap2 / (2 * tolerance) ** 2)
        choice = np.argmax(pull, axis=1)
        field = _affine(places, options[every, choice] - places, pull[every, choice])
    return field


def _affine(places: FloatArray, moved: FloatArray, weight: FloatArray) -> FloatArray:
    """(n, 2) affine displacement field by weighted least squares, held towards a translation where little is known."""
    middle, size = places.mean(axis=0), places.std() + 1e-9
    base = np.concatenate([(places - middle) / size, np.ones((len(places), 1))], axis=1)
    normal = base.T @ (weight[:, None] * base) + np.diag([0.1, 0.1, 1e-9])
    field: FloatArray = base @ np.linalg.solve(normal, base.T @ (weight[:, None] * moved))
    return field


def _smooth(places: FloatArray, centres: FloatArray, chosen: NDArray[np.intp], before: FloatArray) -> FloatArray:
    """Displacement field through the pairs found: affine, plus what the nearest neighbours have over it."""
    got = np.flatnonzero(chosen >= 0)
    if got.size < 4:
        return before
    moved = np.zeros_like(places)
    moved[got] = centres[chosen[got]] - places[got]
    affine = _affine(places, moved, (chosen >= 0).astype(float))
    _, index = KDTree(places[got]).query(places, k=min(4, got.size))
    rest = (moved - affine)[got]
    smoothed: FloatArray = affine + np.median(rest[index], axis=1)
    return smoothed
