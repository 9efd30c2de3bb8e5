"""How probable a mean position is by the place of rest."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.rest_place import DRIFTING_SHARE, RestPlace

REST = RestPlace(np.array([10.0, 20.0]), np.array([1e-4, 4e-4]))
KNOWN = np.diag([3e-4, 0.0])


def test_near_rest_it_is_the_squared_distance_in_standard_deviations() -> None:
    away = np.array([0.02, 0.02])
    expected = 0.02**2 / 4e-4 + 0.02**2 / 4e-4
    assert REST.excess(REST.place_px + away, KNOWN) == pytest.approx(expected, abs=1e-3)
    assert REST.excess(REST.place_px, KNOWN) == pytest.approx(0.0, abs=1e-6)


def test_far_from_rest_it_is_no_more_than_a_target_that_drifts_alone() -> None:
    most = -2 * np.log(DRIFTING_SHARE)
    assert REST.excess(REST.place_px + 5.0, KNOWN) == pytest.approx(most, rel=1e-6)
    assert REST.excess(REST.place_px + 50.0, KNOWN) <= most


def test_a_mean_position_that_is_hardly_known_contradicts_nothing() -> None:
    away = np.array([0.3, -0.3])
    assert REST.excess(REST.place_px + away, np.eye(2)) < 0.3
    assert REST.excess(REST.place_px + away, KNOWN) > 9.0
