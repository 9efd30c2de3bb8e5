"""Displacements as nodes in time: declared waveforms, windows of part cycles, and their transfer functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import j0

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.waveform import MotionWaveform, in_phase_transfer, quadrature_transfer, window_nodes
from labdaemon.errors import UsageError

FX, FY = np.broadcast_arrays(np.linspace(0.0, 0.3, 7)[None, :], np.linspace(-0.2, 0.2, 5)[:, None])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(0.1, 5.0), st.floats(-3.0, 3.0)), min_size=1, max_size=4))
def test_a_waveform_has_zero_mean_and_unit_half_range(terms: list[tuple[float, float]]) -> None:
    wave = MotionWaveform.harmonics([a for a, _ in terms], [phase for _, phase in terms])
    assert wave.weight.sum() == pytest.approx(1.0)
    assert wave.weight @ wave.displacement == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(wave.displacement) / 2 == pytest.approx(1.0)


@pytest.mark.parametrize(("amplitudes", "phases"), [([], []), ([1.0], []), ([1.0], [0.0, 1.0]), ([0.0], [0.0])])
def test_what_is_no_motion_is_refused(amplitudes: Sequence[float], phases: Sequence[float]) -> None:
    with pytest.raises(UsageError):
        MotionWaveform.harmonics(amplitudes, phases)


@pytest.mark.parametrize("values", [[1.0] * 20, [0.0, 1.0] * 3, [[0.0, 1.0] * 8], [0.0, np.nan] * 8])
def test_a_record_without_motion_is_refused(values: list[float]) -> None:
    with pytest.raises(UsageError):
        MotionWaveform.record(values)


def test_a_record_of_a_sine_is_a_sine() -> None:
    phase = 2 * np.pi * np.arange(1000) / 1000
    record = MotionWaveform.record(37.0 + 0.02 * np.sin(phase))
    sine = MotionWaveform.harmonics([1.0], [0.0])
    for power in (2, 4, 6):
        assert record.weight @ record.displacement**power == pytest.approx(
            sine.weight @ sine.displacement**power, rel=1e-3
        )


def test_a_triangle_is_everywhere_equally_long() -> None:
    triangle = MotionWaveform.triangular()
    for power in (2, 4, 10):
        assert triangle.weight @ triangle.displacement**power == pytest.approx(1 / (power + 1))


def transfer(window: ExposureWindow, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    basis, weight = window_nodes(window, float(np.hypot(*a) + np.hypot(*b)))
    return quadrature_transfer(FX, FY, np.concatenate((a, b)), basis, weight)[0]


@settings(max_examples=20, deadline=None, derandomize=True)
@given(x=st.floats(-20, 20), y=st.floats(-20, 20), cycles=st.integers(1, 12))
def test_whole_cycles_of_a_line_are_bessels_function(x: float, y: float, cycles: int) -> None:
    """The arcsine law's transform: J0(2π f·a), whatever the phase."""
    window = ExposureWindow(float(cycles), 1.0, 0.7)
    got = transfer(window, np.array([x, y]), np.zeros(2))
    np.testing.assert_allclose(got, j0(2 * np.pi * (FX * x + FY * y)), atol=1e-7)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(cycles=st.floats(0.1, 7.0), phase=st.floats(-3.0, 3.0))
def test_nodes_integrate_any_window(cycles: float, phase: float) -> None:
    window = ExposureWindow(cycles, 1.0, phase)
    basis, weight = window_nodes(window, 10.0)
    end = phase + 2 * np.pi * cycles
    assert weight.sum() == pytest.approx(1.0)
    assert weight @ basis[0] == pytest.approx((np.cos(phase) - np.cos(end)) / (2 * np.pi * cycles), abs=1e-9)
    assert weight @ basis[1] == pytest.approx((np.sin(end) - np.sin(phase)) / (2 * np.pi * cycles), abs=1e-9)


def test_derivatives_are_those_of_the_transfer_function() -> None:
    basis, weight = window_nodes(ExposureWindow(5.4, 1.0, 0.3), 8.0)
    vectors = np.array([4.0, 1.0, -2.0, 3.0])
    _, by_vector = quadrature_transfer(FX, FY, vectors, basis, weight)
    motion = np.array([4.0, -1.0, 0.6])
    _, by_motion = in_phase_transfer(FX, FY, motion, basis, weight)
    for place in range(4):
        step = 1e-6 * np.eye(4)[place]
        above, below = (quadrature_transfer(FX, FY, vectors + sign * step, basis, weight)[0] for sign in (1, -1))
        np.testing.assert_allclose(by_vector[place], (above - below) / 2e-6, atol=1e-7)
    for place in range(3):
        step = 1e-6 * np.eye(3)[place]
        above, below = (in_phase_transfer(FX, FY, motion + sign * step, basis, weight)[0] for sign in (1, -1))
        np.testing.assert_allclose(by_motion[place], (above - below) / 2e-6, atol=1e-7)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(x=st.floats(-8, 8), y=st.floats(-8, 8), phase=st.floats(-3.0, 3.0))
def test_an_in_phase_motion_is_a_pair_of_parallel_vectors(x: float, y: float, phase: float) -> None:
    basis, weight = window_nodes(ExposureWindow(5.4, 1.0, 0.3), 12.0)
    one = in_phase_transfer(FX, FY, np.array([x, y, phase]), basis, weight)[0]
    pair = np.array([x * np.cos(phase), y * np.cos(phase), x * np.sin(phase), y * np.sin(phase)])
    np.testing.assert_allclose(one, quadrature_transfer(FX, FY, pair, basis, weight)[0], atol=1e-9)
