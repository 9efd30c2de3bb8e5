"""Resolution of an ambiguous match by the target's neighbours.

Motion in the epipolar plane gives two cameras the same images whichever way its ends are matched. A structure, however,
moves as a whole. Two tests use the resolved targets around (of the same member, where members are known), the nearer
ones with more weight:

- *Continuity*: a mode shape is smooth along a member. One solution continues the vectors of the nearest neighbours, the
  other does not.
- *Similarity*: one solution resembles the population in direction and size, the other does not. The second moment of
  the vectors describes the population; a multivariate t distribution with as many degrees of freedom as neighbours
  keeps a few of them from a false certainty.

One test must be clear and the other must not contradict it; otherwise the target stays ambiguous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.geometry.motion import FloatArray, ObjectMotion
from labdaemon.geometry.settings import NEIGHBOURS


@dataclass(frozen=True, slots=True, eq=False)
class ResolvedNeighbour:
    """A settled target: (3,) place and (3,) vector, mm."""

    place_mm: FloatArray
    vector_mm: FloatArray


def resolve_by_neighbours(
    options: tuple[ObjectMotion, ObjectMotion], evidence: float, neighbours: Sequence[ResolvedNeighbour]
) -> int | None:
    """Pick one of two solutions.

    Parameters
    ----------
    options
        The two, at the same place.
    evidence
        Logarithm of the odds for the first from the residuals alone.
    neighbours
        Settled targets of the same member (of all members where none is known), nearest first.

    Returns
    -------
    int or None
        0 or 1; None when the witnesses do not tell.
    """
    here = options[0].mean_mm
    smooth = _continuing_solution(options, neighbours[:3], here)
    like = _similar_solution(options, evidence, neighbours, here)
    if smooth is not None and like is not None and smooth != like:
        return None
    return smooth if smooth is not None else like


def _continuing_solution(
    options: tuple[ObjectMotion, ObjectMotion], near: Sequence[ResolvedNeighbour], here: FloatArray
) -> int | None:
    """Solution that lies close to the nearest neighbours' vector while the other does not."""
    if len(near) < 2:
        return None
    vectors = np.stack([neighbour.vector_mm for neighbour in near])
    vectors = vectors * np.where(vectors @ vectors[0] >= 0, 1.0, -1.0)[:, None]
    weights = np.array([1.0 / max(float(np.linalg.norm(w.place_mm - here)), 1e-6) for w in near])
    expected = weights @ vectors / weights.sum()
    spread = float(np.linalg.norm(vectors - expected, axis=1).max())
    misses = [float(min(np.linalg.norm(o.a_mm - expected), np.linalg.norm(o.a_mm + expected))) for o in options]
    best = int(np.argmin(misses))
    return best if misses[1 - best] > NEIGHBOURS.continuity_ratio * max(misses[best], spread) else None


def _similar_solution(
    options: tuple[ObjectMotion, ObjectMotion], evidence: float, near: Sequence[ResolvedNeighbour], here: FloatArray
) -> int | None:
    """Solution that moves as the others do while the other one does not."""
    if len(near) < NEIGHBOURS.min_neighbours:
        return None
    vectors = np.stack([neighbour.vector_mm for neighbour in near])
    distances = np.array([float(np.linalg.norm(neighbour.place_mm - here)) for neighbour in near])
    weights = 1.0 / (1.0 + (distances / max(float(np.median(distances)), 1e-6)) ** 2)
    count = float(weights.sum() ** 2 / np.sum(weights**2))
    moment = np.einsum("n,ni,nj->ij", weights, vectors, vectors) / weights.sum()
    moment += NEIGHBOURS.min_spread**2 * float(np.trace(moment)) * np.eye(3)
    inverse = np.linalg.inv(moment)
    distances2 = [float(option.a_mm @ inverse @ option.a_mm) for option in options]
    odds = evidence + 0.5 * (count + 3.0) * float(np.log1p(distances2[1] / count) - np.log1p(distances2[0] / count))
    if abs(odds) < np.log(NEIGHBOURS.min_odds):
        return None
    best = 0 if odds > 0 else 1
    # A motion unlike the whole population is not chosen only because the other one is less likely still.
    return best if distances2[best] < NEIGHBOURS.max_distance2 else None
