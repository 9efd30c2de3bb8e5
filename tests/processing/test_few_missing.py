"""Few missing targets: predicted by their neighbours, and never at the price of a structure that moved away."""

import numpy as np
import pytest

from labdaemon.processing.few_missing import (
    find_predicted,
    match_unclaimed,
    predicted_places,
    without_found,
)
from labdaemon.processing.matched_filter import BlurredTarget, motion_filters

PLACES = np.array([(100.0 + 80 * i, 100.0 + 70 * j) for j in range(5) for i in range(6)])
RADII = np.full(len(PLACES), 12.0)


def seen(place, a=(6.0, 2.0)) -> BlurredTarget:
    return BlurredTarget(np.asarray(place, dtype=float), np.asarray(a), np.zeros(2), 0.95, 0.9)


def field(shift=(3.0, -2.0), lost=()):
    return [None if k in lost else seen(place + shift) for k, place in enumerate(PLACES)]


@pytest.mark.parametrize("lost", [(7,), (0, 5, 29), (2, 9, 13, 18, 22)])
def test_the_neighbours_say_where_a_missing_target_is(lost):
    predicted = predicted_places(PLACES, RADII, field(lost=lost))
    assert predicted is not None
    assert sorted(predicted) == sorted(lost)
    for k in lost:
        assert predicted[k] == pytest.approx(PLACES[k] + (3.0, -2.0))


def test_a_turned_frame_is_followed():
    turn = 0.03
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = (PLACES - 250) @ matrix.T + 250
    found = [None if k == 14 else seen(place) for k, place in enumerate(moved)]
    predicted = predicted_places(PLACES, RADII, found)
    assert predicted is not None
    assert np.hypot(*(predicted[14] - moved[14])) < 1.0


def test_a_storey_that_moved_away_needs_the_whole_frame():
    assert predicted_places(PLACES, RADII, field(lost=range(6, 24))) is None


def test_too_few_known_or_disagreeing_targets_settle_nothing():
    assert predicted_places(PLACES, RADII, field(lost=range(5, 30))) is None
    rng = np.random.default_rng(1)
    found = [None if k == 3 else seen(place + rng.uniform(-17, 17, 2)) for k, place in enumerate(PLACES)]
    assert predicted_places(PLACES, RADII, found) is None


def test_what_is_found_where_predicted_is_taken_and_no_dot_twice():
    found = field(lost=(7, 8))
    predicted = predicted_places(PLACES, RADII, found)

    def near(index, place, reach):
        # Target 8 is covered; what is seen there is its neighbour.
        return seen(place) if index == 7 else found[9]

    result = find_predicted(predicted, RADII, found, near, lambda *_: None)
    assert result is not None
    assert result[7] is not None
    assert result[8] is None


def test_an_unclaimed_dot_nearby_asks_for_the_whole_frame():
    found = field(lost=(7,))
    predicted = predicted_places(PLACES, RADII, found)
    assert find_predicted(predicted, RADII, found, lambda *_: None, lambda _, place, __: seen(place + 50)) is None


@pytest.mark.parametrize("claimed", [True, False])
def test_found_targets_are_no_unclaimed_ones(claimed):
    scale, radius = 2, 8.0
    (shape, *_) = shapes = motion_filters(radius / scale, radius / scale, 0.0)[:29]
    window = np.full((60, 70), 0.9, np.float32)
    half_h, half_w = (n // 2 for n in shape.template.shape)
    window[30 - half_h : 31 + half_h, 40 - half_w : 41 + half_w] -= 0.8 * shape.template
    place = np.array([(40 + 15) * scale + 0.5, (30 + 5) * scale + 0.5])
    found = [seen(place, (0.5, 0.0))] if claimed else [None]
    clean = without_found(window, (15, 5), scale, np.array([radius]), found)
    one = match_unclaimed(clean, (15, 5), scale, place + 6, 20.0, shapes)
    assert (one is not None and one.score > 0.6 and one.contrast > 0.3) is not claimed
    if not claimed:
        assert np.hypot(*(one.centre_px - place)) < 2.0
