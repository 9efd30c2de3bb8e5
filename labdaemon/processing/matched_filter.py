"""Matched filters for blurred dots: templates of a dot after a second of motion, and the search for its place.

The image is reduced until a dot is a few pixels across, so that a search over place, length and direction of the
smear stays cheap. Normalised correlation takes paper white, ink and contrast out of the comparison. The result is a
start for the fit, good to about a fifth of the dot's radius; nothing is measured here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import cv2
import numpy as np

from labdaemon.blur import FloatArray
from labdaemon.imaging import GreyImage, LazyImage

GreyLike = GreyImage | LazyImage
"""An image, or one of which only the parts that are read are made."""

MARGIN_RADII = 0.7
"""White paper in a filter's template around the blurred dot, in dot radii."""
STRAIGHT_RADII = ((0.0, 1), (0.45, 4), (0.8, 6), (1.2, 8), (1.7, 10), (2.3, 12), (3.0, 14), (4.0, 16))
"""Semi-amplitudes of straight motion that are tried, in dot radii, and the number of directions of each."""
ROUND_RADII = (0.6, 1.0, 1.6, 2.4, 3.4)
"""Radii of circular orbits that are tried, in dot radii."""
COARSE_STEP = 3
"""The first pass tries one of so many filters."""
ISLAND_DARKNESS = 0.1
"""Darkness, in parts of the darkest, by which a smear stands out as an island in white paper."""
SHORT_RADII = 1.75
"""Semi-amplitude in dot radii up to which a smaller window is searched first."""
NEAREST_FILTERS = 7
"""Filters tried around the best one so far."""
NEAR_PX = 2
"""Distance from the best place within which they are tried, reduced pixels."""
TRUSTED_SCORE = 0.85
"""Correlation below which the coarse search is not trusted and all filters are tried."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionFilter:
    """What a dot looks like after one motion.

    Attributes
    ----------
    a, b
        (2,) semi-axes of the motion, reduced pixels.
    template
        (h, w) share of the exposure for which each pixel was covered; the numbers of rows and columns are not even, so
        that it has a middle pixel.
    """

    a: FloatArray
    b: FloatArray
    template: GreyImage


@dataclass(frozen=True, slots=True, eq=False)
class BlurredTarget:
    """A place in a frame that looks like a blurred dot.

    Attributes
    ----------
    centre_px, a_px, b_px
        (2,) mean position and rough semi-axes, pixels of the full frame.
    score
        Normalised correlation, 1 for a perfect likeness.
    contrast
        Paper less ink, in the searched image's units.
    """

    centre_px: FloatArray
    a_px: FloatArray
    b_px: FloatArray
    score: float
    contrast: float


@lru_cache(maxsize=64)
def motion_filters(semi_major: float, semi_minor: float, angle_rad: float) -> tuple[MotionFilter, ...]:
    """Make the filters of all motions tried, for a dot's ellipse in reduced pixels."""
    radius = (semi_major + semi_minor) / 2
    motions = [(np.zeros(2), np.zeros(2))]
    for ratio, directions in STRAIGHT_RADII[1:]:
        for k in range(directions):
            angle = np.pi * k / directions
            motions.append((ratio * radius * np.array([np.cos(angle), np.sin(angle)]), np.zeros(2)))
    motions += [(np.array([r * radius, 0.0]), np.array([0.0, r * radius])) for r in ROUND_RADII]
    return tuple(MotionFilter(a, b, _draw_template(semi_major, semi_minor, angle_rad, a, b)) for a, b in motions)


def _draw_template(semi_major: float, semi_minor: float, angle_rad: float, a: FloatArray, b: FloatArray) -> GreyImage:
    margin = MARGIN_RADII * (semi_major + semi_minor) / 2
    reach = np.hypot(a, b) + semi_major + margin
    half_w, half_h = (int(np.ceil(v)) for v in reach)
    y, x = np.mgrid[-half_h : half_h + 1, -half_w : half_w + 1].astype(float)
    steps = max(8, int(4 * max(np.hypot(*a), np.hypot(*b))))
    phases = (np.arange(steps) + 0.5) * (np.pi if not b.any() else 2 * np.pi) / steps - np.pi / 2
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    total = np.zeros_like(x)
    for phase in phases:
        dx, dy = x - a[0] * np.sin(phase) - b[0] * np.cos(phase), y - a[1] * np.sin(phase) - b[1] * np.cos(phase)
        along, across = (dx * cos + dy * sin) / semi_major, (dy * cos - dx * sin) / semi_minor
        # An edge one reduced pixel wide models lens blur and reduction together.
        total += np.clip(0.5 + (1.0 - np.hypot(along, across)) * semi_minor, 0.0, 1.0)
    return cast(GreyImage, (total / steps).astype(np.float32))


