"""Names for targets that nobody named: by place, row by row as one reads, the same in every camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from labdaemon.blur.pixels import FloatArray


def reading_order(across: FloatArray, down: FloatArray) -> NDArray[np.intp]:
    """Order points by rows from the top, each row from the left.

    Parameters
    ----------
    across, down
        (n,) coordinates along and across the rows, in the same unit. A row ends where the next point lies lower by
        more than half of the typical distance between neighbours.

    Returns
    -------
    array
        (n,) indices into the points.
    """
    count = len(across)
    if count < 2:
        return np.arange(count)
    points = np.column_stack([across, down])
    spacing = float(np.median(KDTree(points).query(points, k=2)[0][:, 1]))
    from_top = np.argsort(down, kind="stable")
    row = np.concatenate([[0], np.cumsum(np.diff(down[from_top]) > 0.5 * spacing)])
    return from_top[np.lexsort((across[from_top], row))]


def numbered(count: int) -> list[str]:
    """T01, T02 … with as many digits as it takes, two at least."""
    digits = max(2, len(str(count)))
    return [f"T{number:0{digits}d}" for number in range(1, count + 1)]


def names_in_picture(centres_px: FloatArray) -> list[str]:
    """Name (n, 2) dots of a picture by their place in it."""
    return _named(reading_order(centres_px[:, 0], centres_px[:, 1])) if len(centres_px) else []


def names_in_space(places_mm: FloatArray) -> list[str]:
    """Name (n, 3) targets by their place in object space: from the top (Z is up), along the longer of X and Y."""
    if not len(places_mm):
        return []
    spread = np.ptp(places_mm, axis=0)
    along = places_mm[:, 0] if spread[0] >= spread[1] else places_mm[:, 1]
    return _named(reading_order(along, -places_mm[:, 2]))


def _named(order: NDArray[np.intp]) -> list[str]:
    names = [""] * len(order)
    for name, index in zip(numbered(len(order)), order, strict=True):
        names[index] = name
    return names


def match_places(places: FloatArray, known: FloatArray, reach: float) -> NDArray[np.intp]:
    """Match points one to one to known places so that the total distance is least.

    Parameters
    ----------
    places, known
        (n, d) and (m, d), same unit.
    reach
        Largest distance of a match.

    Returns
    -------
    array
        (n,) index into `known`, −1 where none is within reach.
    """
    result = np.full(len(places), -1)
    if not len(places) or not len(known):
        return result
    distance = cdist(places, known)
    rows, columns = linear_sum_assignment(np.minimum(distance, 2 * reach))
    good = distance[rows, columns] <= reach
    result[rows[good]] = columns[good]
    return result
