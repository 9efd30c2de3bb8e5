"""Blurred dots as matched filters see them: what a dot may look like after a second of motion, and where it lies.

The picture is reduced until a dot is a few pixels across, so that a search over place, length and direction of the
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

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.imaging.lazy_image import GreyImage, LazyImage

GreyLike = GreyImage | LazyImage
"""A picture, or one that is made where it is looked at."""

MARGIN = 0.7
"""White paper that a filter wants to see around the smear, in dot radii."""
STRAIGHT = ((0.0, 1), (0.45, 4), (0.8, 6), (1.2, 8), (1.7, 10), (2.3, 12), (3.0, 14), (4.0, 16))
"""Semi-amplitudes in dot radii that are tried, and in how many directions."""
ROUND = (0.6, 1.0, 1.6, 2.4, 3.4)
"""Radii of circular orbits that are tried, in dot radii."""
COARSE = 3
"""Of so many filters one is tried at first."""
ISLAND = 0.1
"""Darkness, in parts of the darkest, by which a smear stands out as an island in white paper."""
SHORT = 1.75
"""Semi-amplitude in dot radii up to which a smaller window is looked at, first."""
ALIKE = 7
"""Filters tried around the best one so far."""
NEAR = 2
"""How far from the place of the best one they are tried, reduced pixels."""
SURE_SCORE = 0.85
"""Correlation below which the coarse search is not trusted, and everything is tried."""


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """What a dot looks like after one motion.

    Attributes
    ----------
    a, b
        (2,) semi-axes of the motion, reduced pixels.
    picture
        (h, w) share of the exposure for which each pixel was covered; odd sides, centred.
    """

    a: FloatArray
    b: FloatArray
    picture: GreyImage


@dataclass(frozen=True, slots=True, eq=False)
class Smear:
    """A place in a frame that looks like a blurred dot.

    Attributes
    ----------
    centre_px, a_px, b_px
        (2,) mean position and rough semi-axes, pixels of the full frame.
    score
        Normalised correlation, 1 for a perfect likeness.
    contrast
        Paper less ink, in the searched picture's units.
    """

    centre_px: FloatArray
    a_px: FloatArray
    b_px: FloatArray
    score: float
    contrast: float


@lru_cache(maxsize=64)
def filters(semi_major: float, semi_minor: float, angle_rad: float) -> tuple[Filter, ...]:
    """Filters of all motions tried, for a dot's ellipse in reduced pixels."""
    radius = (semi_major + semi_minor) / 2
    motions = [(np.zeros(2), np.zeros(2))]
    for ratio, directions in STRAIGHT[1:]:
        for k in range(directions):
            angle = np.pi * k / directions
            motions.append((ratio * radius * np.array([np.cos(angle), np.sin(angle)]), np.zeros(2)))
    motions += [(np.array([r * radius, 0.0]), np.array([0.0, r * radius])) for r in ROUND]
    return tuple(Filter(a, b, _picture(semi_major, semi_minor, angle_rad, a, b)) for a, b in motions)


def _picture(semi_major: float, semi_minor: float, angle_rad: float, a: FloatArray, b: FloatArray) -> GreyImage:
    margin = MARGIN * (semi_major + semi_minor) / 2
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
        # An edge one reduced pixel wide stands for lens blur and reduction together.
        total += np.clip(0.5 + (1.0 - np.hypot(along, across)) * semi_minor, 0.0, 1.0)
    return cast(GreyImage, (total / steps).astype(np.float32))


def best_smear(
    reduced: GreyLike, scale: int, expected_px: FloatArray, reach_px: float, shapes: tuple[Filter, ...]
) -> Smear | None:
    """Find the most dot-like place within `reach_px` (in x and in y) of where a target is expected.

    Parameters
    ----------
    reduced
        (h, w) picture, reduced `scale` times by area.
    scale
        Full pixels a reduced one.
    expected_px
        (2,) place in the full frame.
    shapes
        What to look for, see `filters`.

    Returns
    -------
    Smear or None
        None when the neighbourhood lies off the frame.
    """
    x, y = (np.asarray(expected_px) - (scale - 1) / 2) / scale
    reach = max(1, round(reach_px / scale))
    family = _family(shapes)
    best = _lone_match(reduced, family, round(x), round(y), reach) if len(shapes) > COARSE else None
    if best is None or best.score < SURE_SCORE:
        window = _Window.around(reduced, round(x), round(y), reach, family.longest)
        best = _best_match(window, shapes[::COARSE], window.x, window.y, reach)
        if len(shapes) > COARSE and best is not None:
            best = _climbed(window, family, best, reach)
            if best.score < SURE_SCORE:
                best = _best_match(window, shapes, window.x, window.y, reach)
    return best.smear(scale) if best is not None else None


