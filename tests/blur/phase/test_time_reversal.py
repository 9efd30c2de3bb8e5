"""Motions run backwards leave the same smear."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.phase.signs import PhaseLikelihood, combine_likelihoods, decide_sign
from labdaemon.blur.phase.time_reversal import differ, reverse_time, wrap_angle
from labdaemon.blur.settings import SIGNS
from labdaemon.blur.waveform import quadrature_transfer, window_nodes

NUMBERS = st.floats(-6.0, 6.0)
PAIR = st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
FX, FY = np.broadcast_arrays(np.linspace(0.0, 0.3, 6)[None, :], np.linspace(-0.2, 0.2, 5)[:, None])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(PAIR, st.floats(-3.0, 3.0), st.floats(0.2, 7.0))
def test_the_reversed_motion_has_the_same_transfer_function(
    numbers: tuple[float, ...], opening: float, cycles: float
) -> None:
    a, b = np.array(numbers[:2]), np.array(numbers[2:])
    reversed_a, reversed_b = reverse_time(a, b, opening + np.pi * cycles)
    basis, weight = window_nodes(ExposureWindow(cycles, 1.0, opening), 20.0)
    one, other = (
        quadrature_transfer(FX, FY, np.concatenate(pair), basis, weight)[0]
        for pair in ((a, b), (reversed_a, reversed_b))
    )
    np.testing.assert_allclose(one, other, atol=1e-6)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(PAIR, st.floats(-3.0, 3.0))
def test_twice_backwards_is_forwards_and_the_size_stays(numbers: tuple[float, ...], middle: float) -> None:
    a, b = np.array(numbers[:2]), np.array(numbers[2:])
    there = reverse_time(a, b, middle)
    for got, expected in zip(reverse_time(*there, middle), (a, b), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-9)
    assert np.sum(np.square(there)) == pytest.approx(np.sum(np.square([a, b])), abs=1e-9)


def test_a_motion_at_its_turning_point_is_its_own_reversal() -> None:
    a, b = np.array([0.0, 0.0]), np.array([3.0, 1.0])
    assert not differ(a, b, *reverse_time(a, b, 0.0))
    assert differ(a, b, *reverse_time(a, b, 0.7))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(-100.0, 100.0))
def test_angles_are_wrapped_to_half_a_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped <= np.pi
    assert np.cos(wrapped - angle) == pytest.approx(1.0)


GRID = np.radians(np.linspace(-90, 90, 361))


def likelihood(mu_deg: float, sd_deg: float = 5.0, *, is_orbit: bool = False) -> PhaseLikelihood:
    """A target whose phase at the middle of the exposure shows well."""
    cost = ((np.degrees(GRID) - mu_deg) / sd_deg) ** 2
    return PhaseLikelihood(np.array([2.0, 1.0]), cost - cost.min(), is_orbit)


WINDOW = ExposureWindow(5.5, 1.0, 0.2)


def test_targets_of_one_phase_get_signs_against_each_other() -> None:
    found = combine_likelihoods([likelihood(60), likelihood(-60), likelihood(61), likelihood(59)], WINDOW)
    assert found.sign.tolist() == [1, -1, 1, 1]
    np.testing.assert_allclose(found.vector_px[1], [-2.0, -1.0])
    assert np.degrees(found.mid_exposure_phase_rad) == pytest.approx(60, abs=4)
    assert len(found.phase_rad) == 2


def test_a_target_at_another_phase_and_an_orbit_get_none() -> None:
    group = [
        likelihood(60),
        likelihood(61),
        likelihood(-59),
        likelihood(60),
        likelihood(10),
        likelihood(60, is_orbit=True),
    ]
    found = combine_likelihoods([*group, None], WINDOW)
    assert found.sign.tolist()[:4] == [1, 1, -1, 1]
    assert found.sign.tolist()[4:] == [0, 0, 0]
    assert np.isnan(found.vector_px[6]).all()


def test_targets_without_a_common_phase_get_none() -> None:
    found = combine_likelihoods([likelihood(mu) for mu in (5, 30, 55, 80)], WINDOW)
    assert not found.sign.any()
    assert combine_likelihoods([], WINDOW).sign.shape == (0,)


def test_without_the_opening_phase_the_excitations_phase_stays_unknown() -> None:
    found = combine_likelihoods([likelihood(60), likelihood(61), likelihood(-60)], ExposureWindow(5.5, 1.0))
    assert found.phase_rad == ()
    assert found.sign.any()


@pytest.mark.parametrize(("part", "sign"), [(0.99, 0), (-0.99, 0), (1.01, 1), (-1.01, -1), (0.0, 0)])
def test_a_sign_needs_evidence(part: float, sign: int) -> None:
    assert decide_sign(part * SIGNS.log_odds_limit) == sign
