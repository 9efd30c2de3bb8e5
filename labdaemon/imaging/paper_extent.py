"""How far the label of a dot reaches in every direction: what the blur of the dot may not exceed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import Ellipse
from labdaemon.imaging.frame import Grey
from labdaemon.imaging.label_steps import first_steps

FloatArray = NDArray[np.float64]

RAYS = 72  # one each five degrees: a corner of the paper is not missed
REACH = 16.0
"""How far is looked, in radii of the dot; paper that reaches further counts as ending there."""
FALL, RISE = 0.4, 0.6
"""Change against the running level, in parts of its contrast to the ink, at which paper ends."""
FIRST_PX, NEAR_PX = 2.0, 12.0
"""Where a ray begins beyond the dot, and up to where it is sampled at every pixel."""
START_SAMPLES = 3
"""Samples of which the lightest is the paper: the first lie in the blur of the dot, the next beyond a narrow rim."""
FOLLOW, LAG = 0.25, 4
"""How much of a change the running level takes over at each step, and how many steps later it counts."""


def paper_extent(grey: Grey, dots: Sequence[Ellipse], inks: Sequence[float]) -> list[FloatArray]:
    """Distance from each dot's centre to the end of its white paper along 72 rays, px.

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
    (72,) for each dot; the first ray points to +x, the next ones turn towards +y. Along a ray the paper ends where the
    brightness falls below the ray's running level by 40 % of the contrast, or rises above it by 60 % (another dot, a
    dark surface), or where it has a step that a run of neighbouring rays shares (`label_steps`: a light surface), or
    where the frame ends. Slow changes of light and folds in the paper are followed.
    """
    if not dots:
        return []
    result: list[FloatArray] = []
    height, width = grey.shape
    # Medians, so that a hot pixel or a speck is no edge; square-root light in eight bits, for speed.
    smooth = cv2.medianBlur(cv2.convertScaleAbs(cv2.sqrt(np.maximum(grey, 0.0)), alpha=255.0), 5)
    angles = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for dot, ink in zip(dots, inks, strict=True):
        r = dot.semi_major_px
        # Narrow rims end within few pixels; further out the steps may be longer.
        near, step = r + NEAR_PX, max(1.0, r / 12.0)
        distances = np.concatenate((np.arange(r + FIRST_PX, near, 1.0), np.arange(near, REACH * r, step)))
        at = directions[:, None, :] * distances[None, :, None] + np.array([dot.x_px, dot.y_px])
        inside = (at[..., 0] >= 0) & (at[..., 0] <= width - 1) & (at[..., 1] >= 0) & (at[..., 1] <= height - 1)
        xs, ys = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
        roots = cv2.remap(smooth, xs, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
        ends = _first_ends((roots / 255.0) ** 2, inside, distances, ink)
        result.append(np.minimum(ends, first_steps(grey, dot, ink, directions, ends)))
    return result


def _first_ends(values: FloatArray, inside: NDArray[np.bool_], distances: FloatArray, ink: float) -> FloatArray:
    # Each ray starts from its own paper: labels are creased, and half of one may lie in shadow.
    level = np.maximum(values[:, :START_SAMPLES].max(axis=1), 1e-6)
    running, levels = level, [level]
    ends = np.full(len(values), distances[-1])
    open_rays = np.ones(len(values), dtype=bool)
    for k in range(1, len(distances)):
        value = values[:, k]
        left = (value < level - FALL * (level - ink)) | (value > level + RISE * (level - ink)) | ~inside[:, k]
        ends[open_rays & left] = distances[k - 1]  # or up to the next sample
        open_rays &= ~left
        if not open_rays.any():
            break
        running = running + FOLLOW * (value - running)
        levels.append(running)
        # The level from before a step, however much the lens blurs the step.
        level = levels[max(len(levels) - 1 - LAG, 0)]
    return ends
