"""A frame's own motion by its control targets: shift, turn and defocus."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur import StaticMeasurement
from labdaemon.processing.shift import UNKNOWN, _fit

SIZE = (3872, 2592)
PLACES = np.array(
    [[300.0, 250.0], [3500.0, 300.0], [3450.0, 2300.0], [350.0, 2250.0], [1900.0, 150.0], [1950.0, 2400.0]]
)


def stills(shift: np.ndarray, *, sd: float = 0.01, defocus_px2: float = 0.1) -> list[StaticMeasurement]:
    covariance = np.diag([sd**2, sd**2, 0.02**2])
    return [
        StaticMeasurement(f"C{place}", centre, moved, defocus_px2, covariance)
        for place, (centre, moved) in enumerate(zip(PLACES, np.broadcast_to(shift, PLACES.shape), strict=True))
    ]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3e-4, 3e-4))
def test_a_shift_and_a_small_turn_are_found(x: float, y: float, turn: float) -> None:
    away = PLACES - PLACES.mean(axis=0)
    moved = np.array([x, y]) + turn * np.column_stack([-away[:, 1], away[:, 0]])
    found = _fit(stills(moved), SIZE)
    np.testing.assert_allclose(found.shift_px, [x, y], atol=0.01)
    assert found.turn_rad == pytest.approx(turn, abs=3e-6)
    np.testing.assert_allclose(found.at(PLACES), moved, atol=0.02)


def test_one_target_that_was_mistaken_does_not_move_the_frame() -> None:
    moved = np.tile([1.5, -0.5], (6, 1))
    moved[2] += [8.0, -9.0]
    found = _fit(stills(moved), SIZE)
    np.testing.assert_allclose(found.shift_px, [1.5, -0.5], atol=0.05)


def test_two_targets_say_hardly_anything_of_a_turn() -> None:
    """Noise of a twentieth of a pixel on two neighbours must not turn the whole frame."""
    near = [StaticMeasurement(f"C{k}", np.array([300.0 + 40 * k, 250.0]), np.array([0.0, 0.05 * k]), 0.1,
                              np.diag([2.5e-3, 2.5e-3, 1e-3])) for k in range(2)]  # fmt: skip
    assert abs(_fit(near, SIZE).turn_rad) < 3e-4


def test_between_pixels_the_defocus_is_less_sure() -> None:
    whole, half = (_fit(stills(np.array([x, 0.0])), SIZE).defocus for x in (2.0, 2.5))
    assert whole is not None
    assert half is not None
    assert half.sd_px2 > whole.sd_px2
    assert whole.mean_px2 == pytest.approx(0.1, abs=0.01)


def test_a_frame_without_control_targets_is_not_shifted() -> None:
    np.testing.assert_array_equal(UNKNOWN.at(PLACES), np.zeros_like(PLACES))
    assert UNKNOWN.defocus is None
