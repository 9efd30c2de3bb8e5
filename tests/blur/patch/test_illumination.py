"""The light on a patch: found linearly, and its derivatives those of the values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.illumination import (
    illumination_derivatives,
    paper_level,
    render_illumination,
    ridge_matrix,
    solve_illumination,
)

SHAPE = (2, 12, 15)


def planes(values: np.ndarray) -> ColourPlanes:
    return ColourPlanes(values, np.ones(values.shape, dtype=bool), np.array([0, 1]), np.zeros((2, 2)), 1, (0, 0))


def darkness(seed: int = 1) -> np.ndarray:
    y, x = np.mgrid[: SHAPE[1], : SHAPE[2]]
    one = np.exp(-((x - 7.0) ** 2 + (y - 5.5) ** 2) / 12.0)
    return np.stack([one, 0.9 * one]) + np.random.default_rng(seed).uniform(0, 0.01, SHAPE)


LIGHT = st.tuples(st.floats(200, 3000), st.floats(-80, 80), st.floats(-80, 80), st.floats(0.3, 1.0))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(LIGHT, LIGHT)
def test_the_light_is_found_from_what_it_made(first: tuple[float, ...], second: tuple[float, ...]) -> None:
    """w0, w1, w2 of each channel exactly; the contrast too, as far as the gradient is small against the white."""
    light, dark = np.array([first, second]), darkness()
    flat = light.copy()
    flat[:, 1:3] = 0.0
    values = render_illumination(planes(np.zeros(SHAPE)), flat, dark)
    np.testing.assert_allclose(solve_illumination(planes(values), np.ones(SHAPE), dark), flat, rtol=1e-5, atol=1e-3)
    bare = paper_level(planes(np.zeros(SHAPE)), light)
    found = solve_illumination(planes(bare), np.ones(SHAPE), dark)
    np.testing.assert_allclose(found[:, :3], light[:, :3], rtol=1e-5, atol=1e-2)


def test_derivatives_are_those_of_the_values() -> None:
    light, dark = np.array([[1500.0, 40.0, -25.0, 0.9], [900.0, 10.0, 5.0, 0.7]]), darkness()
    by_p = np.random.default_rng(2).normal(size=(3, *SHAPE))
    empty = planes(np.zeros(SHAPE))
    columns = illumination_derivatives(empty, light, dark, by_p)
    for index in range(3):
        above, below = (render_illumination(empty, light, dark + h * by_p[index]) for h in (1e-5, -1e-5))
        np.testing.assert_allclose(columns[:, index], (above - below) / 2e-5, rtol=1e-6, atol=1e-4)
    for index in range(4):
        change = np.zeros((2, 4))
        change[:, index] = 1e-4
        above, below = (render_illumination(empty, light + sign * change, dark) for sign in (1, -1))
        np.testing.assert_allclose(columns[:, 3 + index], (above - below) / 2e-4, rtol=1e-6, atol=1e-4)


def test_a_residual_comes_as_the_last_column() -> None:
    light, dark, residual = np.array([[1500.0, 0, 0, 0.9], [900.0, 0, 0, 0.7]]), darkness(), darkness(7)
    columns = illumination_derivatives(planes(np.zeros(SHAPE)), light, dark, np.zeros((2, *SHAPE)), residual)
    assert columns.shape[1] == 2 + 4 + 1
    np.testing.assert_array_equal(columns[:, -1], residual)


def test_a_plane_without_a_valid_pixel_does_no_harm() -> None:
    weight = np.ones(SHAPE)
    weight[1] = 0.0
    found = solve_illumination(planes(np.full(SHAPE, 800.0)), weight, darkness())
    assert np.isfinite(found).all()
    assert found[0, 0] == pytest.approx(800.0, rel=1e-6)
    np.testing.assert_array_equal(ridge_matrix(np.zeros((1, 3, 3)), 1e-9)[0], np.eye(3))
