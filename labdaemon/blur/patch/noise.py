"""Noise models from the images themselves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import ndimage

from labdaemon.blur.patch.colour_planes import make_planes
from labdaemon.blur.patch.pixels import FloatArray, NoiseModel, Patch


def _second_differences(values: FloatArray, valid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Noise of each pixel by the mixed second difference, which a smooth image does not reach."""
    kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
    noise = ndimage.convolve(values, kernel, mode="nearest")
    good = ndimage.minimum_filter(valid, 3, mode="constant", cval=0)
    return noise, good


def estimate_noise(patches: Sequence[Patch]) -> NoiseModel:
    """Read noise and photon gain from patches of one frame, in dark and in bright parts.

    The local noise (mixed second differences on each colour's own colour plane; robust to edges, blind to anything
    smooth) is regressed on the local signal. What is correlated from pixel to pixel, the paper's texture, hardly shows
    in it.

    Parameters
    ----------
    patches
        Any parts of one frame.

    Returns
    -------
    NoiseModel
        With `texture` 0.
    """
    signals: list[FloatArray] = []
    squares: list[FloatArray] = []
    for patch in patches:
        planes = make_planes(patch)
        for values, valid in zip(planes.values, planes.valid, strict=True):
            if min(values.shape) < 5:
                continue
            noise, good = _second_differences(values, valid.astype(np.float64))
            level = ndimage.uniform_filter(values, 3, mode="nearest")
            slope = ndimage.generic_gradient_magnitude(ndimage.uniform_filter(values, 3), ndimage.sobel) / 8
            flat = (good > 0) & (slope < np.percentile(slope, 70))
            signals.append(level[flat])
            squares.append(noise[flat] ** 2)
    if not signals or sum(map(len, signals)) < 20:
        return NoiseModel(1.0, 0.0)
    signal, square = np.concatenate(signals), np.concatenate(squares)
    edges = np.unique(np.percentile(signal, np.linspace(0, 100, 9)))
    centres, variances, counts = [], [], []
    for low, high in pairwise(edges):
        part = (signal >= low) & (signal <= high)
        if np.count_nonzero(part) < 10:
            continue
        centres.append(float(np.median(signal[part])))
        variances.append(float(np.median(square[part])) / 0.4549)
        counts.append(float(np.count_nonzero(part)))
    if not centres:
        return NoiseModel(1.0, 0.0)
    x, v, w = np.array(centres), np.array(variances), np.sqrt(np.array(counts))
    floor = max(1e-3 * float(np.max(v)), 1e-6 * float(np.max(np.abs(x))) ** 2, 1e-12)
    relative = w / np.maximum(v, floor)
    gain, read2 = 0.0, float(np.average(v, weights=w))
    if len(x) > 1 and np.ptp(x) > 0:
        design = np.stack((np.ones_like(x), x), axis=1) * relative[:, None]
        read2, gain = np.linalg.lstsq(design, v * relative, rcond=None)[0]
        if gain < 0:
            gain, read2 = 0.0, float(np.average(v, weights=w))
        elif read2 < 0:
            read2 = 0.0
            gain = float(np.sum(relative**2 * x * v) / np.sum(relative**2 * x**2))
    return NoiseModel(float(np.sqrt(max(read2, floor))), float(gain))
