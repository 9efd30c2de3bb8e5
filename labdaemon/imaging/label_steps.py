"""The end of a label on a surface that is nearly as light: a step that neighbouring rays share.

A step is the difference of the mean brightness of two short pieces of a ray, on either side of a gap that the lens
blur fills. One ray alone may cross a speck, and a fold or a shadow is a step too. So a small step counts only where
the steps close around the dot, and a larger one where a run of rays has it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import Ellipse
from labdaemon.imaging.frame import Grey

FloatArray = NDArray[np.float64]

REACH = 8.0
"""How far steps are searched, in radii of the dot: paths of three radii."""
FIRST_PX, PLATEAU_PX, PLATEAU = 2.0, 6.0, 0.01
"""Where paper may begin beyond the dot, within how many px it does, and how near to its level in parts of the contrast.
"""
GAP_PX, PIECE_PX = 1.5, 2.0
"""Half of the gap, and length of the pieces on either side: a lens blurs an edge over some 3 px."""
CLOSED_STEP, CLOSED_SHARE = 0.02, 0.6
"""Step, in parts of the contrast to the ink, that counts where such a share of the rays has one. Trial."""
OPEN_STEP, OPEN_RUN = 0.1, 7
"""Step that counts where so many neighbouring rays have it (35°): the end of a wide sheet. Trial."""
PASSED = 2.0
"""Distance, over that of the neighbouring rays, from which a ray with a nearer step has missed the end. Trial."""
NARROW_PX = 2.0
"""Steps so close to the first place that can have one may belong to the end of a narrow rim."""
NOISES = 7.0
"""Steps are larger than so many standard deviations of the differences on plain paper. Statistics."""
SHARPNESS = 0.6
"""Part of the change over twice the distance that the step itself makes up; a slope has half of it. Trial."""


def first_steps(grey: Grey, dot: Ellipse, ink: float, directions: FloatArray, limits: FloatArray) -> FloatArray:
    """Distance of the first step along each ray, px; infinite where there is none before the limit.

    Parameters
    ----------
    grey
        (h, w), linear.
    dot, ink
        The dot, and the brightness of its ink.
    directions
        (n, 2) unit vectors, evenly around the dot.
    limits
        (n,) where each ray ends anyway, px.
    """
    r = dot.semi_major_px
    nothing = np.full(len(directions), np.inf)
    seen = limits < REACH * r  # rays that end at a dark surface, a large change of light, or with the frame
    distances = np.arange(r + FIRST_PX, min(REACH * r, float(limits.max()) + 2 * GAP_PX + PIECE_PX), 0.5)
    passed = limits > PASSED * _lower_neighbours(limits)  # perhaps past a narrow rim, to something further out
    if (not passed.any() and seen.all()) or len(distances) < 8 * (GAP_PX + PIECE_PX):
        return nothing
    values = _sample(grey, dot, directions, distances)
    profile = np.median(values[:, : int(2 * PLATEAU_PX)], axis=0)
    contrast = float(profile.max()) - ink
    if contrast <= 0:
        return nothing
    begin = int(np.argmax(profile > profile.max() - PLATEAU * contrast))  # where the blurred edge of the dot ends
    values, distances = values[:, begin:], distances[begin:]
    steps, sharp = _steps(values)
    places = distances[: steps.shape[1]] + GAP_PX + PIECE_PX
    before = places[None, :] < limits[:, None] + GAP_PX
    size = np.where(before & sharp, np.abs(steps), 0.0)
    noise = 1.48 * float(np.min(np.median(np.abs(steps), axis=0)))  # at the distance where there is paper all around
    closed = _first(size, places, max(CLOSED_STEP * contrast, NOISES * noise))
    closed = _within_narrow_rims(closed, values, distances)
    if float(np.mean(seen)) >= CLOSED_SHARE:
        # A label that ends all around has folds, which are no ends.
        rim = passed & (closed < PASSED * _lower_neighbours(limits))
        closed = np.where(seen & ~rim, np.inf, closed)
        ended = (seen & ~rim) | (np.isfinite(closed) & ~rim)
        return _bridge(np.minimum(closed, limits), ended)
    ended = seen | np.isfinite(closed)
    if float(np.mean(ended)) >= CLOSED_SHARE:
        return _bridge(np.minimum(closed, limits), ended)
    opened = _first(size, places, max(OPEN_STEP * contrast, NOISES * noise))
    return np.where(_in_runs(np.isfinite(opened)), opened, np.inf)


def _sample(grey: Grey, dot: Ellipse, directions: FloatArray, distances: FloatArray) -> FloatArray:
    """(n, k) brightness along the rays, smoothed over three pixels; the nearest pixel where the frame ends."""
    reach = int(distances[-1]) + 4
    x0, y0 = max(int(dot.x_px) - reach, 0), max(int(dot.y_px) - reach, 0)
    part = np.ascontiguousarray(grey[y0 : int(dot.y_px) + reach + 1, x0 : int(dot.x_px) + reach + 1], dtype=np.float32)
    smooth = cv2.blur(cv2.medianBlur(part, 3), (3, 3))
    at = directions[:, None, :] * distances[None, :, None] + np.array([dot.x_px - x0, dot.y_px - y0])
    xs, ys = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
    sampled = cv2.remap(smooth, xs, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float64)


def _steps(values: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Change across each place of the rays, and whether it is a step: not the part of a slope, and largest there."""
    gap, piece = int(4 * GAP_PX), int(2 * PIECE_PX)
    total = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    means = (total[:, piece:] - total[:, :-piece]) / piece
    steps = means[:, piece + gap :] - means[:, : -(piece + gap)]
    size = np.abs(steps)
    side = piece
    padded = np.pad(size, ((0, 0), (side, side)), mode="edge")
    around = np.max([padded[:, k : k + size.shape[1]] for k in range(2 * side + 1)], axis=0)
    signed = np.pad(steps, ((0, 0), (piece + gap, piece + gap)))
    count = steps.shape[1]
    # On a slope the same change is found next to the place on both sides; on a step there is little.
    beyond = np.minimum(np.abs(signed[:, :count]), np.abs(signed[:, -count:]))
    return steps, (size >= around) & (beyond < SHARPNESS * size)


