"""The darkness of a dot on its own label: what lies beyond the label's edge is replaced by label.

The published procedure assumes white paper all round. On a small label the profiles would take its edge, and the
background behind it, for features of the blur. From the dot outwards, darkness falls to the label and rises again where
background begins to show through the motion; there the label ends.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from labdaemon.blur.patch.locate import darkness_map, mask_pixels
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.settings import LABEL


def label_darkness(
    patch: Patch, contrast: dict[int, float], centre_px: FloatArray, radius_px: float, reach_px: float
) -> FloatArray:
    """Darkness of the dot and its label, 0 on white and 1 in ink.

    Parameters
    ----------
    patch
        The dot with its surroundings, sharp or blurred.
    contrast
        1 − ink/white of each channel.
    centre_px
        (2,) middle of the dot or of its blur, frame coordinates.
    radius_px
        Semi-major axis of the sharp dot.
    reach_px
        How far white paper may reach from the middle.

    Returns
    -------
    (h, w); beyond the label's edge the darkness of the nearest label.
    """
    x, y = np.asarray(centre_px, dtype=np.float64) - np.asarray(patch.origin_px)
    reach_px = min(reach_px, float(np.hypot(*patch.shape)))  # unknown is infinite, and rays end with the patch
    yy, xx = np.mgrid[0 : patch.shape[0], 0 : patch.shape[1]]
    distance, angle = np.hypot(xx - x, yy - y), np.mod(np.arctan2(yy - y, xx - x), 2 * np.pi)
    label = mask_pixels(patch, distance > reach_px - 1.0)
    # White is judged on the label alone, so the second pass sees the edge more clearly.
    for _ in range(2):
        limit_px = _label_limit(darkness_map(label, contrast), float(x), float(y), radius_px + 1.0, reach_px)
        around = np.append(np.arange(LABEL.rays), LABEL.rays) * 2 * np.pi / LABEL.rays
        label = mask_pixels(label, distance > np.interp(angle, around, np.append(limit_px, limit_px[0])))
    return _fill(darkness_map(label, contrast), label.valid)


def _label_limit(dark: FloatArray, x: float, y: float, least_px: float, reach_px: float) -> FloatArray:
    """(rays,) distance from the middle at which the label ends in each direction."""
    angle = np.arange(LABEL.rays) * 2 * np.pi / LABEL.rays
    radius = np.arange(least_px, reach_px + 3.0, LABEL.step_px)
    at = y + radius * np.sin(angle)[:, None], x + radius * np.cos(angle)[:, None]
    rays = ndimage.map_coordinates(ndimage.gaussian_filter(dark, LABEL.smoothing_px), at, order=1, mode="nearest")
    limit = np.full(LABEL.rays, reach_px)
    for index, ray in enumerate(rays[:, : max(int((reach_px - least_px) / LABEL.step_px), 1)]):
        lightest = int(np.argmin(ray))
        risen = np.flatnonzero(ray[lightest:] > ray[lightest] + LABEL.rise)
        if risen.size:
            limit[index] = radius[lightest + risen[0]] - 1.0
    return np.asarray(ndimage.minimum_filter1d(limit, LABEL.neighbours, mode="wrap"))


def _fill(dark: FloatArray, valid: np.ndarray) -> FloatArray:
    """Unknown pixels take the darkness of the nearest known ones, smoothed."""
    if valid.all() or not valid.any():
        return dark
    known = valid.astype(np.float64)
    sigma = LABEL.fill_smoothing_px
    smooth = ndimage.gaussian_filter(np.where(valid, dark, 0.0), sigma)
    smooth /= np.maximum(ndimage.gaussian_filter(known, sigma), 1e-6)
    rows, columns = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.where(valid, dark, smooth[rows, columns])
