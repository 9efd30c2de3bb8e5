"""An ambiguous match is resolved by the target's neighbours, or stays ambiguous."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.geometry.continuity import ResolvedNeighbour, resolve_by_neighbours
from labdaemon.geometry.motion import ObjectMotion

ALONG, ACROSS = np.array([2.0, 0.1, 0.0]), np.array([0.1, -0.2, 2.5])


def option(vector: np.ndarray) -> ObjectMotion:
    return ObjectMotion(np.zeros(3), vector, np.zeros(3), np.eye(9))


def neighbours(vector: np.ndarray, count: int, spread: float = 0.02, seed: int = 1) -> list[ResolvedNeighbour]:
    rng = np.random.default_rng(seed)
    return [
        ResolvedNeighbour(np.array([50.0 * (k + 1), 0.0, 0.0]), vector + rng.normal(0, spread, 3)) for k in range(count)
    ]


@pytest.mark.parametrize("flip", [False, True])
def test_the_solution_that_continues_the_nearest_is_taken(flip: bool) -> None:
    options = (option(ACROSS), option(ALONG)) if flip else (option(ALONG), option(ACROSS))
    assert resolve_by_neighbours(options, 0.0, neighbours(ALONG, 3)) == int(flip)


def test_signs_of_neighbours_do_not_matter() -> None:
    """Without a phase a vector and its opposite are one motion."""
    near = neighbours(ALONG, 3)
    turned = [
        ResolvedNeighbour(one.place_mm, one.vector_mm * sign) for one, sign in zip(near, (1, -1, -1), strict=True)
    ]
    assert resolve_by_neighbours((option(-ALONG), option(ACROSS)), 0.0, turned) == 0


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_neighbours_decide_nothing(count: int) -> None:
    assert resolve_by_neighbours((option(ALONG), option(ACROSS)), 0.0, neighbours(ALONG, count)) is None


def test_neighbours_that_differ_among_themselves_decide_nothing() -> None:
    near = neighbours(ALONG, 2, spread=3.0)
    assert resolve_by_neighbours((option(ALONG), option(ACROSS)), 0.0, near) is None


def test_two_solutions_that_are_alike_stay_ambiguous() -> None:
    slightly = ALONG + np.array([0.05, 0.0, 0.0])
    assert resolve_by_neighbours((option(ALONG), option(slightly)), 0.0, neighbours(ALONG, 8)) is None


def test_a_population_decides_where_the_nearest_are_too_few_to_be_clear() -> None:
    """Twelve that move along x: the solution along x is theirs, whatever its exact size."""
    near = neighbours(ALONG, 12, spread=0.3)
    assert resolve_by_neighbours((option(1.4 * ALONG), option(3.0 * ACROSS)), 0.0, near) == 0


def test_a_motion_unlike_the_whole_population_is_not_chosen() -> None:
    near = neighbours(ALONG, 12, spread=0.05)
    assert resolve_by_neighbours((option(40.0 * ACROSS), option(80.0 * ACROSS)), 0.0, near) is None
