"""Damped step, covariance and robust weights, against closed forms."""

import numpy as np
import pytest

from labdaemon.least_squares import biweight, cauchy_weight, damped_step, huber_weight, scaled_inverse


@pytest.fixture
def problem():
    """Normal matrix of parameters in very different units, and its gradient."""
    rng = np.random.default_rng(3)
    design = rng.normal(size=(40, 3)) * [1.0, 1e4, 1e-5]
    return design.T @ design, design.T @ rng.normal(size=40)


def test_without_damping_a_step_solves_the_normal_equations(problem):
    normal, gradient = problem
    np.testing.assert_allclose(normal @ damped_step(normal, gradient, 0.0), gradient, rtol=1e-9)


def test_damping_shortens_a_step_and_turns_it_down_the_gradient(problem):
    normal, gradient = problem
    free, damped = damped_step(normal, gradient, 0.0), damped_step(normal, gradient, 1e6)
    assert damped @ normal @ damped < 1e-9 * (free @ normal @ free)
    np.testing.assert_allclose(damped * 1e6, gradient / np.diag(normal), rtol=1e-4)


def test_a_parameter_that_does_not_show_keeps_its_value(problem):
    normal, gradient = problem
    wide, long = np.zeros((4, 4)), np.zeros(4)
    wide[:3, :3], long[:3] = normal, gradient
    np.testing.assert_allclose(damped_step(wide, long, 0.0), [*damped_step(normal, gradient, 0.0), 0.0], rtol=1e-9)
    np.testing.assert_allclose(scaled_inverse(wide)[:3, :3], np.linalg.inv(normal), rtol=1e-8)
    assert scaled_inverse(wide)[3, 3] == 0.0


def test_robust_weights_are_one_for_small_residuals_and_fall():
    residual = np.array([0.0, 0.5, 2.0, 10.0])
    np.testing.assert_allclose(huber_weight(residual, 1.0), [1.0, 1.0, 0.5, 0.1])
    np.testing.assert_allclose(cauchy_weight(residual**2, 4.0), [1.0, 16 / 17, 0.5, 1 / 26])
    np.testing.assert_allclose(biweight(residual**2 / 4.0), [1.0, (15 / 16) ** 2, 0.0, 0.0])
