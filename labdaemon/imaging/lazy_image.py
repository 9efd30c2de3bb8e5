"""A grey image that is computed only where it is cut: most of a frame is not needed to find its targets again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

GreyImage = NDArray[np.float32]

BAND_PX = 128
"""Rows that are computed at once: their intermediate values stay in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class LazyImage:
    """A grey image, cut like an array by two slices, and computed anew by each cut.

    Attributes
    ----------
    shape
        (h, w).
    render
        From left, top, right, bottom (the last two exclusive) to that part of the image.
    sample
        (n,) values of places all over it, which give its brightness without computing it.
    """

    shape: tuple[int, int]
    render: Callable[[int, int, int, int], GreyImage]
    sample: NDArray[Any]

    def __getitem__(self, place: tuple[slice, slice]) -> GreyImage:
        (y0, y1, _), (x0, x1, _) = (part.indices(side) for part, side in zip(place, self.shape, strict=True))
        height, width = max(y1 - y0, 0), max(x1 - x0, 0)
        if 0 < height <= 2 * BAND_PX and width:
            return self.render(x0, y0, x1, y1)
        whole = np.empty((height, width), dtype=np.float32)
        if whole.size:
            for top in range(y0, y1, BAND_PX):
                bottom = min(top + BAND_PX, y1)
                whole[top - y0 : bottom - y0] = self.render(x0, top, x1, bottom)
        return whole
