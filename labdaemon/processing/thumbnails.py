"""Find a small picture again in a later frame, to a pixel or so: a control target that shifted, a patch of any kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.imaging.lazy_image import GreyImage
from labdaemon.processing.smears import GreyLike, reduce


@dataclass(frozen=True, slots=True, eq=False)
class Thumbnail:
    """A piece of a frame.

    Attributes
    ----------
    picture
        (h, w).
    left, top
        Its place in the frame.
    """

    picture: GreyImage
    left: int
    top: int

    @classmethod
    def cut(cls, grey: GreyImage, box: tuple[int, int, int, int]) -> Thumbnail:
        """Cut (x, y, width, height) from a frame."""
        x, y, w, h = box
        return cls(grey[y : y + h, x : x + w].copy(), x, y)


def find_thumbnail(grey: GreyLike, sought: Thumbnail, reach_px: int) -> tuple[FloatArray, float]:
    """Shift at which a later frame looks most like a thumbnail.

    Parameters
    ----------
    grey
        (h, w) later frame.
    sought
        What to look for.
    reach_px
        How far from its old place.

    Returns
    -------
    shift, score
        (2,) x and y, to about the scale that the search worked at; normalised correlation, −1 if off the frame.
    """
    height, width = sought.picture.shape
    scale = 2 if min(height, width) >= 32 else 1
    small = reduce(sought.picture, scale)
    x0, y0 = max(sought.left - reach_px, 0), max(sought.top - reach_px, 0)
    # The window starts a whole number of reduced pixels from the thumbnail's own corner.
    x0, y0 = sought.left - (sought.left - x0) // scale * scale, sought.top - (sought.top - y0) // scale * scale
    window = reduce(grey[y0 : sought.top + height + reach_px, x0 : sought.left + width + reach_px], scale)
    if window.shape[0] < small.shape[0] or window.shape[1] < small.shape[1]:
        return np.zeros(2), -1.0
    likeness = cv2.matchTemplate(window, small, cv2.TM_CCOEFF_NORMED)
    row, column = divmod(int(np.argmax(likeness)), likeness.shape[1])
    shift = np.array([x0 + column * scale - sought.left, y0 + row * scale - sought.top], dtype=float)
    return cast(FloatArray, shift), float(likeness[row, column])
