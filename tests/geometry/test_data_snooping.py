"""Least squares over points with their own covariances, and the search for gross errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.geometry.data_snooping import RobustPointAdjustment, exclusion_reason, squared_normalised_residuals

SHIFT = np.array([3.0, -2.0])


def shift_of(points: np.ndarray, sd_px: float = 0.1, prior: np.ndarray | None = None) -> RobustPointAdjustment:
    """A state of two numbers: the shift that all points share."""
    covariances = np.tile(sd_px**2 * np.eye(2), (len(points), 1, 1))
    jacobian = np.tile(np.eye(2), (len(points), 1, 1))
    return RobustPointAdjustment(
        lambda state: (points - state, covariances, jacobian), lambda state, step: state + step, prior
    )


@pytest.fixture
def points() -> np.ndarray:
    return SHIFT + np.random.default_rng(4).normal(0, 0.1, (20, 2))


def test_without_errors_it_is_the_mean(points: np.ndarray) -> None:
    fit = shift_of(points)
    state = fit.adjust(np.zeros(2), np.ones(20))
    np.testing.assert_allclose(state, points.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(fit.covariance(state, np.ones(20, dtype=bool)), 0.01 / 20 * np.eye(2), rtol=1e-9)


@pytest.mark.parametrize("size", [1.0, 10.0, 1000.0])
def test_gross_errors_are_found_and_change_nothing(points: np.ndarray, size: float) -> None:
    spoilt = points.copy()
    spoilt[[2, 11]] += [[size, 0.0], [0.0, -size]]
    fit = shift_of(spoilt)
    start = fit.adjust(np.median(spoilt, axis=0), np.ones(20), robust=True)
    state, used = fit.reject_outliers(start, 4)
    assert np.flatnonzero(~used).tolist() == [2, 11]
    np.testing.assert_allclose(state, np.delete(points, [2, 11], axis=0).mean(axis=0), atol=1e-9)


def test_a_point_that_fits_after_all_is_taken_back(points: np.ndarray) -> None:
    """From a start far off half of the points look wrong at first."""
    state, used = shift_of(points).reject_outliers(SHIFT + 5.0, 4)
    assert used.all()
    np.testing.assert_allclose(state, points.mean(axis=0), atol=1e-9)


def test_pixels_worse_than_stated_do_not_cost_points(points: np.ndarray) -> None:
    """Three times the stated deviation: the points are judged by their own spread."""
    _, used = shift_of(points, sd_px=0.035).reject_outliers(SHIFT, 4)
    assert used.sum() >= 19


def test_a_prior_holds_what_the_points_do_not_say(points: np.ndarray) -> None:
    loose, tight = (shift_of(points, prior=np.full(2, weight)) for weight in (1e-6, 1e9))
    np.testing.assert_allclose(loose.adjust(np.zeros(2), np.ones(20)), points.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(tight.adjust(np.zeros(2), np.ones(20)), 0.0, atol=1e-4)


def test_points_that_do_not_fix_the_state_are_refused() -> None:
    jacobian = np.tile(np.array([[1.0, 1.0], [1.0, 1.0]]), (5, 1, 1))
    fit = RobustPointAdjustment(
        lambda state: (np.zeros((5, 2)), np.tile(np.eye(2), (5, 1, 1)), jacobian), lambda state, step: state + step
    )
    with pytest.raises(DataError, match="do not fix the camera"):
        fit.covariance(np.zeros(2), np.ones(5, dtype=bool))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.lists(st.floats(-100, 100), min_size=2, max_size=2),
    st.floats(0.01, 10),
    st.floats(0.01, 10),
    st.floats(-0.9, 0.9),
)
def test_squares_are_those_of_the_whitened_residual(residual: list[float], x: float, y: float, part: float) -> None:
    covariance = np.array([[x * x, part * x * y], [part * x * y, y * y]])
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), residual)
    found = squared_normalised_residuals(np.array([residual]), covariance[None])
    np.testing.assert_allclose(found, whitened @ whitened, rtol=1e-6, atol=1e-9)


def test_a_point_that_cannot_be_seen_is_infinitely_wrong() -> None:
    squares = squared_normalised_residuals(np.array([[np.nan, 0.0], [0.0, 0.0]]), np.tile(np.eye(2), (2, 1, 1)))
    assert squares.tolist() == [np.inf, 0.0]


def test_a_reason_names_the_residual() -> None:
    assert "(+3.00, -2.00) px is 5 times" in exclusion_reason(SHIFT, 25.0)
