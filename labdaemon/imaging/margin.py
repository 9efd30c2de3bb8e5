"""How far white paper reaches around a dot: what its smear may not exceed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.imaging.ellipse import Ellipse
from labdaemon.imaging.frame import Grey

FloatArray = NDArray[np.float64]

RAYS = 72
REACH = 16.0
"""How far is looked, in radii of the dot; paper that goes on beyond counts as ending there."""
FALL, RISE = 0.4, 0.6
"""Change against the running level, in parts of its contrast to the ink, at which paper ends."""
FOLLOW = 0.25
"""How much of a change the running level takes over at each step."""


def paper_extent(grey: Grey, dots: Sequence[Ellipse], inks: Sequence[float]) -> list[float]:
    """Distance from each dot's centre to the nearest point that is not its white paper, px.

    Parameters
    ----------
    grey
        (h, w), linear.
    dots
        The dots' ellipses.
    inks
        Brightness of each dot's ink.

    Returns
    -------
    One distance a dot. Along each of 72 rays the paper ends where the brightness falls below the ray's running level by
    40 % of the contrast, rises above it by 60 % (an edge, another dot, a brighter surface), or where the frame ends;
    slow changes of light and folds in the paper are followed.
    """
    result: list[float] = []
    height, width = grey.shape
    angles = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for dot, ink in zip(dots, inks, strict=True):
        r = dot.semi_major_px
        start = r + max(3.0, 0.15 * r)
        step = max(1.0, r / 12.0)
        distances = np.arange(start, REACH * r, step)
        at = directions[:, None, :] * distances[None, :, None] + np.array([dot.x_px, dot.y_px])
        inside = (at[..., 0] >= 0) & (at[..., 0] <= width - 1) & (at[..., 1] >= 0) & (at[..., 1] <= height - 1)
        # Averages over two steps, so that a hot pixel or a speck is not an edge.
        x0, x1 = int(max(dot.x_px - REACH * r - 2, 0)), int(min(dot.x_px + REACH * r + 3, width))
        y0, y1 = int(max(dot.y_px - REACH * r - 2, 0)), int(min(dot.y_px + REACH * r + 3, height))
        near = cv2.medianBlur(np.ascontiguousarray(grey[y0:y1, x0:x1]), 5)
        local = (at - np.array([x0, y0])).astype(np.float32)
        values = cv2.remap(near, local[..., 0], local[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        result.append(_nearest_end(values.astype(np.float64), inside, distances, ink))
    return result


def _nearest_end(values: FloatArray, inside: NDArray[np.bool_], distances: FloatArray, ink: float) -> float:
    # Each ray starts from its own paper: labels are creased, and half of one may lie in shadow.
    level = np.maximum(np.median(values[:, :2], axis=1), 1e-6)
    for k, distance in enumerate(distances):
        value = values[:, k]
        left = (value < level - FALL * (level - ink)) | (value > level + RISE * (level - ink))
        if left.any() or not inside[:, k].all():
            return float(distance)
        level += FOLLOW * (value - level)
    return float(distances[-1])
