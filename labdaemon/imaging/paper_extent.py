"""How far white paper reaches around a dot: what its smear may not exceed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import Ellipse
from labdaemon.imaging.frame import Grey

FloatArray = NDArray[np.float64]

RAYS = 72
REACH = 16.0
"""How far is looked, in radii of the dot; paper that reaches further counts as ending there."""
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
    if not dots:
        return []
    result: list[float] = []
    height, width = grey.shape
    # Medians, so that a hot pixel or a speck is no edge; square-root light in eight bits, for speed.
    smooth = cv2.medianBlur(cv2.convertScaleAbs(cv2.sqrt(np.maximum(grey, 0.0)), alpha=255.0), 5)
    angles = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for dot, ink in zip(dots, inks, strict=True):
        r = dot.semi_major_px
        start = r + max(3.0, 0.15 * r)
        step = max(1.0, r / 12.0)
        distances = np.arange(start, REACH * r, step)
        at = directions[:, None, :] * distances[None, :, None] + np.array([dot.x_px, dot.y_px])
        inside = (at[..., 0] >= 0) & (at[..., 0] <= width - 1) & (at[..., 1] >= 0) & (at[..., 1] <= height - 1)
        xs, ys = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
        roots = cv2.remap(smooth, xs, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
        values = (roots / 255.0) ** 2
        result.append(_nearest_end(values, inside, distances, ink))
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
