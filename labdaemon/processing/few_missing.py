"""Frames in which few targets are missing: looked for where the others say, without a search of the whole frame.

A target that is covered is found nowhere, and searching a whole frame for it takes seconds. If most targets are near
their places and move like their neighbours, the missing ones can only be where these say, or they have left their
neighbours: then a blurred dot that belongs to no target lies around, and the whole frame is searched after all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from labdaemon.blur import FloatArray
from labdaemon.imaging import GreyImage
from labdaemon.processing.matched_filter import BlurredTarget, MotionFilter, match_near

LEAST_KNOWN, KNOWN_SHARE = 6, 0.4
"""Number and share of the targets that must be found near their places."""
NEIGHBOURS = 4
"""Nearest found targets whose displacements predict that of another."""
AGREEING_SHARE = 0.85
"""Share of the found targets that must move as their neighbours say."""
AGREEMENT_RADII = 0.5
"""How near to the prediction, in radii."""
UNCLAIMED_RADII = 6.0
"""How far around a missing target an unclaimed blurred dot is looked for, in radii."""
UNCLAIMED_SCORE = 0.75
"""Correlation of the best of all filters from which it is a dot: the spots of a cluttered ground reach 0.7."""
CLAIM_RADII = 1.3
"""Radius of the disc that a found target claims at both ends and in the middle of its path, in its own radii."""

Match = Callable[[int, FloatArray, float], BlurredTarget | None]
"""Looks for a target (index) near a place within a reach, px; None where nothing plausible is seen."""


def predicted_places(
    places: FloatArray, radii: FloatArray, found: Sequence[BlurredTarget | None]
) -> dict[int, FloatArray] | None:
    """Where the neighbours say that each missing target is; None where the found ones do not settle that.

    Parameters
    ----------
    places
        (n, 2) rest positions, px.
    radii
        (n,) of the targets, px.
    found
        n blurred targets.
    """
    known = np.array([k for k, one in enumerate(found) if one is not None], dtype=np.intp)
    lost = np.array([k for k, one in enumerate(found) if one is None], dtype=np.intp)
    if len(known) < max(LEAST_KNOWN, KNOWN_SHARE * len(places)):
        return None
    moved = np.array([one.centre_px for one in found if one is not None]) - places[known]
    tree = KDTree(places[known])
    around = np.asarray(tree.query(places[known], k=NEIGHBOURS + 1)[1])
    gap = np.hypot(*(moved - np.median(moved[around[:, 1:]], axis=1)).T)
    if np.mean(gap < AGREEMENT_RADII * radii[known]) < AGREEING_SHARE:
        return None
    if _is_alone(places, known, lost):
        return None
    _, near = tree.query(places[lost], k=NEIGHBOURS)
    predicted = places[lost] + np.median(moved[near], axis=1)
    return dict(zip((int(k) for k in lost), predicted, strict=True))


def _is_alone(places: FloatArray, known: NDArray[np.intp], lost: NDArray[np.intp]) -> bool:
    """Whether some missing target has nothing but missing ones around it: a whole storey may have moved away."""
    if len(lost) <= NEIGHBOURS:
        return False
    around = np.asarray(KDTree(places).query(places[lost], k=NEIGHBOURS + 1)[1])
    return bool((~np.isin(around[:, 1:], known)).all(axis=1).any())


def find_predicted(
    predicted: dict[int, FloatArray],
    radii: FloatArray,
    found: Sequence[BlurredTarget | None],
    near: Match,
    unclaimed: Match,
) -> list[BlurredTarget | None] | None:
    """The found targets, and the missing ones that are where they are predicted; None where others are unclaimed.

    Parameters
    ----------
    predicted
        From `predicted_places`.
    radii, found
        As given there.
    near
        Looks for a target in the frame.
    unclaimed
        The same in the frame without the targets that were found.
    """
    result = list(found)
    for index, place in predicted.items():
        one = near(index, place, AGREEMENT_RADII * float(radii[index]))
        if one is not None and not _is_claimed(one, radii, result):
            result[index] = one
    still = [index for index in predicted if result[index] is None]
    if any(unclaimed(index, predicted[index], UNCLAIMED_RADII * float(radii[index])) is not None for index in still):
        return None
    return result


def _is_claimed(one: BlurredTarget, radii: FloatArray, found: Sequence[BlurredTarget | None]) -> bool:
    return any(
        other is not None and float(np.hypot(*(other.centre_px - one.centre_px))) < radii[index]
        for index, other in enumerate(found)
    )


def without_found(
    window: GreyImage,
    origin: tuple[int, int],
    scale: int,
    radii: FloatArray,
    found: Sequence[BlurredTarget | None],
) -> GreyImage:
    """A window of the reduced image with paper in place of the targets that were found.

    Parameters
    ----------
    window
        (h, w) part of the image.
    origin
        Its first column and row.
    scale
        Full pixels a reduced one.
    """
    if not window.size:
        return window
    result = window.copy()
    paper = np.float32(np.percentile(window, 90))
    x, y = np.arange(window.shape[1]) + origin[0], (np.arange(window.shape[0]) + origin[1])[:, None]
    for index, one in enumerate(found):
        if one is None:
            continue
        centre = (one.centre_px - (scale - 1) / 2) / scale
        reach = float(np.hypot(*one.a_px) + np.hypot(*one.b_px)) / scale + 3 * radii[index] / scale
        if not (x[0] - reach < centre[0] < x[-1] + reach and y[0, 0] - reach < centre[1] < y[-1, 0] + reach):
            continue
        for phase in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
            px, py = centre + (np.sin(phase) * one.a_px + np.cos(phase) * one.b_px) / scale
            result[np.hypot(x - px, y - py) < CLAIM_RADII * radii[index] / scale] = paper
    return result


def match_unclaimed(
    window: GreyImage,
    origin: tuple[int, int],
    scale: int,
    place_px: FloatArray,
    reach_px: float,
    shapes: tuple[MotionFilter, ...],
) -> BlurredTarget | None:
    """`match_near` in a window that begins at `origin` of the reduced image."""
    shift = scale * np.array(origin, dtype=np.float64)
    one = match_near(window, scale, place_px - shift, reach_px, shapes)
    if one is None:
        return None
    return BlurredTarget(one.centre_px + shift, one.a_px, one.b_px, one.score, one.contrast)
