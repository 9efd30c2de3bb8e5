"""Names for targets: by place, and the same ones in every later sharp set."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.processing.matched_filter import BlurredTarget
from labdaemon.processing.missing_targets import LEAST_FOUND, predict_missing
from labdaemon.processing.naming import keep_names, names_in_image, names_in_space

GRID_MM = np.array([[100.0 * x, 0.0, 400.0 - 100.0 * row] for row in range(3) for x in range(4)])
NAMES = tuple(f"T{number:02d}" for number in range(1, 13))


def test_targets_are_numbered_from_the_top_left() -> None:
    assert tuple(names_in_space(GRID_MM)) == NAMES
    order = np.random.default_rng(1).permutation(12)
    assert [names_in_space(GRID_MM[order])[place] for place in np.argsort(order)] == list(NAMES)


def test_the_longer_direction_is_the_one_across() -> None:
    assert tuple(names_in_space(GRID_MM[:, [1, 0, 2]])) == NAMES
    assert names_in_space(np.empty((0, 3))) == []


def test_in_an_image_down_is_larger() -> None:
    assert names_in_image(np.array([[10.0, 500.0], [900.0, 20.0], [10.0, 20.0]])) == ["T03", "T02", "T01"]


def test_a_later_set_keeps_the_names_of_its_places() -> None:
    order = np.random.default_rng(2).permutation(12)
    moved = GRID_MM[order] + np.random.default_rng(3).normal(0, 2.0, (12, 3))
    assert keep_names(moved, GRID_MM, NAMES, 20.0) == [NAMES[place] for place in order]


def test_new_targets_get_new_numbers_and_lost_ones_keep_theirs() -> None:
    more = np.concatenate([GRID_MM[2:], [[1000.0, 0.0, 0.0], [2000.0, 0.0, 0.0]]])
    assert keep_names(more, GRID_MM, NAMES, 20.0) == [*NAMES[2:], "T13", "T14"]


def test_places_that_were_not_measured_give_no_name() -> None:
    known = GRID_MM.copy()
    known[0] = np.nan
    named = keep_names(GRID_MM, known, NAMES, 20.0)
    assert named[1:] == list(NAMES[1:])
    assert named[0] == "T13"
    assert keep_names(GRID_MM[:0], known, NAMES, 20.0) == []


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(st.tuples(*[st.floats(-500, 500)] * 3), min_size=1, max_size=15), st.integers(0, 12))
def test_names_are_never_given_twice(places: Sequence[tuple[float, ...]], count: int) -> None:
    named = keep_names(np.array(places), GRID_MM[:count], NAMES[:count], 30.0)
    assert len(set(named)) == len(named) == len(places)
    assert all(named)


def smear(centre: Sequence[float], a: Sequence[float] = (3.0, 1.0)) -> BlurredTarget:
    return BlurredTarget(np.array(centre), np.array(a), np.zeros(2), 0.9, 100.0)


REST_PX = np.array([[100.0 * x, 100.0 * y] for y in range(3) for x in range(3)])
MOVED = np.array([12.0, -5.0])


def test_a_missing_target_is_looked_for_where_its_neighbours_moved() -> None:
    found: list[BlurredTarget | None] = [smear(place + MOVED) for place in REST_PX]
    found[4] = None
    predicted = predict_missing(REST_PX, found)
    assert list(predicted) == [4]
    np.testing.assert_allclose(predicted[4].centre_px, REST_PX[4] + MOVED)
    np.testing.assert_allclose(predicted[4].a_px, [3.0, 1.0])


def test_one_neighbour_that_was_mistaken_does_not_mislead() -> None:
    found: list[BlurredTarget | None] = [smear(place + MOVED) for place in REST_PX]
    found[4], found[1] = None, smear(REST_PX[1] + [300.0, 300.0])
    assert np.abs(predict_missing(REST_PX, found)[4].centre_px - REST_PX[4] - MOVED).max() < 1e-9


@pytest.mark.parametrize("count", [0, LEAST_FOUND - 1, 9])
def test_nothing_is_predicted_from_too_few_or_for_none(count: int) -> None:
    found = [smear(place) if index < count else None for index, place in enumerate(REST_PX)]
    assert predict_missing(REST_PX, found) == {}