def match_near(
    reduced: GreyLike, scale: int, expected_px: FloatArray, reach_px: float, shapes: tuple[MotionFilter, ...]
) -> BlurredTarget | None:
    """Find the most dot-like place within `reach_px` (in x and in y) of where a target is expected.

    Parameters
    ----------
    reduced
        (h, w) image, reduced `scale` times by area.
    scale
        Full pixels a reduced one.
    expected_px
        (2,) place in the full frame.
    shapes
        What to look for, see `motion_filters`.

    Returns
    -------
    BlurredTarget or None
        None when the neighbourhood lies off the frame.
    """
    x, y = (np.asarray(expected_px) - (scale - 1) / 2) / scale
    reach = max(1, round(reach_px / scale))
    filter_set = _filter_set(shapes)
    best = _match_island(reduced, filter_set, round(x), round(y), reach) if len(shapes) > COARSE_STEP else None
    if best is None or best.score < TRUSTED_SCORE:
        window = _SearchWindow.around(reduced, round(x), round(y), reach, filter_set.longest)
        best = _best_match(window, shapes[::COARSE_STEP], window.x, window.y, reach)
        if len(shapes) > COARSE_STEP and best is not None:
            best = _climb(window, filter_set, best, reach)
            if best.score < TRUSTED_SCORE:
                best = _best_match(window, shapes, window.x, window.y, reach)
    return best.blurred_target(scale) if best is not None else None


@dataclass(frozen=True, slots=True, eq=False)
class _FilterSet:
    """The filters of one dot, and the moments that choose among them.

    Attributes
    ----------
    spreads
        (n, 3) second moment of each filter's motion over its length: opposite directions agree.
    rest_spread
        (3,) second moment of the dot at rest.
    dot_area
        Of the dot at rest.
    short, longest
        Half sides of the longest filter up to `SHORT_RADII`, and of the longest of all.
    """

    shapes: tuple[MotionFilter, ...]
    spreads: FloatArray
    rest_spread: FloatArray
    dot_area: float
    short: int
    longest: int