def _lower_neighbours(ends: FloatArray) -> FloatArray:
    """(n,) lower quartile of the ends of the rays within 45°."""
    reach = len(ends) // 8
    around = np.stack([np.roll(ends, k) for k in range(-reach, reach + 1)])
    return np.asarray(np.quantile(around, 0.25, axis=0), dtype=np.float64)


def _first(size: FloatArray, places: FloatArray, least: float) -> FloatArray:
    """(n,) the first place along each ray where a step reaches `least`; infinite where none does."""
    large = size > least
    return np.where(large.any(axis=1), places[np.argmax(large, axis=1)], np.inf)


def _within_narrow_rims(ends: FloatArray, values: FloatArray, distances: FloatArray) -> FloatArray:
    """Ends nearer to the dot than the pieces of a step are long: where half of the change lies, before the step found.

    A rim of 4 px is shorter than gap and piece together, so that its end shows as a step at the first place there is.
    Towards a lighter ground the brightness rises all the way from the ink, and nothing shows where the rim ends: it
    counts as ending where the dot's own blur does.
    """
    first = distances[0] + GAP_PX + PIECE_PX
    result = ends.copy()
    for ray in np.flatnonzero(ends < first + NARROW_PX):
        line = values[ray]
        behind = (distances > ends[ray] + GAP_PX) & (distances <= ends[ray] + GAP_PX + PIECE_PX)
        ground, lightest = float(line[behind].mean()), int(np.argmax(line[distances <= ends[ray]]))
        below = np.flatnonzero(line[lightest:] < (line[lightest] + ground) / 2)
        darker = ground < line[lightest] and below.size
        result[ray] = min(ends[ray], distances[lightest + below[0]] if darker else distances[0])
    return result


def _bridge(ends: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Ends on rays without a step, where the ground is by coincidence as light as the paper: on the chord.

    In polar coordinates the inverse distance of a straight line is almost linear over a small angle.
    """
    count = len(ends)
    at = np.flatnonzero(known)
    around = np.concatenate((at - count, at, at + count))
    inverse = np.tile(1 / ends[at], 3)
    result: FloatArray = 1 / np.interp(np.arange(count), around, inverse)
    return result


def _in_runs(present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which rays belong to a run of neighbours that is long enough."""
    count = len(present)
    starts = [all(present[(k + j) % count] for j in range(OPEN_RUN)) for k in range(count)]
    result = np.zeros(count, dtype=bool)
    for k in np.flatnonzero(starts):
        result[(k + np.arange(OPEN_RUN)) % count] = True
    return result
