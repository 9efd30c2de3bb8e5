"""Names for targets: as `targets.csv` says, else by place, and the same ones in every later sharp set."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from labdaemon.blur import FloatArray
from labdaemon.imaging import match_names, names_by_place
from labdaemon.processing.correspond import DetectedDots


def names_in_image(centres_px: FloatArray) -> list[str]:
    """Name (n, 2) dots of an image by their place in it, in reading order."""
    return names_by_place(centres_px[:, 0], -centres_px[:, 1])


def names_in_space(places_mm: FloatArray) -> list[str]:
    """Name (n, 3) targets by their place in object space: from the top (Z is up), along the longer of X and Y."""
    spread = np.ptp(places_mm, axis=0) if len(places_mm) else np.zeros(3)
    return names_by_place(places_mm[:, 0] if spread[0] >= spread[1] else places_mm[:, 1], places_mm[:, 2])


def keep_names(places_mm: FloatArray, known_mm: FloatArray, known: tuple[str, ...], reach_mm: float) -> list[str]:
    """Name (n, 3) targets as those of an earlier set, (m, 3), at the same places; new numbers for new targets.

    Places match one to one, at most `reach_mm` apart, so that the total distance is least.
    """
    names = [""] * len(places_mm)
    there = np.flatnonzero(np.isfinite(known_mm).all(axis=1))
    if len(places_mm) and there.size:
        distance = cdist(places_mm, known_mm[there])
        rows, columns = linear_sum_assignment(np.minimum(distance, 2 * reach_mm))
        for row, column in zip(rows, columns, strict=True):
            if distance[row, column] <= reach_mm:
                names[row] = known[there[column]]
    taken, number = set(known), 0
    for index, name in enumerate(names):
        if not name:
            number += 1
            while f"T{number:02d}" in taken:
                number += 1
            names[index] = f"T{number:02d}"
    return names


def other_names(names: list[str], taken: set[str]) -> list[str]:
    """The names, with new numbers in place of those that are taken (by control targets)."""
    result, number = list(names), 0
    used = set(names) | taken
    for index, name in enumerate(names):
        if name in taken:
            while f"T{number:02d}" in used:
                number += 1
            result[index] = f"T{number:02d}"
            used.add(result[index])
    return result


def match_places(camera: DetectedDots, places_mm: FloatArray) -> NDArray[np.intp]:
    """Match a camera's dots to approximate places.

    Parameters
    ----------
    camera
        What it sees.
    places_mm
        (m, 3) approximate places.

    Returns
    -------
    array
        (m,) index of each place's dot, −1 where there is none near.
    """
    result = np.full(len(places_mm), -1)
    expected = camera.view.project(places_mm)
    visible = np.flatnonzero(np.isfinite(expected).all(axis=1))
    visible = visible[camera.view.lens.contains(expected[visible])]
    names = match_names(expected[visible], [str(place) for place in visible], camera.centres_px)
    for dot, name in enumerate(names):
        if name:
            result[int(name)] = dot
    return result
