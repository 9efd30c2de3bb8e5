"""Errors and pulls of signed motions for benches."""

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.signed_error import interval_text, rms_interval, signed_error
from labdaemon.blur import Measurement

SIZE = 3.0


def measured(turn_rad: float, longer_px: float) -> Measurement:
    """A motion along x with sd 0.1 px across the phase and 0.01 px along it, turned and longer than the truth."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.kron(np.array([[c, -s], [s, c]]), np.eye(2))
    covariance = np.zeros((6, 6))
    covariance[2:, 2:] = turn @ np.diag([1e-4, 1e-4, 1e-2, 1e-4]) @ turn.T
    vector = np.array([SIZE + longer_px, 0.0])
    return Measurement("T", np.zeros(2), c * vector, s * vector, covariance, phased=True)


def test_an_error_of_the_phase_is_none_of_the_amplitude() -> None:
    found = signed_error(measured(0.05, 0.01), np.array([SIZE, 0.0, 0.0, 0.0]))
    assert found.amplitude_pull == pytest.approx(1.0)
    assert found.phase_pull == pytest.approx(1.5, rel=0.01)
    assert found.phase_rad == pytest.approx(0.05)
    assert found.sd_phase_rad == pytest.approx(0.1 / (SIZE + 0.01))
    assert found.vector_px == pytest.approx(np.hypot(0.01, 0.05 * SIZE), rel=0.01)


def test_where_the_phase_hardly_shows_the_axis_has_the_amplitude() -> None:
    found = measured(1.0, 0.3)
    axis = replace(measured(0.0, 0.02), phased=False)
    assert signed_error(replace(found, axes=axis), np.array([SIZE, 0, 0, 0])).amplitude_pull == pytest.approx(2.0)


def test_an_interval_holds_the_root_mean_square() -> None:
    values = np.random.default_rng(1).normal(size=60)
    middle, low, high = rms_interval(values)
    assert low < middle < high
    assert interval_text(values).startswith(f"{middle:5.2f} ({low:.2f}")
    assert np.isnan(rms_interval(np.zeros(0))).all()