@lru_cache(maxsize=64)
def _filter_set(shapes: tuple[MotionFilter, ...]) -> _FilterSet:
    a, b = np.array([shape.a for shape in shapes]), np.array([shape.b for shape in shapes])
    moment = np.stack([a[:, 0] ** 2 + b[:, 0] ** 2, a[:, 1] ** 2 + b[:, 1] ** 2], axis=1)
    cross = np.sqrt(2) * (a[:, 0] * a[:, 1] + b[:, 0] * b[:, 1])
    rest = shapes[0].template
    area = float(rest.sum())
    radius = np.sqrt(area / np.pi)
    sides = [max(shape.template.shape) // 2 for shape in shapes]
    near = [side for side, size in zip(sides, moment.sum(axis=1), strict=True) if size <= (SHORT_RADII * radius) ** 2]
    return _FilterSet(
        shapes, _divide_by_length(np.column_stack([moment, cross])), _moments_of(rest)[2], area, max(near), max(sides)
    )


def _divide_by_length(moment: FloatArray) -> FloatArray:
    """(…, 3) second moments of motions, xx, yy and √2·xy, over the motions' length."""
    result: FloatArray = moment / np.sqrt(np.maximum(moment[..., :1] + moment[..., 1:2], 1e-12))
    return result


def _moments_of(dark: GreyImage) -> tuple[float, float, FloatArray]:
    """Centroid x and y of a darkness, and its second moment (xx, yy, √2·xy)."""
    m = cv2.moments(dark)
    spread = np.array([m["mu20"], m["mu02"], np.sqrt(2) * m["mu11"]]) / m["m00"]
    return m["m10"] / m["m00"], m["m01"] / m["m00"], spread


@dataclass(frozen=True, slots=True, eq=False)
class _SearchWindow:
    """Part of the reduced image around a place: its first column and row, and the place in it."""

    image: GreyImage
    left: int
    top: int
    x: int
    y: int

    @classmethod
    def around(cls, reduced: GreyLike, x: int, y: int, reach: int, side: int) -> _SearchWindow:
        """Wide enough for filters of half a `side` within `reach` of the place, and a little beyond."""
        half = reach + NEAR_PX + side
        left, top = max(x - half, 0), max(y - half, 0)
        return cls(reduced[top : max(y + half + 1, 0), left : max(x + half + 1, 0)], left, top, x - left, y - top)


@dataclass(frozen=True, slots=True, eq=False)
class _FilterMatch:
    """The best place of a filter in a window; `left` and `top` are its template's corner there."""

    window: _SearchWindow
    score: float
    shape: MotionFilter
    left: int
    top: int

    @property
    def middle(self) -> tuple[int, int]:
        h, w = self.shape.template.shape
        return self.left + w // 2, self.top + h // 2

    def blurred_target(self, scale: int) -> BlurredTarget:
        """In pixels of the full frame."""
        x, y = self.middle
        centre = np.array([x + self.window.left, y + self.window.top], dtype=float) * scale + (scale - 1) / 2
        contrast = _contrast(self.window.image, self.shape, self.left, self.top)
        return BlurredTarget(centre, self.shape.a * scale, self.shape.b * scale, self.score, contrast)


def _match_island(reduced: GreyLike, filter_set: _FilterSet, x: int, y: int, reach: int) -> _FilterMatch | None:
    """Match the only dark island near a place, by its moments; None unless there is exactly one."""
    for side in (filter_set.short, filter_set.longest):
        window = _SearchWindow.around(reduced, x, y, reach, side)
        island = _island(window, reach, 0.4 * filter_set.dot_area)
        if island is None:
            continue
        cx, cy, spread = island
        # The arcsine law's variance is half of the amplitude's square.
        motion = _divide_by_length(2 * (spread - filter_set.rest_spread))
        shape = filter_set.shapes[int(np.argmin(np.linalg.norm(filter_set.spreads - motion, axis=1)))]
        if side < filter_set.longest and 2 * max(map(abs, (*shape.a, *shape.b))) ** 2 > filter_set.dot_area:
            continue  # its longer neighbours would not be seen whole
        best = _best_match(window, [shape], round(cx), round(cy), NEAR_PX)
        return _climb(window, filter_set, best, reach) if best is not None else None
    return None


def _island(window: _SearchWindow, reach: int, least_area: float) -> tuple[float, float, FloatArray] | None:
    """Centroid and second moment of the only dark island, surrounded by paper, near the window's place."""
    image = window.image
    near = image[max(window.y - reach, 0) : window.y + reach + 1, max(window.x - reach, 0) : window.x + reach + 1]
    if not near.size:
        return None
    rank = int(0.9 * image.size)
    dark = np.partition(image, rank, axis=None)[rank] - image
    depth = float(near.max()) - float(near.min())
    _, labels, boxes, middles = cv2.connectedComponentsWithStats((dark > ISLAND_DARKNESS * depth).astype(np.uint8))
    left, top, wide, high, area = boxes[1:].T
    far = np.abs(middles[1:] - (window.x, window.y)).max(axis=1)
    whole = (left > 0) & (top > 0) & (left + wide < image.shape[1]) & (top + high < image.shape[0])
    found = np.flatnonzero(whole & (far <= reach + 0.5) & (area > least_area))
    if len(found) != 1:
        return None
    x, y, w, h = (int(v) for v in boxes[1 + found[0], :4])
    part = (slice(y, y + h), slice(x, x + w))
    cx, cy, spread = _moments_of(np.where(labels[part] == 1 + found[0], dark[part], np.float32(0)))
    return x + cx, y + cy, spread


def _best_match(
    window: _SearchWindow, shapes: Sequence[MotionFilter], cx: int, cy: int, reach: int
) -> _FilterMatch | None:
    """The best of some filters within `reach` reduced pixels of a place; None if none of them fits in the frame."""
    best: _FilterMatch | None = None
    for shape in shapes:
        h, w = shape.template.shape
        x0, y0 = max(cx - reach - w // 2, 0), max(cy - reach - h // 2, 0)
        x1, y1 = cx + reach + w // 2 + 1, cy + reach + h // 2 + 1
        part = window.image[y0:y1, x0:x1]
        if part.shape[0] < h or part.shape[1] < w:
            continue
        likeness = -cv2.matchTemplate(part, shape.template, cv2.TM_CCOEFF_NORMED)
        row, column = divmod(int(likeness.argmax()), likeness.shape[1])
        if best is None or likeness[row, column] > best.score:
            best = _FilterMatch(window, float(likeness[row, column]), shape, x0 + column, y0 + row)
    return best


def _climb(window: _SearchWindow, filter_set: _FilterSet, best: _FilterMatch, reach: int) -> _FilterMatch:
    """Improve a match: take the best of its neighbours in motion and place, until none is better."""
    tried = {id(best.shape)}
    while True:
        x, y = best.middle
        near = [shape for shape in _nearest_filters(filter_set, best.shape) if id(shape) not in tried]
        tried |= {id(shape) for shape in near}
        better = _best_match(window, near, x, y, NEAR_PX)
        if better is None or better.score <= best.score:
            return best
        bx, by = better.middle
        if max(abs(bx - window.x), abs(by - window.y)) > reach:
            return best
        best = better


def _nearest_filters(filter_set: _FilterSet, shape: MotionFilter) -> list[MotionFilter]:
    """The filters whose motions are nearest to one's, by the second moment that they give a dot."""
    away = np.linalg.norm(filter_set.spreads - filter_set.spreads[filter_set.shapes.index(shape)], axis=1)
    return [filter_set.shapes[index] for index in np.argsort(away, kind="stable")[1 : NEAREST_FILTERS + 1]]


def match_everywhere(
    reduced: GreyImage, scale: int, shapes: tuple[MotionFilter, ...], least_score: float
) -> list[BlurredTarget]:
    """Find every place of the frame that looks like a blurred dot, best first, none within a dot of a better one."""
    h, w = reduced.shape
    top_score = np.full((h, w), -1.0, dtype=np.float32)
    which = np.zeros((h, w), dtype=np.int16)
    for index, shape in enumerate(shapes):
        fh, fw = shape.template.shape
        if fh > h or fw > w:
            continue
        likeness = -cv2.matchTemplate(reduced, shape.template, cv2.TM_CCOEFF_NORMED)
        part = (slice(fh // 2, fh // 2 + likeness.shape[0]), slice(fw // 2, fw // 2 + likeness.shape[1]))
        better = likeness > top_score[part]
        top_score[part][better] = likeness[better]
        which[part][better] = index
    radius = max(1, int(shapes[0].template.shape[0] / 2 / (1 + MARGIN_RADII)))
    size = 2 * radius + 1
    peaks = (top_score == cv2.dilate(top_score, np.ones((size, size), np.uint8))) & (top_score >= least_score)
    found = []
    for row, column in np.argwhere(peaks):
        shape = shapes[which[row, column]]
        fh, fw = shape.template.shape
        contrast = _contrast(reduced, shape, column - fw // 2, row - fh // 2)
        centre = np.array([column, row], dtype=float) * scale + (scale - 1) / 2
        found.append(BlurredTarget(centre, shape.a * scale, shape.b * scale, float(top_score[row, column]), contrast))
    return sorted(found, key=lambda smear: -smear.score)


def _contrast(reduced: GreyLike, shape: MotionFilter, left: int, top: int) -> float:
    """Paper less ink by least squares."""
    h, w = shape.template.shape
    values = reduced[top : top + h, left : left + w].ravel()
    cover = shape.template.ravel()
    cover = cover - cover.mean()
    return float(-(cover @ (values - values.mean())) / (cover @ cover))


def reduce(grey: GreyImage, scale: int) -> GreyImage:
    """Average blocks of `scale` × `scale` pixels; an incomplete block at the right or bottom edge is left out."""
    if scale == 1:
        return grey
    h, w = grey.shape[0] // scale, grey.shape[1] // scale
    if not h or not w:
        return np.zeros((h, w), np.float32)
    size = (w, h)
    return cast(GreyImage, cv2.resize(grey[: h * scale, : w * scale], size, interpolation=cv2.INTER_AREA))
