"""Where a sensor begins to compress, found in its frame: noise that falls while the light rises.

Below full well the variance of a pixel's noise grows with its value: photon transfer, c + g·y (Janesick 2007,
doi:10.1117/3.725073). Where the response bends, y = f(x), the noise is scaled by the slope f' as well, and its variance
falls below that line by f'². Texture, edges and fixed pattern only add to the variance. So the smoothest blocks of each
brightness are compared: those of one colour channel near its top with all channels' below. Channels share the
converter, and white paper reads less in red and blue than in green.

Values above the knee are no measure of time, and count as saturated.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BLOCK, STRIDE = 7, 3
"""Side of the blocks, and their distance, pixels of one colour."""
BAND, SAMPLED = 56, 3_000_000
"""Of larger frames bands of so many rows are looked at, about so many pixels in all."""
BINS = 40
"""Classes of brightness from black to white."""
SMOOTHEST = 15.0
"""Percentile of the variances of a class that stands for its noise."""
LEAST_BLOCKS, LEAST_REFERENCE = 60, 150
"""Blocks in a class that is judged, and in one that others are compared with."""
LEAST_PART = 0.3
"""Lowest brightness of a class that others are compared with, in parts of theirs."""
WITHIN = 0.7
"""Part of the range from black to white above which a response may bend. Trial: sensors are linear below."""
LEAST_SLOPE2 = 0.8
"""Squared slope of the response from which it counts as linear: a slope of 0.9. Trial: noise of the classes."""
STEP = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6
"""Mixed second difference, of unit gain for noise: smooth images do not reach it."""


class _NoiseClass(NamedTuple):
    """Blocks of one channel and brightness: which class, their mean value above black, noise variance, and number."""

    place: int
    level_dn: float
    variance: float
    blocks: int


def find_knees(
    values: NDArray[np.uint16], pattern: NDArray[np.uint8], black_dn: float, tops_dn: FloatArray
) -> FloatArray:
    """Counts from which each colour channel's response bends.

    Parameters
    ----------
    values
        (h, w) counts as the sensor gave them.
    pattern
        (ph, pw) colour channel of each pixel of the repeating cell.
    black_dn
        Mean black level.
    tops_dn
        (channels,) counts at which each channel clips.

    Returns
    -------
    (channels,) counts; inf where the response is linear, or too little is bright enough to show it.
    """
    ph, pw = pattern.shape
    kept = _bands(values.shape[0] // ph, max(1, round(values.size / SAMPLED)))
    planes = {
        (int(pattern[row, column]), row, column): values[row::ph, column::pw][kept]
        for row in range(ph)
        for column in range(pw)
    }
    knees = np.full(len(tops_dn), np.inf)
    bright = {key for key, plane in planes.items() if _is_bright(plane, black_dn, float(tops_dn[key[0]]))}
    if not bright:
        return knees
    width_dn = (float(tops_dn.max()) - black_dn) / BINS
    classes = {key: _noise_classes(plane, black_dn, float(tops_dn[key[0]]), width_dn) for key, plane in planes.items()}
    everywhere = [one for own in classes.values() for one in own]
    for key in bright:
        place = _first_bent(classes[key], everywhere)
        if place is not None:
            knees[key[0]] = min(knees[key[0]], black_dn + (place - 1) * width_dn)
    return knees


def _bands(rows: int, step: int) -> NDArray[np.intp]:
    """One of `step` bands of rows. The seams between them look like edges, which only add to the noise."""
    return np.flatnonzero(np.arange(rows) // BAND % step == 0)


def _is_bright(plane: NDArray[np.uint16], black_dn: float, top_dn: float) -> bool:
    """Whether enough of a channel lies where its response may bend."""
    sample = plane[::8, ::2]
    return bool(np.mean(sample > black_dn + WITHIN * (top_dn - black_dn)) > 1e-3)


def _noise_classes(plane: NDArray[np.uint16], black_dn: float, top_dn: float, width_dn: float) -> list[_NoiseClass]:
    """Noise of the smoothest blocks of one channel for each brightness, the darkest first."""
    light = plane.astype(np.float32)
    if min(light.shape) < 3 * BLOCK:
        return []
    noise = cv2.filter2D(light, -1, STEP)
    inner = (slice(BLOCK, -BLOCK, STRIDE), slice(BLOCK, -BLOCK, STRIDE))
    # The differences reach one pixel farther than the block that they stand for.
    variance = cv2.blur(noise * noise, (BLOCK - 2, BLOCK - 2))[inner]
    smooth = cv2.blur(light, (3, 3))
    around = np.ones((BLOCK - 2, BLOCK - 2), dtype=np.uint8)
    lightest, darkest = cv2.dilate(smooth, around)[inner], cv2.erode(smooth, around)[inner]
    level = cv2.blur(light, (BLOCK, BLOCK))[inner] - np.float32(black_dn)
    clipped = cv2.dilate(light, np.ones((BLOCK, BLOCK), dtype=np.uint8))[inner] >= top_dn
    good = ~clipped & (lightest - darkest < width_dn) & (level > 0)
    level, variance = level[good], variance[good]
    place = (level / width_dn).astype(int)
    found = []
    for one in np.unique(place):
        own = variance[place == one]
        if own.size >= LEAST_BLOCKS:
            middle = float(np.median(level[place == one]))
            found.append(_NoiseClass(int(one), middle, float(np.percentile(own, SMOOTHEST)), own.size))
    return found


def _first_bent(own: list[_NoiseClass], everywhere: list[_NoiseClass]) -> int | None:
    """The darkest of the classes at a channel's top whose noise lies below the photon transfer line; None without."""
    floor = min((one.variance for one in everywhere), default=0.0)
    first = None
    for one in reversed(own):
        if one.place < WITHIN * BINS or _slope2(one, everywhere, floor) >= LEAST_SLOPE2:
            break
        first = one.place
    return first


def _slope2(one: _NoiseClass, everywhere: list[_NoiseClass], floor: float) -> float:
    """Squared slope of the response: the noise of a class over what darker ones predict; inf where none do.

    The floor is noise that does not depend on the light: the least variance of all is its upper bound.
    """
    predicted = [
        floor + (other.variance - floor) * one.level_dn / other.level_dn
        for other in everywhere
        if other.blocks >= LEAST_REFERENCE
        and other.place < WITHIN * BINS
        and other.level_dn > LEAST_PART * one.level_dn
    ]
    return one.variance / min(predicted) if predicted and min(predicted) > 0 else float("inf")
