"""Dark dots on white paper, found in a sharp frame among clutter, and nothing else called a dot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import Dot, Ellipse, fit_ellipse
from labdaemon.imaging.blobs import find_blobs
from labdaemon.imaging.frame import Grey, RawFrame
from labdaemon.imaging.paper_extent import paper_extent

FloatArray = NDArray[np.float64]

RAYS = 48  # nine in ten of them must show the edge
STEPS = 40  # along each ray; the edge is interpolated between two of them
MIN_SEMI_MINOR_PX = 3.0
"""Below it the blur of lens and pixel leaves no shape to judge."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What makes a dark blob a dot.

    Attributes
    ----------
    contrast
        Least part of the paper's brightness by which the ink is darker.
    ink_spread, ink_sd
        Largest deviation (4th or 96th percentile) and standard deviation within the ink, less an even sheen, in parts
        of the contrast.
    ring_ratio
        Largest ratio, either way, of the paper's brightness on any ray to its median: shaded and shining labels stay.
    out_of_round, out_of_round_px
        Largest rms distance of the edge from its ellipse: a part of the radius, plus pixels for noise. A square's edge
        is off by 0.09 of its mean radius, a hexagon's by 0.04.
    axis_ratio
        Least ratio of the axes: 0.26 is a dot seen 75° from its normal.
    whiteness
        Least brightness of the paper in parts of that of the dots nearby, and half of it in parts of the frame's
        white: a black disc on something dark is no target.
    """

    contrast: float = 0.4
    ink_spread: float = 0.25
    ink_sd: float = 0.07
    ring_ratio: float = 1.9
    out_of_round: float = 0.018
    out_of_round_px: float = 0.12
    axis_ratio: float = 0.26
    whiteness: float = 0.4


@dataclass(frozen=True, slots=True)
class _Candidate:
    shape: Ellipse
    paper: float
    ink: float
    residual_px: float


def find_dots(
    frame: RawFrame | Grey,
    *,
    diameter_range_px: tuple[float, float] = (12.0, 200.0),
    exclude: Sequence[FloatArray] = (),
    limits: Limits = Limits(),
) -> list[Dot]:
    """Find every dark dot on white paper in a sharp frame.

    Parameters
    ----------
    frame
        The frame, or its `grey()`.
    diameter_range_px
        Smallest and largest major diameter.
    exclude
        Polygons (n, 2), px, in which nothing is a dot: coded targets already read.
    limits
        What makes a blob a dot.

    Returns
    -------
    Dots from top to bottom, then left to right; centres good to about 0.1 px, each with the extent of its paper.

    Notes
    -----
    A dot is a filled ellipse: on 48 rays from its centre the brightness rises once, from even ink to even paper, and
    the half-way points lie on one ellipse. That refuses letters, squares of coded targets, ring segments, shaded bolt
    heads and discs on a dark ground.
    """
    grey = frame.grey() if isinstance(frame, RawFrame) else np.ascontiguousarray(frame, dtype=np.float32)
    bright = float(np.percentile(grey[::5, ::5], 99.5)) if grey.size else 0.0
    if not 0.0 < bright < np.inf:
        return []
    grey = grey / np.float32(bright)  # an underexposed frame is looked at like any other
    checked: list[_Candidate] = []
    for blob in find_blobs(grey, diameter_range_px):
        if not any(_same(blob, c.shape) for c in checked):
            candidate = _check(grey, blob, limits)
            if candidate is not None:
                checked.append(candidate)
    low, high = diameter_range_px
    checked = [c for c in checked if 0.95 * low <= 2.0 * c.shape.semi_major_px <= 1.05 * high]
    kept = _white_enough(grey, _distinct(checked), limits)
    kept = [c for c in kept if not any(_inside(c.shape, polygon) for polygon in exclude)]
    kept.sort(key=lambda c: (c.shape.y_px, c.shape.x_px))
    extents = paper_extent(grey, [c.shape for c in kept], [c.ink for c in kept])
    return [
        Dot(
            x_px=c.shape.x_px,
            y_px=c.shape.y_px,
            semi_major_px=c.shape.semi_major_px,
            semi_minor_px=c.shape.semi_minor_px,
            angle_rad=c.shape.angle_rad,
            paper_px=float(extent.min()),
            label_px=tuple(extent.tolist()),
        )
        for c, extent in zip(kept, extents, strict=True)
    ]


def _same(blob: Ellipse, found: Ellipse) -> bool:
    """Whether a blob is a dot that has been found at another threshold or reduction."""
    apart = np.hypot(blob.x_px - found.x_px, blob.y_px - found.y_px)
    return bool(apart < 0.2 * found.semi_minor_px and 0.8 < blob.mean_radius_px / found.mean_radius_px < 1.25)


def _check(grey: Grey, blob: Ellipse, limits: Limits) -> _Candidate | None:
    """Fit the edge and hold it against `limits`; None if it is no dot."""
    shape, reach = blob, 0.45
    angles = _steps(0.0, 2.0 * np.pi, RAYS + 1)[:-1]
    for _ in range(3):
        # The ring reaches 45 % beyond the edge at first, since a blob's own ellipse is off by its threshold and
        # reduction; then as far as the edge's blur and the fit need.
        r = shape.mean_radius_px
        if not 3.0 <= r <= 400.0 or shape.semi_minor_px < MIN_SEMI_MINOR_PX:
            return None
        span = max(reach, 3.5 / r)
        scales = _steps(0.0 if reach > 0.4 else max(1.0 - span, 0.0), 1.0 + span, STEPS)
        profile = _sample(grey, shape.points(angles[:, None], scales[None, :]))
        if profile is None:
            return None
        inner, outer = profile[:, scales <= max(1.0 - span * 0.6, 0.3)], profile[:, -5:]
        ink, paper = float(np.median(inner)), float(np.median(outer))
        if paper <= 0.0 or paper - ink < limits.contrast * paper:
            return None
        # Half-way to each ray's own paper: shading across the label would shift a common level's edge.
        crossing = _crossings(profile, scales, 0.5 * (ink + _around(profile[:, -5:].mean(axis=1))))
        good = np.isfinite(crossing)
        if good.sum() < 0.9 * RAYS:
            return None
        points = shape.points(angles[good], crossing[good])
        fitted = _robust_fit(points)
        if fitted is None or fitted.semi_minor_px < limits.axis_ratio * fitted.semi_major_px:
            return None
        shape, reach = fitted, 0.25
    residual = np.abs(shape.radii(points) - 1.0) * shape.mean_radius_px
    rms = float(np.sqrt(np.mean(np.sort(residual)[: int(0.95 * len(residual))] ** 2)))
    if rms > limits.out_of_round * shape.mean_radius_px + limits.out_of_round_px:
        return None
    return _even(grey, shape, rms, limits)


def _even(grey: Grey, shape: Ellipse, rms: float, limits: Limits) -> _Candidate | None:
    """Ink even inside, paper even around: the last test, on rings that keep clear of the edge's blur."""
    angles = _steps(0.0, 2.0 * np.pi, RAYS + 1)[:-1]
    r = shape.semi_minor_px
    clear = max(0.15, 1.8 / r)
    scales = _steps(0.0, max(1.0 - clear, 0.2), 8)
    inner = _sample(grey, shape.points(angles[:, None], scales[None, :]))
    outer = _sample(
        grey, shape.points(angles[:, None], np.linspace(1.0 + clear, 1.0 + max(2.0 * clear, 0.3), 4)[None, :])
    )
    if inner is None or outer is None:
        return None
    ink, paper = float(np.median(inner)), float(np.median(outer))
    contrast = paper - ink
    if contrast < limits.contrast * paper:
        return None
    rough = _without_sheen(inner, angles, scales)
    if np.abs(np.percentile(rough, (4.0, 96.0))).max() > limits.ink_spread * contrast:
        return None
    if rough.std() > limits.ink_sd * contrast:
        return None
    ring = outer.mean(axis=1)
    uneven = (ring * limits.ring_ratio < paper) | (ring > limits.ring_ratio * paper) | (ring - ink < 0.4 * contrast)
    if uneven.sum() > 0.04 * RAYS:
        return None
    return _Candidate(shape, paper, ink, rms)


