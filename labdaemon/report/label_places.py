"""Places for names on a crowded image: next to what they name, and off everything that a person wants to see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_LABEL_WEIGHT = 30.0
"""A name under another cannot be read: worse than any number of covered points."""
_OUTSIDE_WEIGHT = 60.0


class LabelPlacer:
    """Places rectangles one after the other.

    Parameters
    ----------
    size
        (width, height) of the image, px.
    top
        Height of the band along the top that is taken, px.
    keep_free
        (n, 2) points that should stay visible: blurs, vectors, other marks.
    """

    def __init__(self, size: tuple[int, int], top: float, keep_free: FloatArray) -> None:
        self._size, self._top = size, top
        self._points = np.asarray(keep_free, float).reshape(-1, 2)
        self._taken: list[tuple[float, float, float, float]] = []

    def place(self, corners: Sequence[tuple[float, float]], width: float, height: float) -> tuple[float, float]:
        """Take the best of several places for a rectangle.

        Parameters
        ----------
        corners
            Left upper corners, the preferred one first.
        width, height
            Of the rectangle, px.

        Returns
        -------
        tuple of float
            The corner that covers least; the first one where several are equal.
        """
        costs = [self._cost(x, y, x + width, y + height) for x, y in corners]
        x, y = corners[int(np.argmin(costs))]
        self._taken.append((x, y, x + width, y + height))
        return x, y

    def _cost(self, left: float, top: float, right: float, bottom: float) -> float:
        x, y = self._points[:, 0], self._points[:, 1]
        covered = float(np.count_nonzero((x >= left) & (x <= right) & (y >= top) & (y <= bottom)))
        crossed = sum(left < r and right > lx and top < b and bottom > t for lx, t, r, b in self._taken)
        outside = left < 0 or top < self._top or right > self._size[0] or bottom > self._size[1]
        return covered + _LABEL_WEIGHT * crossed + _OUTSIDE_WEIGHT * outside
