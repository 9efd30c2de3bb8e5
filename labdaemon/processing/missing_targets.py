"""Targets that the search did not find: where their neighbours predict them, to see whether they are occluded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from labdaemon.blur import FloatArray
from labdaemon.processing.matched_filter import BlurredTarget

NEIGHBOURS = 4
"""Number of neighbours whose displacements predict that of a target between them."""
LEAST_FOUND = 4
"""Number of targets that must be found before the others are predicted."""


def predict_missing(rest_px: FloatArray, found: Sequence[BlurredTarget | None]) -> dict[int, BlurredTarget]:
    """Predict the place of each target that was not found from its neighbours; empty where too few were found.

    Parameters
    ----------
    rest_px
        (n, 2) where each would be if it had not moved.
    found
        n smears.
    """
    known = [index for index, smear in enumerate(found) if smear is not None]
    lost = [index for index, smear in enumerate(found) if smear is None]
    if len(known) < LEAST_FOUND or not lost:
        return {}
    seen = [smear for smear in found if smear is not None]
    moved = np.array([smear.centre_px for smear in seen]) - rest_px[known]
    reach = np.max([np.abs(smear.a_px) + np.abs(smear.b_px) for smear in seen], axis=0)
    _, nearest = KDTree(rest_px[known]).query(rest_px[lost], k=NEIGHBOURS)
    places = rest_px[lost] + np.median(moved[nearest], axis=1)
    return {
        index: BlurredTarget(place, reach, np.zeros(2), 0.0, 0.0) for index, place in zip(lost, places, strict=True)
    }
