"""Where a sensor clips, found in its frame: the values that pile up at the top of each colour channel.

The white level that a file states is often not it: a Nikon D80 clips near 3880 of 4095, 14-bit bodies likewise, and
12-bit values in a 16-bit container end at a sixteenth of it.

Noise of at least about one step of the converter spreads every brightness over several values, so that a channel's
counts fall off towards its largest value. Only clipping makes the last value (or the last few, where the camera
corrects values after clipping) more frequent than those below it. A frame without noise shows nothing of the kind, and
keeps the stated white level.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LEAST_PILE = 50
"""Pixels in a pile: fewer may be hot pixels, or hide nothing that matters."""
ABOVE = 0.01
"""Pixels above the pile, in parts of it: hot pixels of other gain."""
STEEPNESS = 1.3
"""How many times more frequent than any of the windows below it a pile is. Noise alone gives less than 1."""
WINDOWS = 8
"""Windows below the pile that it is compared with."""
WIDEST = 64
"""Widest pile that is looked for, occupied values."""
LEAST_ROUGHNESS = 2.0
"""Median size of the second difference between neighbours, in occupied values, that shows noise: rounding alone gives
1 at most."""
ROUGHNESS_TO_SD = 0.6745 * np.sqrt(6.0)
"""Median size of the second difference of noise, in its standard deviations."""
SAMPLED = 3_000_000
"""About so many pixels are counted."""
FAR_FROM_BLACK = 15.0
"""How many standard deviations of the noise a pile lies above the darkest value: black frames end low."""


def find_ceilings(values: NDArray[np.uint16], pattern: NDArray[np.uint8]) -> FloatArray:
    """Counts at which each colour channel clips.

    Parameters
    ----------
    values
        (h, w) counts as the sensor gave them.
    pattern
        (ph, pw) colour channel of each pixel of the repeating cell.

    Returns
    -------
    (channels,) counts; inf where nothing piles up.
    """
    ph, pw = pattern.shape
    height, width = values.shape
    step = max(1, round(height * width / SAMPLED)) * ph
    ceilings = np.full(int(pattern.max()) + 1, np.inf)
    largest = np.zeros(len(ceilings))
    for row in range(ph):
        for column in range(pw):
            plane = np.ascontiguousarray(values[row::step, column::pw])
            channel = pattern[row, column]
            if plane.size:
                ceilings[channel] = min(ceilings[channel], _ceiling(plane))
                largest[channel] = max(largest[channel], float(plane.max()))
    # Channels share a converter: one that just reaches the ceiling of another clips there too.
    for ceiling in ceilings[np.isfinite(ceilings)]:
        ceilings[(largest == ceiling) & np.isinf(ceilings)] = ceiling
    return ceilings


def _ceiling(plane: NDArray[np.uint16]) -> float:
    """The value at which one channel's pixels pile up, inf where they do not."""
    counts = cv2.calcHist([plane], [0], None, [65536], [0.0, 65536.0]).ravel()
    occupied = np.flatnonzero(counts)[::-1]
    above = np.concatenate(([0.0], np.cumsum(counts[occupied], dtype=np.float64)))
    width = 1
    while width <= WIDEST:
        first = _pile(above, width)
        if first is not None:
            steps, counts_dn = _roughness(plane, occupied, first + width)
            if steps >= LEAST_ROUGHNESS and width <= max(steps / ROUGHNESS_TO_SD, 1.0):
                above_black = float(occupied[first]) - float(occupied[-1])
                is_light = above_black > FAR_FROM_BLACK * counts_dn / ROUGHNESS_TO_SD
                return float(occupied[first]) if is_light else float("inf")
        width *= 2
    return float("inf")


def _pile(above: FloatArray, width: int) -> int | None:
    """Place of the topmost value of a pile, counted from the largest value down; None where there is none.

    Parameters
    ----------
    above
        (n + 1,) pixels above each of n values, from the largest value down, and all of them.
    width
        Values that a pile may spread over.
    """
    last = len(above) - 1
    inside = above[np.minimum(np.arange(last) + width, last)] - above[:-1]
    stands_out = (inside >= LEAST_PILE) & (above[:-1] <= ABOVE * inside)
    for first in np.flatnonzero(stands_out)[:WIDEST]:
        edges = np.minimum(first + width * np.arange(1, WINDOWS + 2), last)
        if inside[first] > STEEPNESS * float(np.diff(above[edges]).max()):
            # Hot pixels may begin the window; the pile begins where they end.
            return int(np.searchsorted(above[1:], ABOVE * inside[first], side="right"))
    return None


def _roughness(plane: NDArray[np.uint16], occupied: NDArray[Any], below: int) -> tuple[float, float]:
    """Median size of the second difference along rows of pixels under a pile, in occupied values and in counts.

    Occupied values, since a camera's compression curve may leave most values of the bright end out. The darkest value
    is left out as well: a sensor may clip there too.

    Parameters
    ----------
    plane
        (h, w) counts of one channel.
    occupied
        Values that occur, from the largest down.
    below
        Place in `occupied` of the first value under the pile.
    """
    rank = np.zeros(65536, dtype=np.int32)
    rank[occupied] = np.arange(len(occupied))
    sample = plane[:: max(1, plane.size // 200_000)]
    left, middle, right = rank[sample[:, :-2]], rank[sample[:, 1:-1]], rank[sample[:, 2:]]
    lightest = np.minimum(np.minimum(left, middle), right)
    darkest = np.maximum(np.maximum(left, middle), right)
    inner = (lightest >= below) & (darkest < len(occupied) - 1)
    if np.count_nonzero(inner) < LEAST_PILE:
        return 0.0, 0.0
    steps = np.abs(left - 2 * middle + right)[inner]
    light = sample.astype(np.float32)
    counts_dn = np.abs(light[:, :-2] - 2 * light[:, 1:-1] + light[:, 2:])[inner]
    return float(np.median(steps)), float(np.median(counts_dn))
