"""Names for targets: those of `targets.csv` where they lie as projected, else numbers by place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

FloatArray = NDArray[np.float64]


def match_names(
    projected_px: FloatArray, names: Sequence[str], found_px: FloatArray, *, within_px: float | None = None
) -> list[str]:
    """Give found targets the names of projected ones.

    Parameters
    ----------
    projected_px
        (n, 2) where the named targets should be; only approximately known.
    names
        Their n names.
    found_px
        (m, 2) where targets were found.
    within_px
        Largest distance of a match after a common shift is taken off; half the smallest distance between projected
        targets if None.

    Returns
    -------
    m names, empty for a target that matches none.

    Notes
    -----
    Pairs are chosen for the smallest sum of distances (Hungarian method), distances capped at twice `within_px`, so
    that one missing target does not move its neighbours' names. Approximate places often share one error: the median
    shift of the pairs is taken off and the choice made again.
    """
    projected, found = np.reshape(projected_px, (-1, 2)), np.reshape(found_px, (-1, 2))
    result = [""] * len(found)
    if not len(projected) or not len(found):
        return result
    if within_px is None:
        within_px = 0.5 * _smallest_distance(projected)
    shift = np.zeros(2)
    pairs: list[tuple[int, int]] = []
    for _ in range(5):
        distance = np.hypot(*(found[:, None, :] - (projected + shift)[None, :, :]).transpose(2, 0, 1))
        rows, columns = linear_sum_assignment(np.minimum(distance, 2.0 * within_px))
        pairs = [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if distance[r, c] <= within_px]
        if not pairs:
            return result
        moved = np.median([found[r] - projected[c] for r, c in pairs], axis=0)
        if np.allclose(moved, shift, atol=1e-3):
            break
        shift = moved
    for row, column in pairs:
        result[row] = names[column]
    return result


def names_by_place(across: FloatArray, up: FloatArray, *, prefix: str = "T") -> list[str]:
    """Number targets row by row from the top, left to right within a row: the same from every camera.

    Parameters
    ----------
    across, up
        (n,) coordinates in which left, right, up and down are meant: x and z in object space (mm), or x and −y in a
        single image (px).
    prefix
        Put before the numbers, which have as many digits as the last one needs, two at least.

    Returns
    -------
    n names, in the order of the input.

    Notes
    -----
    A row is a run of targets in order of height whose steps are smaller than 40 % of the median distance from a target
    to its nearest neighbour, so that a slightly sloping row stays one.
    """
    across, up = np.asarray(across, dtype=np.float64), np.asarray(up, dtype=np.float64)
    count = len(across)
    if not count:
        return []
    points = np.stack([across, up], axis=1)
    limit = 0.4 * _median_neighbour(points)
    order = np.argsort(-up, kind="stable")
    row = np.zeros(count, dtype=np.intp)
    row[order[1:]] = np.cumsum(-np.diff(up[order]) > limit)
    ranking = np.lexsort((-up, across, row))
    digits = max(2, len(str(count)))
    names = [""] * count
    for place, index in enumerate(ranking):
        names[index] = f"{prefix}{place + 1:0{digits}d}"
    return names


def _distances(points: FloatArray) -> FloatArray:
    distance = np.hypot(*(points[:, None, :] - points[None, :, :]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance)


def _smallest_distance(points: FloatArray) -> float:
    smallest = float(_distances(points).min())
    return smallest if np.isfinite(smallest) and smallest > 0.0 else 100.0


def _median_neighbour(points: FloatArray) -> float:
    nearest = float(np.median(_distances(points).min(axis=1)))
    return nearest if np.isfinite(nearest) else 1.0