def _without_sheen(inner: FloatArray, angles: FloatArray, scales: FloatArray) -> FloatArray:
    """Ink's brightness less a plane through it: glossy ink reflects unevenly, but smoothly."""
    x, y = np.cos(angles)[:, None] * scales, np.sin(angles)[:, None] * scales
    design = np.stack([np.ones_like(x), x, y], axis=-1).reshape(-1, 3)
    plane = np.linalg.lstsq(design, inner.ravel(), rcond=None)[0]
    return np.asarray(inner - (design @ plane).reshape(inner.shape))


def _steps(first: float, last: float, count: int) -> FloatArray:
    return np.asarray(np.linspace(first, last, count), dtype=np.float64)


def _sample(grey: Grey, points: FloatArray) -> FloatArray | None:
    """Brightness at points (…, 2) by linear interpolation; None if any lies outside the frame."""
    height, width = grey.shape
    if points.min() < 0.0 or points[..., 0].max() > width - 1 or points[..., 1].max() > height - 1:
        return None
    at = points.astype(np.float32)
    return cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(np.float64)


def _around(ring: FloatArray) -> FloatArray:
    """Median of five neighbouring rays."""
    return np.asarray(np.median([np.roll(ring, k) for k in range(-2, 3)], axis=0))


def _crossings(profile: FloatArray, scales: FloatArray, level: FloatArray) -> FloatArray:
    """Where each ray's brightness first rises through its level, in units of the ellipse; NaN where it does not."""
    below = profile < level[:, None]
    rising = below[:, :-1] & ~below[:, 1:]
    first = np.argmax(rising, axis=1)
    rows = np.arange(len(profile))
    v0, v1 = profile[rows, first], profile[rows, first + 1]
    step = scales[1] - scales[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        place = scales[first] + step * (level - v0) / (v1 - v0)
    return np.where(rising.any(axis=1), place, np.nan)


def _robust_fit(points: FloatArray) -> Ellipse | None:
    """Ellipse through edge points, again without the few that a hot pixel or a scratch has displaced."""
    fitted = fit_ellipse(points)
    if fitted is None:
        return None
    off = np.abs(fitted.radii(points) - 1.0)
    keep = off <= max(3.0 * 1.4826 * float(np.median(off)), 1e-3)
    if keep.all() or keep.sum() < 0.8 * len(points):
        return fitted
    return fit_ellipse(points[keep])


def _distinct(candidates: list[_Candidate]) -> list[_Candidate]:
    """Each dot once, in its best fit."""
    kept: list[_Candidate] = []
    for c in sorted(candidates, key=lambda c: c.residual_px / c.shape.mean_radius_px):
        if all(
            np.hypot(c.shape.x_px - k.shape.x_px, c.shape.y_px - k.shape.y_px) > k.shape.semi_minor_px for k in kept
        ):
            kept.append(c)
    return kept


def _white_enough(grey: Grey, candidates: list[_Candidate], limits: Limits) -> list[_Candidate]:
    """Without those whose ground is much darker than the frame's white, or than the paper of the dots nearby.

    Light may fall off over a frame, but between neighbours it does not change that much.
    """
    white = float(np.percentile(grey[::5, ::5], 97.0))
    bright = [c for c in candidates if c.paper >= 0.5 * limits.whiteness * white]
    places = np.array([[c.shape.x_px, c.shape.y_px] for c in bright]).reshape(-1, 2)
    paper = np.array([c.paper for c in bright])
    kept: list[_Candidate] = []
    for c, place in zip(bright, places, strict=True):
        nearby = np.argsort(np.hypot(*(places - place).T))[1:7]
        if not nearby.size or c.paper >= limits.whiteness * float(np.median(paper[nearby])):
            kept.append(c)
    return kept


def _inside(shape: Ellipse, polygon: FloatArray) -> bool:
    return cv2.pointPolygonTest(np.asarray(polygon, dtype=np.float32), (shape.x_px, shape.y_px), False) >= 0
