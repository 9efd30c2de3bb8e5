"""Targets that the search did not find: where they should be, to see whether something hangs in front of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.processing.smears import Smear

NEIGHBOURS = 4
"""Targets whose displacements tell that of one between them."""
LEAST_FOUND = 4
"""Targets that must have been found for the others' places to be known."""


def expected_smears(rest_px: FloatArray, found: Sequence[Smear | None]) -> dict[int, Smear]:
    """What to look at for the targets that were not found, by their neighbours; empty where too few were found.

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
    return {index: Smear(place, reach, np.zeros(2), 0.0, 0.0) for index, place in zip(lost, places, strict=True)}
