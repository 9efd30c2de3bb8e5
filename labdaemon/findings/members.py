"""Members and levels of a structure, from where its targets are: columns of targets, and targets of equal height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labdaemon.findings.response import FloatArray

SAME_COLUMN_MM = 30.0
"""Targets whose horizontal distance is smaller stand on one column."""
SAME_LEVEL_MM = 15.0
SAME_HEIGHT_MM = 1.0
"""Targets of one column that are not this much above each other are one point of it."""


def members(positions_mm: FloatArray, least: int = 3) -> list[NDArray[np.intp]]:
    """Indices of the targets of each upright member, from the lowest up; none with fewer than `least` targets.

    Of targets next to each other at one height the first counts. Targets whose place is not known belong to no member.
    """
    left = [int(index) for index in np.flatnonzero(np.isfinite(positions_mm).all(axis=1))]
    found: list[NDArray[np.intp]] = []
    while left:
        first = left[0]
        away = np.linalg.norm(positions_mm[left][:, :2] - positions_mm[first, :2], axis=1)
        near = [index for index, distance in zip(left, away, strict=True) if distance < SAME_COLUMN_MM]
        left = [index for index in left if index not in near]
        column: list[int] = []
        for index in sorted(near, key=lambda index: positions_mm[index, 2]):
            if not column or positions_mm[index, 2] - positions_mm[column[-1], 2] >= SAME_HEIGHT_MM:
                column.append(index)
        if len(column) >= least:
            found.append(np.array(column, dtype=np.intp))
    return found


def levels(positions_mm: FloatArray) -> FloatArray:
    """Distinct heights of the targets, ascending, mm."""
    heights = np.sort(positions_mm[:, 2])
    cuts = np.flatnonzero(np.diff(heights) > SAME_LEVEL_MM) + 1
    return np.array([part.mean() for part in np.split(heights, cuts)])


def targets_of_levels(positions_mm: FloatArray, level_mm: FloatArray) -> list[NDArray[np.intp]]:
    """Indices of the targets that are nearest to each level."""
    nearest = np.argmin(np.abs(positions_mm[:, 2][:, None] - level_mm[None, :]), axis=1)
    return [np.flatnonzero(nearest == index) for index in range(len(level_mm))]