@dataclass(frozen=True, slots=True, eq=False)
class _Family:
    """The filters of one dot, and what is needed to choose among them.

    Attributes
    ----------
    spreads
        (n, 3) second moment of each filter's motion over its length: opposite directions agree.
    rest_spread
        (3,) second moment of the dot at rest.
    dot_area
        Of the dot at rest.
    short, longest
        Half sides of the longest filter of `SHORT` radii, and of all.
    """

    shapes: tuple[Filter, ...]
    spreads: FloatArray
    rest_spread: FloatArray
    dot_area: float
    short: int
    longest: int


@lru_cache(maxsize=64)
def _family(shapes: tuple[Filter, ...]) -> _Family:
    a, b = np.array([shape.a for shape in shapes]), np.array([shape.b for shape in shapes])
    moment = np.stack([a[:, 0] ** 2 + b[:, 0] ** 2, a[:, 1] ** 2 + b[:, 1] ** 2], axis=1)
    cross = np.sqrt(2) * (a[:, 0] * a[:, 1] + b[:, 0] * b[:, 1])
    rest = shapes[0].picture
    area = float(rest.sum())
    radius = np.sqrt(area / np.pi)
    sides = [max(shape.picture.shape) // 2 for shape in shapes]
    near = [side for side, size in zip(sides, moment.sum(axis=1), strict=True) if size <= (SHORT * radius) ** 2]
    return _Family(
        shapes, _over_length(np.column_stack([moment, cross])), _spread_of(rest)[2], area, max(near), max(sides)
    )


def _over_length(moment: FloatArray) -> FloatArray:
    """(…, 3) second moments of motions, xx, yy and √2·xy, over the motions' length."""
    result: FloatArray = moment / np.sqrt(np.maximum(moment[..., :1] + moment[..., 1:2], 1e-12))
    return result


def _spread_of(dark: GreyImage) -> tuple[float, float, FloatArray]:
    """Centroid x and y of a darkness, and its second moment (xx, yy, √2·xy)."""
    m = cv2.moments(dark)
    spread = np.array([m["mu20"], m["mu02"], np.sqrt(2) * m["mu11"]]) / m["m00"]
    return m["m10"] / m["m00"], m["m01"] / m["m00"], spread


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Part of the reduced picture about a place: where it begins, and the place in it."""

    picture: GreyImage
    left: int
    top: int
    x: int
    y: int

    @classmethod
    def around(cls, reduced: GreyLike, x: int, y: int, reach: int, side: int) -> _Window:
        """Wide enough for filters of half a `side` within `reach` of the place, and a little beyond."""
        half = reach + NEAR + side
        left, top = max(x - half, 0), max(y - half, 0)
        return cls(reduced[top : max(y + half + 1, 0), left : max(x + half + 1, 0)], left, top, x - left, y - top)


@dataclass(frozen=True, slots=True, eq=False)
class _Match:
    """The best place of a filter in a window; `left` and `top` are where its picture begins there."""

    window: _Window
    score: float
    shape: Filter
    left: int
    top: int

    @property
    def middle(self) -> tuple[int, int]:
        h, w = self.shape.picture.shape
        return self.left + w // 2, self.top + h // 2

    def smear(self, scale: int) -> Smear:
        """In pixels of the full frame."""
        x, y = self.middle
        centre = np.array([x + self.window.left, y + self.window.top], dtype=float) * scale + (scale - 1) / 2
        contrast = _contrast(self.window.picture, self.shape, self.left, self.top)
        return Smear(centre, self.shape.a * scale, self.shape.b * scale, self.score, contrast)


def _lone_match(reduced: GreyLike, family: _Family, x: int, y: int, reach: int) -> _Match | None:
    """The match of the one dark island near a place, by way of its moments; None unless there is exactly one."""
    for side in (family.short, family.longest):
        window = _Window.around(reduced, x, y, reach, side)
        island = _island(window, reach, 0.4 * family.dot_area)
        if island is None:
            continue
        cx, cy, spread = island
        # The arcsine law's variance is half of the amplitude's square.
        motion = _over_length(2 * (spread - family.rest_spread))
        shape = family.shapes[int(np.argmin(np.linalg.norm(family.spreads - motion, axis=1)))]
        if side < family.longest and 2 * max(map(abs, (*shape.a, *shape.b))) ** 2 > family.dot_area:
            continue  # its longer neighbours would not be seen whole
        best = _best_match(window, [shape], round(cx), round(cy), NEAR)
        return _climbed(window, family, best, reach) if best is not None else None
    return None


def _island(window: _Window, reach: int, least_area: float) -> tuple[float, float, FloatArray] | None:
    """Centroid and second moment of the only dark thing with paper all round that lies near the window's place."""
    picture = window.picture
    near = picture[max(window.y - reach, 0) : window.y + reach + 1, max(window.x - reach, 0) : window.x + reach + 1]
    if not near.size:
        return None
    rank = int(0.9 * picture.size)
    dark = np.partition(picture, rank, axis=None)[rank] - picture
    depth = float(near.max()) - float(near.min())
    _, labels, boxes, middles = cv2.connectedComponentsWithStats((dark > ISLAND * depth).astype(np.uint8))
    left, top, wide, high, area = boxes[1:].T
    far = np.abs(middles[1:] - (window.x, window.y)).max(axis=1)
    whole = (left > 0) & (top > 0) & (left + wide < picture.shape[1]) & (top + high < picture.shape[0])
    found = np.flatnonzero(whole & (far <= reach + 0.5) & (area > least_area))
    if len(found) != 1:
        return None
    x, y, w, h = (int(v) for v in boxes[1 + found[0], :4])
    part = (slice(y, y + h), slice(x, x + w))
    cx, cy, spread = _spread_of(np.where(labels[part] == 1 + found[0], dark[part], np.float32(0)))
    return x + cx, y + cy, spread


def _best_match(window: _Window, shapes: Sequence[Filter], cx: int, cy: int, reach: int) -> _Match | None:
    """The best of some filters within `reach` reduced pixels of a place; None where none of them fits in the frame."""
    best: _Match | None = None
    for shape in shapes:
        h, w = shape.picture.shape
        x0, y0 = max(cx - reach - w // 2, 0), max(cy - reach - h // 2, 0)
        x1, y1 = cx + reach + w // 2 + 1, cy + reach + h // 2 + 1
        part = window.picture[y0:y1, x0:x1]
        if part.shape[0] < h or part.shape[1] < w:
            continue
        likeness = -cv2.matchTemplate(part, shape.picture, cv2.TM_CCOEFF_NORMED)
        row, column = divmod(int(likeness.argmax()), likeness.shape[1])
        if best is None or likeness[row, column] > best.score:
            best = _Match(window, float(likeness[row, column]), shape, x0 + column, y0 + row)
    return best


def _climbed(window: _Window, family: _Family, best: _Match, reach: int) -> _Match:
    """From a rough match to the best of its neighbours in motion and place, until none is better."""
    tried = {id(best.shape)}
    while True:
        x, y = best.middle
        near = [shape for shape in _alike(family, best.shape) if id(shape) not in tried]
        tried |= {id(shape) for shape in near}
        better = _best_match(window, near, x, y, NEAR)
        if better is None or better.score <= best.score:
            return best
        bx, by = better.middle
        if max(abs(bx - window.x), abs(by - window.y)) > reach:
            return best
        best = better


def _alike(family: _Family, shape: Filter) -> list[Filter]:
    """The filters whose motions are nearest to one's, by the spread that they give a dot."""
    away = np.linalg.norm(family.spreads - family.spreads[family.shapes.index(shape)], axis=1)
    return [family.shapes[index] for index in np.argsort(away, kind="stable")[1 : ALIKE + 1]]


def all_smears(reduced: GreyImage, scale: int, shapes: tuple[Filter, ...], least_score: float) -> list[Smear]:
    """Find every place of the frame that looks like a blurred dot, best first, none within a dot of a better one."""
    h, w = reduced.shape
    top_score = np.full((h, w), -1.0, dtype=np.float32)
    which = np.zeros((h, w), dtype=np.int16)
    for index, shape in enumerate(shapes):
        fh, fw = shape.picture.shape
        if fh > h or fw > w:
            continue
        likeness = -cv2.matchTemplate(reduced, shape.picture, cv2.TM_CCOEFF_NORMED)
        part = (slice(fh // 2, fh // 2 + likeness.shape[0]), slice(fw // 2, fw // 2 + likeness.shape[1]))
        better = likeness > top_score[part]
        top_score[part][better] = likeness[better]
        which[part][better] = index
    radius = max(1, int(shapes[0].picture.shape[0] / 2 / (1 + MARGIN)))
    size = 2 * radius + 1
    peaks = (top_score == cv2.dilate(top_score, np.ones((size, size), np.uint8))) & (top_score >= least_score)
    found = []
    for row, column in np.argwhere(peaks):
        shape = shapes[which[row, column]]
        fh, fw = shape.picture.shape
        contrast = _contrast(reduced, shape, column - fw // 2, row - fh // 2)
        centre = np.array([column, row], dtype=float) * scale + (scale - 1) / 2
        found.append(Smear(centre, shape.a * scale, shape.b * scale, float(top_score[row, column]), contrast))
    return sorted(found, key=lambda smear: -smear.score)


def _contrast(reduced: GreyLike, shape: Filter, left: int, top: int) -> float:
    """Paper less ink by least squares."""
    h, w = shape.picture.shape
    values = reduced[top : top + h, left : left + w].ravel()
    cover = shape.picture.ravel()
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
