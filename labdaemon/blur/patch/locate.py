"""Rough looks at a patch: how dark each pixel is, which dark blob is the target, and how it is spread.

Starts and masks for the fits; nothing here enters a result directly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch
from labdaemon.blur.settings import LOCATE


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """A connected dark region of a patch.

    Attributes
    ----------
    other_blobs
        (h, w) pixels of other dark things, widened by their own blur.
    centre_px
        (2,) centroid of its darkness, frame coordinates.
    moment_px2
        (2, 2) second central moment of its darkness.
    box_px
        (left, top, right, bottom) inclusive, frame coordinates.
    area_px2
        Sum of its darkness.
    clipped
        True where it runs off the patch.
    """

    other_blobs: BoolArray
    centre_px: FloatArray
    moment_px2: FloatArray
    box_px: tuple[int, int, int, int]
    area_px2: float
    clipped: bool


def darkness_map(patch: Patch, contrast: dict[int, float] | None = None) -> FloatArray:
    """How dark each pixel is: 0 on white paper, about 1 in ink; a plane of light is taken out.

    Parameters
    ----------
    contrast
        1 − ink/white of each channel where known; else the darkest hundredth counts as ink.
    """
    dark, finite = _relative_darkness(patch, contrast)
    return _subtract_light_plane(dark, finite, LOCATE.coarse_plane_pixels)


def _relative_darkness(patch: Patch, contrast: dict[int, float] | None) -> tuple[FloatArray, BoolArray]:
    """Darkness of each channel against its own white, and where it is known."""
    dark = np.zeros(patch.shape)
    finite = patch.valid & np.isfinite(patch.values)
    whole = bool(finite.all())
    for channel, part in _channel_parts(patch.channel):
        values = patch.values[part]
        good = values.ravel() if whole else values[finite[part]]
        if good.size < 8:
            continue
        white = _quantile(good, 0.85)
        if white <= 0:
            continue
        known = None if contrast is None else contrast.get(channel)
        depth = max(known if known is not None else 1 - _quantile(good, 0.01) / white, 0.05)
        dark[part] = values * (-1 / (white * depth)) + 1 / depth
    dark[~finite] = 0.0
    return dark, finite


Part = tuple[slice, slice] | BoolArray


def _channel_parts(channel: NDArray[np.uint8]) -> list[tuple[int, Part]]:
    """Which pixels belong to each channel: the colour planes of a mosaic of period two, or whatever there is."""
    if np.array_equal(channel[2:], channel[:-2]) and np.array_equal(channel[:, 2:], channel[:, :-2]):
        first = channel[:2, :2]
        return [(int(first[y, x]), np.s_[y::2, x::2]) for y in range(first.shape[0]) for x in range(first.shape[1])]
    return [(int(one), channel == one) for one in np.unique(channel)]


def _quantile(values: FloatArray, part: float) -> float:
    place = int(part * (values.size - 1) + 0.5)
    return float(np.partition(values, place)[place])


def _subtract_light_plane(dark: FloatArray, finite: BoolArray, many: int) -> FloatArray:
    """The darkness against a plane through what is nearly white; 0 where it is not known.

    Of more than `many` pixels every other one of every other row is enough to find the plane.
    """
    height, width = dark.shape
    x = (np.arange(width) - width / 2) / width
    y = ((np.arange(height) - height / 2) / height)[:, None]
    step = 2 if dark.size > many else 1
    some, ok = dark[::step, ::step], finite[::step, ::step].ravel()
    design = np.empty((3, *some.shape))
    design[0], design[1], design[2] = 1.0, x[::step], y[::step]
    design, some = design.reshape(3, -1), some.ravel()
    p: FloatArray = np.zeros(3)
    tolerance, before = 0.15, ok
    least = 1e-9 * some.size * np.eye(3)
    for _ in range(4):
        paper = (np.abs(some - p @ design) < tolerance) & ok
        if np.count_nonzero(paper) < 0.05 * some.size or np.array_equal(paper, before):
            break
        before = paper
        used = design * paper
        p = np.linalg.solve(used @ design.T + least, used @ some).astype(np.float64)
        tolerance = max(2.5 * 1.48 * _quantile(np.abs(some - p @ design)[paper], 0.5), 0.02)
    light = p[0] + p[1] * x + p[2] * y
    result: FloatArray = (dark - light) / np.maximum(1 - light, 0.2)
    result[~finite] = 0.0
    return result


def _bin_pixels(dark: FloatArray, finite: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Squares of four pixels as one; a last single row or column is left out."""
    height, width = dark.shape[0] // 2 * 2, dark.shape[1] // 2 * 2
    corners = [np.s_[y:height:2, x:width:2] for y in (0, 1) for x in (0, 1)]
    count, total = np.zeros((2, height // 2, width // 2))
    for corner in corners:
        count += finite[corner]
        total += dark[corner]
    return total / np.maximum(count, 1.0), count > 0


def find_blob(
    patch: Patch,
    near_px: FloatArray,
    area_px2: float,
    contrast: dict[int, float] | None,
    *,
    threshold: float | None = None,
    path_px: FloatArray | None = None,
) -> Blob | None:
    """The dark blob that is most likely the target.

    Large dots on plain paper are looked for at half the resolution.

    Parameters
    ----------
    near_px
        (2,) where it is expected, frame coordinates.
    area_px2
        Its expected darkness (area of the dot).
    threshold
        Darkness that counts; None takes what stands out of the noise.
    path_px
        (2,) semi-axis of a path about `near_px` along which the target may have left several blobs: a lamp that was off
        in parts of the cycle divides its blur.
    """
    dark, finite = _relative_darkness(patch, contrast)
    coarse = contrast is not None and threshold is None and area_px2 > LOCATE.coarse_search_area_px2
    scale = 2 if coarse else 1
    if coarse:
        dark, finite = _bin_pixels(dark, finite)
    dark = _subtract_light_plane(dark, finite, LOCATE.coarse_plane_pixels // scale)
    smooth = ndimage.uniform_filter(dark, 5 if min(dark.shape) > 12 and not coarse else 3, mode="nearest")
    if threshold is None:
        noise = 1.48 * _quantile(np.abs(smooth - _quantile(smooth.ravel(), 0.5)).ravel(), 0.5)
        threshold = float(np.clip(4 * noise, 0.045, 0.25))
    labels, count = ndimage.label(smooth > threshold, structure=np.ones((3, 3)))
    if count == 0:
        return None
    expected = (near_px - np.asarray(patch.origin_px) - (scale - 1) / 2) / scale
    area = area_px2 / scale**2
    sums: FloatArray = np.bincount(labels.ravel(), np.maximum(dark, 0).ravel())[1:].astype(np.float64)
    best = _select_blob(labels, sums, expected, area, 3.0 / scale) if count > 1 else 1
    if sums[best - 1] < 0.2 * area:
        return None
    mask = labels == best
    if path_px is not None and count > 1:
        on_path = _near_path(dark.shape, expected, path_px / scale, 1.2 * np.sqrt(area / np.pi))
        inside = np.bincount(labels.ravel(), on_path.ravel(), count + 1) > 0.9 * np.bincount(labels.ravel())
        inside[[0, best]] = False, True
        mask = inside[labels]
    other_blobs = np.zeros(patch.shape, dtype=bool)
    if count > 1:
        near = ndimage.binary_dilation((labels > 0) & ~mask, iterations=2 // scale) & ~mask
        other_blobs[: near.shape[0] * scale, : near.shape[1] * scale] = near.repeat(scale, axis=0).repeat(scale, axis=1)
    return _describe_blob(patch, dark, mask, other_blobs, scale)


def _near_path(shape: tuple[int, int], middle: FloatArray, path: FloatArray, radius: float) -> BoolArray:
    """Pixels within a distance of a straight path."""
    x, y = np.arange(shape[1]) - middle[0], (np.arange(shape[0]) - middle[1])[:, None]
    along = np.clip((x * path[0] + y * path[1]) / max(float(path @ path), 1e-12), -1.0, 1.0)
    result: BoolArray = np.hypot(x - along * path[0], y - along * path[1]) <= radius
    return result


def _select_blob(
    labels: NDArray[np.signedinteger[Any]], sums: FloatArray, expected: FloatArray, area: float, least_reach: float
) -> int:
    """Which of several blobs is near enough and large enough."""
    best, best_score = 1, 0.0
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        inside = labels[box] == number
        ys, xs = np.nonzero(inside)
        distance = float(np.min(np.hypot(xs + box[1].start - expected[0], ys + box[0].start - expected[1])))
        likeness = min(sums[number - 1], area) / max(sums[number - 1], area)
        score = likeness / (1 + (distance / max(0.5 * np.sqrt(area), least_reach)) ** 2)
        if score > best_score:
            best, best_score = number, score
    return best


def _describe_blob(patch: Patch, dark: FloatArray, mask: BoolArray, other_blobs: BoolArray, scale: int) -> Blob:
    height, width = mask.shape
    ys, xs = np.nonzero(mask)
    weight = np.maximum(dark[mask], 0)
    total = float(weight.sum())
    cx, cy = float(weight @ xs) / total, float(weight @ ys) / total
    dx, dy = xs - cx, ys - cy
    cross = float(weight @ (dx * dy)) / total
    moment = np.array([[float(weight @ dx**2) / total, cross], [cross, float(weight @ dy**2) / total]])
    left, top = patch.origin_px
    x0, y0, x1, y1 = int(xs.min()), int(ys.min()), int(xs.max()), int(ys.max())
    last = scale - 1
    return Blob(
        other_blobs,
        np.array([scale * cx + last / 2 + left, scale * cy + last / 2 + top]),
        scale**2 * moment - (scale**2 - 1) / 12 * np.eye(2),
        (scale * x0 + left, scale * y0 + top, scale * x1 + last + left, scale * y1 + last + top),
        scale**2 * total,
        x0 == 0 or y0 == 0 or x1 == width - 1 or y1 == height - 1,
    )


def mask_pixels(patch: Patch, hidden: NDArray[np.bool_]) -> Patch:
    """The patch with more pixels declared invalid."""
    return Patch(patch.values, patch.channel, patch.valid & ~hidden, patch.origin_px)
