"""Noise and paper texture as the residuals of a fit show them."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes
from labdaemon.blur.patch.pixels import FloatArray, NoiseModel

LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (1, 2), (2, 1), (2, 2), (0, 3), (3, 0), (0, 4), (4, 0))
LENGTHS_PX = np.geomspace(0.5, 4.0, 19)


def estimate_residual_noise(
    planes: ColourPlanes, residual: FloatArray, signal: FloatArray, valid: FloatArray, frames: int
) -> NoiseModel:
    """Read noise, photon gain and paper texture from what a fit leaves over.

    Read and photon noise differ from pixel to pixel, so whatever neighbours have in common is the paper texture. Its
    strength and length come from the covariance at distances of one to four pixels; what it does not explain of the
    variance is read noise and photon gain.

    Parameters
    ----------
    residual, signal
        (n, h, w) DN.
    valid
        (n, h, w) 0 where masked.
    frames
        Number of frames in the mean that was fitted.

    Returns
    -------
    NoiseModel
        Of a single frame.
    """
    left, level, good = (merge_planes(planes, v) for v in (residual, signal, valid))
    good = (good > 0).astype(np.float64)
    left = left * good
    strength, length = estimate_texture(left, level * good, good)
    square, s = left[good > 0] ** 2 - (strength * level[good > 0]) ** 2, level[good > 0]
    # Two clusters, ink and paper: a straight line through their means, weighted by how well each is known.
    read2, gain = _fit_variance_line(s, square)
    return NoiseModel(float(np.sqrt(max(read2 * frames, 1e-6))), float(gain * frames), strength, length)


def estimate_texture(left: FloatArray, level: FloatArray, good: FloatArray) -> tuple[float, float]:
    """Relative strength and length of the paper texture by the covariance at several distances; 0 without evidence."""
    distances, values, sds = [], [], []
    height, width = left.shape
    for dy, dx in LAGS:
        here = (slice(0, height - dy), slice(max(-dx, 0), width - max(dx, 0)))
        there = (slice(dy, height), slice(max(dx, 0), width - max(-dx, 0)))
        both = good[here] * good[there]
        weight = float(np.sum((level[here] * level[there]) ** 2 * both))
        if weight <= 0 or np.count_nonzero(both) < 100:
            continue
        product = left[here] * left[there]
        brightness = level[here] * level[there]
        values.append(float(np.sum(product * brightness * both)) / weight)
        sds.append(float(np.sqrt(np.sum((product * brightness * both) ** 2))) / weight)
        distances.append(float(np.hypot(dx, dy)))
    if len(values) < 4:
        return 0.0, 1.0
    r, v, w = np.array(distances), np.array(values), 1 / np.maximum(np.array(sds), 1e-300) ** 2
    best, strength, length = np.inf, 0.0, 1.0
    for candidate in LENGTHS_PX:
        shape = np.exp(-(r**2) / (4 * candidate**2))
        square = max(float(np.sum(w * v * shape) / np.sum(w * shape**2)), 0.0)
        cost = float(np.sum(w * (v - square * shape) ** 2))
        if cost < best:
            best, strength, length = cost, square, float(candidate)
    nothing = float(np.sum(w * v**2))
    return (float(np.sqrt(strength)), length) if nothing - best > 12.0 else (0.0, 1.0)


def _fit_variance_line(signal: FloatArray, square: FloatArray) -> tuple[float, float]:
    """Variance at zero signal, and its slope; neither negative."""
    middle = 0.5 * (float(np.percentile(signal, 2)) + float(np.percentile(signal, 98)))
    points = []
    for part in (signal < middle, signal >= middle):
        if np.count_nonzero(part) > 20:
            # A mean with the farthest left out, for hot pixels and dirt.
            kept = square[part][
                square[part] <= 16 * max(float(np.mean(square[part])), float(np.median(square[part])), 0.0)
            ]
            if kept.size == 0:
                continue
            points.append((float(np.mean(signal[part])), max(float(np.mean(kept)), 0.0)))
    if not points:
        return 1.0, 0.0
    if len(points) == 1:
        return (0.0, points[0][1] / points[0][0]) if points[0][0] > 0 else (points[0][1], 0.0)
    (s0, v0), (s1, v1) = points
    gain = max((v1 - v0) / max(s1 - s0, 1e-9), 0.0)
    read2 = v0 - gain * s0
    if read2 < 0:
        return 0.0, v1 / s1
    return read2, gain
