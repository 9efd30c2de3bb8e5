"""A picture that is made where it is looked at: most of a frame is never needed to find its targets again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]

TILE = 128
"""Side of what is made at once, px: large enough that the work outweighs the calls."""


class LazyPicture:
    """A grey picture, cut like an array by two slices, whose tiles are made at their first use.

    Parameters
    ----------
    shape
        (h, w).
    make
        From left, top, right, bottom (the last two exclusive) to that part of the picture.
    sample
        (n,) values of places all over it, to judge its brightness by without making it.
    tile
        Side of a tile, px.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        make: Callable[[int, int, int, int], Picture],
        sample: NDArray[Any],
        *,
        tile: int = TILE,
    ) -> None:
        self.shape = shape
        self.sample = sample
        self._make = make
        self._tile = tile
        self._made = np.zeros((-(-shape[0] // tile), -(-shape[1] // tile)), dtype=np.bool_)
        # Memory that is never written to costs nothing.
        self._picture: Picture = np.empty(shape, dtype=np.float32)

    @property
    def size(self) -> int:
        """Number of pixels."""
        return self.shape[0] * self.shape[1]

    def __getitem__(self, place: tuple[slice, slice]) -> Picture:
        (y0, y1, _), (x0, x1, _) = (part.indices(side) for part, side in zip(place, self.shape, strict=True))
        if y1 > y0 and x1 > x0:
            tile = self._tile
            left, right = x0 // tile, -(-x1 // tile)
            for row in range(y0 // tile, -(-y1 // tile)):
                if not self._made[row, left:right].all():
                    self._fill(row, left, right)
        return self._picture[place]

    def _fill(self, row: int, left: int, right: int) -> None:
        """Make what is missing of a row of tiles, neighbours together."""
        height, width = self.shape
        top, bottom = row * self._tile, min((row + 1) * self._tile, height)
        missing = np.flatnonzero(~self._made[row, left:right]) + left
        for run in np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1):
            x0, x1 = int(run[0]) * self._tile, min((int(run[-1]) + 1) * self._tile, width)
            self._picture[top:bottom, x0:x1] = self._make(x0, top, x1, bottom)
        self._made[row, left:right] = True
