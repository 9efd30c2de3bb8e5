"""A picture that is made where it is looked at: most of a frame is never needed to find its targets again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]

BAND_PX = 128
"""Rows that are made at once: what they pass through stays in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class LazyPicture:
    """A grey picture, cut like an array by two slices, and made anew by each cut.

    Attributes
    ----------
    shape
        (h, w).
    make
        From left, top, right, bottom (the last two exclusive) to that part of the picture.
    sample
        (n,) values of places all over it, to judge its brightness by without making it.
    """

    shape: tuple[int, int]
    make: Callable[[int, int, int, int], Picture]
    sample: NDArray[Any]

    def __getitem__(self, place: tuple[slice, slice]) -> Picture:
        (y0, y1, _), (x0, x1, _) = (part.indices(side) for part, side in zip(place, self.shape, strict=True))
        height, width = max(y1 - y0, 0), max(x1 - x0, 0)
        if 0 < height <= 2 * BAND_PX and width:
            return self.make(x0, y0, x1, y1)
        whole = np.empty((height, width), dtype=np.float32)
        if whole.size:
            for top in range(y0, y1, BAND_PX):
                bottom = min(top + BAND_PX, y1)
                whole[top - y0 : bottom - y0] = self.make(x0, top, x1, bottom)
        return whole
