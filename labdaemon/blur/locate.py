"""Rough looks at a patch: how dark each pixel is, which dark blob is the target, and how it is spread.

Starts and masks for the fits; nothing here enters a result directly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labdaemon.blur.pixels import BoolArray, FloatArray, Patch


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """A connected dark region of a patch.

    Attributes
    ----------
    mask
        (h, w) its pixels.
    others
        (h, w) pixels of other dark things, widened by their own blur.
    centre_px
        (2,) centroid of its darkness, frame coordinates.
    moment_px2
        (2, 2) second central moment of its darkness.
    box_px
        (left, top, right, bottom) inclusive, frame coordinates.
    area_px2
        Sum of its darkness.
    cut
        True where it runs off the patch.
    """

    mask: BoolArray
    others: BoolArray
    centre_px: FloatArray
    moment_px2: FloatArray
    box_px: tuple[int, int, int, int]
    area_px2: float
    cut: bool


def darkness_map(patch: Patch, contrast: dict[int, float] | None = None) -> FloatArray:
    """How dark each pixel is: 0 on white paper, about 1 in ink; a plane of light is taken out.

    Parameters
    ----------
    contrast
        1 − ink/white of each channel where known; else the darkest hundredth counts as ink.
    """
    height, width = patch.shape
    dark = np.zeros((height, width))
    finite = patch.valid & np.isfinite(patch.values)
    for channel in np.unique(patch.channel):
        here = patch.channel == channel
        good = here & finite
        if np.count_nonzero(good) < 8:
            continue
        values = patch.values[good]
        white = float(np.percentile(values, 85))
        if white <= 0:
            continue
        known = None if contrast is None else contrast.get(int(channel))
        depth = known if known is not None else 1 - float(np.percentile(values, 1)) / white
        level = np.where(good, patch.values, white)
        dark[here] = ((1 - level / white) / max(depth, 0.05))[here]
    light = _plane(dark, finite)
    result: FloatArray = (dark - light) / np.maximum(1 - light, 0.2)
    result[~finite] = 0.0
    return result


def _plane(dark: FloatArray, finite: BoolArray) -> FloatArray:
    """(h, w) the light over white paper: a plane through what is nearly white, found in four rounds."""
    height, width = dark.shape
    x = (np.arange(width) - width / 2) / width
    y = ((np.arange(height) - height / 2) / height)[:, None]
    step = 2 if dark.size > 1500 else 1
    some, ok = dark[::step, ::step].ravel(), finite[::step, ::step].ravel()
    shape = dark[::step, ::step].shape
    design = np.stack(
        (np.ones(some.size), np.broadcast_to(x[::step], shape).ravel(), np.broadcast_to(y[::step], shape).ravel()),
        axis=1,
    )
    p, tolerance = np.zeros(3), 0.15
    for _ in range(4):
        miss = np.abs(some - design @ p)
        paper = (miss < tolerance) & ok
        if np.count_nonzero(paper) < 0.05 * some.size:
            break
        used = design[paper]
        p = np.linalg.lstsq(used.T @ used, used.T @ some[paper], rcond=None)[0]
        tolerance = max(2.5 * 1.48 * float(np.median(np.abs(some - design @ p)[paper])), 0.02)
    result: FloatArray = p[0] + p[1] * x + p[2] * y
    return result


def find_blob(
    patch: Patch,
    near_px: FloatArray,
    area_px2: float,
    contrast: dict[int, float] | None,
    *,
    threshold: float | None = None,
) -> Blob | None:
    """The dark blob that is most likely the target.

    Parameters
    ----------
    near_px
        (2,) where it is expected, frame coordinates.
    area_px2
        Its expected darkness (area of the dot).
    threshold
        Darkness that counts; None takes what stands out of the noise.
    """
    dark = darkness_map(patch, contrast)
    smooth = ndimage.uniform_filter(dark, 5 if min(patch.shape) > 12 else 3, mode="nearest")
    noise = 1.48 * float(np.median(np.abs(smooth - np.median(smooth))))
    if threshold is None:
        threshold = float(np.clip(4 * noise, 0.045, 0.25))
    labels, count = ndimage.label(smooth > threshold, structure=np.ones((3, 3)))
    if count == 0:
        return None
    expected = near_px - np.asarray(patch.origin_px)
    sums = ndimage.sum_labels(np.maximum(dark, 0), labels, np.arange(1, count + 1))
    best, best_score = 0, 0.0
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        inside = labels[box] == number
        ys, xs = np.nonzero(inside)
        distance = float(np.min(np.hypot(xs + box[1].start - expected[0], ys + box[0].start - expected[1])))
        likeness = min(sums[number - 1], area_px2) / max(sums[number - 1], area_px2)
        score = likeness / (1 + (distance / max(0.5 * np.sqrt(area_px2), 3.0)) ** 2)
        if score > best_score:
            best, best_score = number, score
    if best == 0 or sums[best - 1] < 0.2 * area_px2:
        return None
    mask = labels == best
    others = ndimage.binary_dilation((labels > 0) & ~mask, iterations=2)
    return _describe(patch, dark, mask, others & ~mask)


def _describe(patch: Patch, dark: FloatArray, mask: BoolArray, others: BoolArray) -> Blob:
    height, width = patch.shape
    ys, xs = np.nonzero(mask)
    weight = np.maximum(dark[mask], 0)
    total = float(weight.sum())
    cx, cy = float(weight @ xs) / total, float(weight @ ys) / total
    dx, dy = xs - cx, ys - cy
    cross = float(weight @ (dx * dy)) / total
    moment = np.array([[float(weight @ dx**2) / total, cross], [cross, float(weight @ dy**2) / total]])
    left, top = patch.origin_px
    cut = bool(xs.min() == 0 or ys.min() == 0 or xs.max() == width - 1 or ys.max() == height - 1)
    return Blob(
        mask,
        others,
        np.array([cx + left, cy + top]),
        moment,
        (int(xs.min()) + left, int(ys.min()) + top, int(xs.max()) + left, int(ys.max()) + top),
        total,
        cut,
    )


def masked(patch: Patch, hidden: NDArray[np.bool_]) -> Patch:
    """The patch with more pixels declared invalid."""
    return Patch(patch.values, patch.channel, patch.valid & ~hidden, patch.origin_px)
