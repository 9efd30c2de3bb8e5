"""An in-phase motion summed over all its phases."""

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur.phase.in_phase import PhaseProfile
from labdaemon.blur.phase.posterior import in_phase_jacobian, in_phase_vectors, is_bimodal, marginalise_phase
from labdaemon.blur.solver.reduced_equations import Solution

PHASES = 2 * np.pi * np.arange(16) / 16
VECTOR = np.array([1.2, 0.3])
LINEAR = np.diag([1e-4, 1e-4, 4e-4, 4e-4, 0.25])


def solution(phase_rad: float) -> Solution:
    p, nothing = np.array([5.0, 6.0, *VECTOR, phase_rad]), np.zeros((1, 1, 1))
    return Solution(
        p=p,
        covariance=LINEAR,
        light=nothing,
        residual=nothing,
        signal=nothing,
        cost=100.0,
        dof=100,
        converged=True,
        weight=nothing,
        prior_covariance=np.zeros((5, 5)),
        light_jacobian=nothing,
        whitened_jacobian=nothing,
    )


def profile(cost: np.ndarray, phase_rad: float) -> PhaseProfile:
    vectors, places = np.tile(VECTOR, (16, 1)), np.tile([5.0, 6.0], (16, 1))
    return PhaseProfile(PHASES, cost, vectors, places, solution(phase_rad), (), periodic=True)


def summed(cost: np.ndarray, phase_rad: float) -> tuple[float, float, np.ndarray]:
    """Reported phase, its standard deviation by the covariance on the circle, and the axis' covariance."""
    one = profile(cost, phase_rad)
    found = marginalise_phase(one, one.best.p, LINEAR, one.best.p, 1.0)
    a, b = found.value[2:4] @ VECTOR, found.value[4:] @ VECTOR
    spread = float(np.trace(found.covariance[2:, 2:]) - np.trace(found.axis_covariance[2:, 2:]))
    assert np.hypot(a, b) == pytest.approx(VECTOR @ VECTOR)
    return float(np.arctan2(b, a)), float(np.sqrt(spread / (VECTOR @ VECTOR))), found.axis_covariance


def test_a_skewed_valley_is_reported_by_its_mean() -> None:
    away = np.angle(np.exp(1j * (PHASES - 2.0)))
    cost = np.where(away > 0, (away / 1.0) ** 2, (away / 0.3) ** 2)
    phase, spread, axis = summed(cost, 2.0)
    assert 2.1 < phase < 2.9
    assert 0.3 < spread < 1.0
    # What the phase leaves open is none of the amplitude's.
    assert np.allclose(np.diag(axis)[2:], 4e-4, rtol=0.05)


def test_a_symmetric_valley_keeps_its_phase_and_no_phase_at_all_is_the_whole_circle() -> None:
    phase, spread, _ = summed(8 * (1 - np.cos(PHASES - 1.0)), 1.0)
    assert phase == pytest.approx(1.0, abs=0.02)
    assert spread == pytest.approx(8**-0.5 * 2**0.5, rel=0.1)
    _, spread, _ = summed(np.zeros(16), 1.0)
    assert spread == pytest.approx(np.sqrt(2), rel=0.01)


def test_two_valleys_are_told_from_one() -> None:
    one = profile(8 * (1 - np.cos(PHASES - 1.0)), 1.0)
    assert not is_bimodal(one)
    assert is_bimodal(replace(one, cost=20 * (1 - np.cos(2 * (PHASES - 1.0)))))


def test_vectors_follow_the_parameters() -> None:
    p, step = np.array([5.0, 6.0, 1.2, 0.3, 0.7]), 1e-6
    slopes = [(in_phase_vectors((p + step * e)[None])[0] - in_phase_vectors(p[None])[0]) / step for e in np.eye(5)]
    assert np.allclose(in_phase_jacobian(p), np.array(slopes).T, atol=1e-5)
