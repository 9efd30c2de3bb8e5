"""Normal equations with the illumination eliminated, against the whole problem."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.illumination import illumination_derivatives, render_illumination
from labdaemon.blur.solver.reduced_equations import Prior, build_solution, reduce_normal_equations, weighted_squares

SHAPE, K = (2, 14, 16), 3
LIGHT = np.array([[1500.0, 40.0, -20.0, 0.9], [900.0, -10.0, 15.0, 0.8]])


class Problem:
    """Random derivatives, residuals and weights of two colour planes."""

    def __init__(self, *, masked: bool = False) -> None:
        rng = np.random.default_rng(4)
        y, x = np.mgrid[: SHAPE[1], : SHAPE[2]]
        self.dark = np.stack([np.exp(-((x - 8) ** 2 + (y - 7) ** 2) / 14.0)] * 2)
        self.by_p = rng.normal(size=(K, *SHAPE)) * self.dark
        self.weight = rng.uniform(0.5, 2.0, SHAPE) / 100.0
        if masked:
            self.weight[1] = 0.0
        self.residual = rng.normal(0, 10.0, SHAPE)
        self.planes = ColourPlanes(
            render_illumination(self._empty(), LIGHT, self.dark) + self.residual,
            self.weight > 0, np.array([0, 1]), np.zeros((2, 2)), 1, (0, 0),
        )  # fmt: skip
        self.prior = Prior(np.zeros(K), np.diag([0.0, 4.0, 0.0]))
        self.p = np.array([0.1, 0.3, -0.2])

    def _empty(self) -> ColourPlanes:
        return ColourPlanes(np.zeros(SHAPE), np.ones(SHAPE, dtype=bool), np.array([0, 1]), np.zeros((2, 2)), 1, (0, 0))

    def equations(self):  # type: ignore[no-untyped-def]
        return reduce_normal_equations(
            self.planes, self.residual, self.weight, LIGHT, self.dark, self.by_p, self.p, self.prior
        )

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """(k + 8) × (k + 8) normal matrix and gradient of the parameters and both planes' light."""
        columns = illumination_derivatives(self.planes, LIGHT, self.dark, self.by_p)
        design = np.zeros((K + 8, *SHAPE))
        for plane in range(2):
            design[:K, plane] = columns[plane, :K]
            design[K + 4 * plane : K + 4 * plane + 4, plane] = columns[plane, K:]
        flat, weight = design.reshape(K + 8, -1), self.weight.ravel()
        normal, gradient = flat * weight @ flat.T, flat * weight @ self.residual.ravel()
        normal[:K, :K] += self.prior.precision
        gradient[:K] -= self.prior.precision @ (self.p - self.prior.mean)
        return normal, gradient


def test_eliminating_the_light_changes_no_step() -> None:
    problem = Problem()
    equations = problem.equations()
    step = np.linalg.solve(*problem.whole())
    np.testing.assert_allclose(equations.step(0.0), step[:K], rtol=1e-6)
    np.testing.assert_allclose(equations.light_step(equations.step(0.0)).ravel(), step[K:], rtol=1e-5, atol=1e-7)


def test_the_covariance_is_the_parameters_part_of_the_whole_inverse() -> None:
    problem = Problem()
    equations = problem.equations()
    found = build_solution(
        problem.weight, equations, problem.prior, problem.p, LIGHT, problem.residual, problem.dark, 1.0, True
    )
    normal, _ = problem.whole()
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal)[:K, :K], rtol=1e-6)
    assert found.dof == int(np.prod(SHAPE)) - K - 8


def test_influence_carries_a_pixels_error_to_the_parameters() -> None:
    """The step is linear in the residuals; without a prior the influence is exactly its matrix."""
    problem = Problem()
    problem.prior = Prior(np.zeros(K), np.zeros((K, K)))
    equations = problem.equations()
    found = build_solution(
        problem.weight, equations, problem.prior, problem.p, LIGHT, problem.residual, problem.dark, 1.0, True
    )
    error = np.zeros(SHAPE)
    error[0, 5, 7], error[1, 9, 3] = 3.0, -2.0
    problem.residual = problem.residual + error
    change = problem.equations().step(0.0) - equations.step(0.0)
    np.testing.assert_allclose(np.tensordot(found.influence, error, axes=3), change, rtol=1e-5, atol=1e-9)


def test_a_plane_without_a_valid_pixel_says_nothing() -> None:
    masked = Problem(masked=True)
    equations = masked.equations()
    assert np.isfinite(equations.step(0.0)).all()
    assert np.isfinite(equations.light_step(equations.step(0.0))).all()
    found = build_solution(
        masked.weight, equations, masked.prior, masked.p, LIGHT, masked.residual, masked.dark, 1.0, True
    )
    assert found.dof == SHAPE[1] * SHAPE[2] - K - 4


def test_numbers_beyond_single_precision_leave_the_prior() -> None:
    problem = Problem()
    problem.by_p = (problem.by_p * 1e30).astype(np.float32)
    problem.dark = problem.dark.astype(np.float32)
    step = problem.equations().step(0.0)
    assert np.isfinite(step).all()
    assert step[1] == pytest.approx(-0.3)


def test_a_prior_costs_by_its_own_spread() -> None:
    prior = Prior(np.array([1.0, 2.0]), np.diag([4.0, 0.25]))
    assert prior.cost(np.array([1.5, 0.0])) == pytest.approx(4 * 0.25 + 0.25 * 4.0)
    assert weighted_squares(np.array([1.0, 2.0]), np.array([3.0, 0.5])) == pytest.approx(5.0)
