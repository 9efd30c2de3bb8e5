"""Find a small image in a later frame, to a pixel or so: a control target that shifted, a patch of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from labdaemon.blur import FloatArray
from labdaemon.imaging import GreyImage
from labdaemon.processing.matched_filter import BlurredTarget, GreyLike, reduce

PATCH_REACH_PX = 40
"""How far a textured patch may have moved."""
PATCH_SCORE = 0.35
"""Correlation below which it is not there: noise alone reaches 0.2 somewhere, a smear of its own size keeps 0.5."""


@dataclass(frozen=True, slots=True, eq=False)
class Thumbnail:
    """A piece of a frame.

    Attributes
    ----------
    image
        (h, w).
    left, top
        Its place in the frame.
    """

    image: GreyImage
    left: int
    top: int

    @classmethod
    def cut(cls, grey: GreyImage, box: tuple[int, int, int, int]) -> Thumbnail:
        """Cut (x, y, width, height) from a frame."""
        x, y, w, h = box
        return cls(grey[y : y + h, x : x + w].copy(), x, y)


def find_thumbnail(grey: GreyLike, thumbnail: Thumbnail, reach_px: int) -> tuple[FloatArray, float]:
    """Shift at which a later frame looks most like a thumbnail.

    Parameters
    ----------
    grey
        (h, w) later frame.
    thumbnail
        What to look for.
    reach_px
        How far from its old place.

    Returns
    -------
    shift, score
        (2,) x and y, to about the scale that the search worked at; normalised correlation, −1 if off the frame.
    """
    height, width = thumbnail.image.shape
    scale = 2 if min(height, width) >= 32 else 1
    small = reduce(thumbnail.image, scale)
    x0, y0 = max(thumbnail.left - reach_px, 0), max(thumbnail.top - reach_px, 0)
    # The window starts a whole number of reduced pixels from the thumbnail's own corner.
    x0 = thumbnail.left - (thumbnail.left - x0) // scale * scale
    y0 = thumbnail.top - (thumbnail.top - y0) // scale * scale
    window = reduce(grey[y0 : thumbnail.top + height + reach_px, x0 : thumbnail.left + width + reach_px], scale)
    if window.shape[0] < small.shape[0] or window.shape[1] < small.shape[1]:
        return np.zeros(2), -1.0
    likeness = cv2.matchTemplate(window, small, cv2.TM_CCOEFF_NORMED)
    row, column = divmod(int(np.argmax(likeness)), likeness.shape[1])
    shift = np.array([x0 + column * scale - thumbnail.left, y0 + row * scale - thumbnail.top], dtype=float)
    return cast(FloatArray, shift), float(likeness[row, column])


def locate_patches(
    grey: GreyLike, centres_px: FloatArray, thumbnails: Sequence[Thumbnail]
) -> list[BlurredTarget | None]:
    """Find textured patches near their places in the sharp frame (n, 2); None for one that is not there."""
    found: list[BlurredTarget | None] = []
    for centre, thumbnail in zip(centres_px, thumbnails, strict=True):
        moved, score = find_thumbnail(grey, thumbnail, PATCH_REACH_PX)
        seen = score >= PATCH_SCORE
        found.append(BlurredTarget(centre + moved, np.zeros(2), np.zeros(2), score, 0.0) if seen else None)
    return found
