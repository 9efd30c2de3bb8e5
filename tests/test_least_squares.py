"""Damped step, covariance and robust weights, against closed forms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from labdaemon.least_squares import (
    DampingRule,
    biweight,
    cauchy_weight,
    damped_step,
    huber_weight,
    minimise,
    scaled_inverse,
)


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


def test_rounding_leaves_no_negative_variance():
    """Two parameters that hardly differ: the smallest eigenvalue is rounding, of either sign."""
    for excess in (1e-9, -1e-9):
        normal = np.array([[1.0, 1.0 + excess, 0.1], [1.0 + excess, 1.0, 0.1], [0.1, 0.1, 1.0]])
        covariance = scaled_inverse(normal)
        assert np.linalg.eigvalsh(covariance)[0] > 0
        assert covariance[0, 0] == pytest.approx(0.5e9, rel=1e-3)


def test_robust_weights_are_one_for_small_residuals_and_fall():
    residual = np.array([0.0, 0.5, 2.0, 10.0])
    np.testing.assert_allclose(huber_weight(residual, 1.0), [1.0, 1.0, 0.5, 0.1])
    np.testing.assert_allclose(cauchy_weight(residual**2, 4.0), [1.0, 16 / 17, 0.5, 1 / 26])
    np.testing.assert_allclose(biweight(residual**2 / 4.0), [1.0, (15 / 16) ** 2, 0.0, 0.0])


@dataclass(frozen=True)
class Curve:
    """y = exp(p·t) against observations of it: a fit whose undamped steps overshoot from afar."""

    p: float
    times: np.ndarray
    observed: np.ndarray

    @property
    def cost(self) -> float:
        with np.errstate(over="ignore"):
            return float(np.sum((self.observed - np.exp(self.p * self.times)) ** 2))

    def step(self, damping: float) -> tuple[Curve | None, bool]:
        model = np.exp(self.p * self.times)
        design = (self.times * model)[:, None]
        step = damped_step(design.T @ design, design.T @ (self.observed - model), damping)
        return replace(self, p=self.p + float(step[0])), abs(float(step[0])) < 1e-12


@pytest.mark.parametrize("start", [-3.0, 0.0, 0.9, 2.5])
def test_iterations_end_at_the_minimum_from_near_and_far(start):
    times = np.linspace(0.0, 3.0, 20)
    found = minimise(Curve(start, times, np.exp(0.7 * times)), Curve.step, max_steps=60)
    assert found.converged
    assert found.at.p == pytest.approx(0.7, abs=1e-9)


def test_the_cost_never_rises_on_the_way():
    costs = []

    def step(here, damping):
        costs.append(here.cost)
        return here.step(damping)

    times = np.linspace(0.0, 3.0, 20)
    minimise(Curve(-3.0, times, np.exp(0.7 * times)), step, max_steps=60)
    assert all(later <= earlier for earlier, later in pairwise(costs))


def test_iterations_run_out_and_say_so():
    times = np.linspace(0.0, 3.0, 20)
    found = minimise(Curve(-3.0, times, np.exp(0.7 * times)), Curve.step, max_steps=2)
    assert (found.steps, found.converged) == (2, False)


def test_where_no_step_lowers_the_cost_the_start_stays():
    """A step into what cannot be evaluated is tried again shorter, and given up in the end."""
    tried = []

    def nowhere(here, damping):
        tried.append(damping)
        return (None if len(tried) % 2 else replace(here, p=-9.0)), False

    here = Curve(0.7, np.ones(3), np.full(3, np.exp(0.7)))
    rule = DampingRule(start=1e-3, raised=10.0, most=1e2)
    found = minimise(here, nowhere, rule=rule, max_steps=50)
    assert found.at is here
    assert not found.converged
    np.testing.assert_allclose(tried, [1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0])
