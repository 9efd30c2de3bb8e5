"""The solver on models that are linear, where every answer is known."""

import numpy as np
import pytest

from labdaemon.blur.patch.colour_planes import ColourPlanes, make_planes
from labdaemon.blur.patch.illumination import render_illumination
from labdaemon.blur.patch.pixels import Patch
from labdaemon.blur.solver.reduced_equations import Prior
from labdaemon.blur.solver.solve import gauss_newton_step, project_to_submodel, solve, warm_start

SHAPE = (4, 20, 22)
TRUTH = np.array([0.3, -0.2, 0.1])
LIGHT = np.tile([1000.0, 30.0, -20.0, 0.9], (4, 1))
SIGMA = 5.0


def images(seed=3):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1 : 1 : SHAPE[1] * 1j, -1 : 1 : SHAPE[2] * 1j]
    base = np.exp(-4 * (x**2 + y**2)) * np.ones(SHAPE)
    return base, np.array([base * wave for wave in (x, y * x, np.sin(3 * y))]), rng


def model_of(base, by_p, dtype=np.float32):
    def model(p):
        return (base + np.tensordot(p, by_p, axes=1)).astype(dtype), by_p.astype(dtype)

    return model


def planes_of(base, by_p, rng):
    empty = np.zeros(SHAPE)
    offsets = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    blank = ColourPlanes(empty, np.ones(SHAPE, dtype=bool), np.arange(4), offsets, 2, (0, 0))
    values = render_illumination(blank, LIGHT, base + np.tensordot(TRUTH, by_p, axes=1)) + SIGMA * rng.standard_normal(
        SHAPE
    )
    return ColourPlanes(values, blank.valid, blank.channel, offsets, 2, (0, 0))


def weights(signal):
    return np.full_like(signal, 1 / SIGMA**2)


@pytest.fixture
def linear():
    base, by_p, rng = images()
    return planes_of(base, by_p, rng), base, by_p, Prior(np.zeros(3), np.eye(3) * 1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_both_precisions_find_the_same(linear, dtype):
    planes, base, by_p, prior = linear
    to_single = solve(planes, weights, model_of(base, by_p, dtype), np.zeros(3), prior)
    assert to_single.converged
    assert to_single.chi2 == pytest.approx(1.0, abs=0.15)
    pull = (to_single.p - TRUTH) / np.sqrt(np.diag(to_single.covariance))
    assert np.all(np.abs(pull) < 4)
    double = solve(planes, weights, model_of(base, by_p, np.float64), np.zeros(3), prior)
    np.testing.assert_allclose(to_single.p, double.p, atol=1e-2 * np.sqrt(np.diag(double.covariance)).min())
    np.testing.assert_allclose(to_single.covariance, double.covariance, rtol=1e-3, atol=1e-9)


def test_what_a_last_step_leaves_is_what_is_seen_there(linear):
    planes, base, by_p, prior = linear
    model = model_of(base, by_p, np.float64)
    stepped = gauss_newton_step(planes, weights, model, TRUTH + 0.02, prior, LIGHT)
    seen = render_illumination(planes, stepped.light, model(stepped.p)[0])
    np.testing.assert_allclose(stepped.signal, seen, atol=1e-6)
    np.testing.assert_allclose(stepped.residual, (planes.values - seen) / SIGMA, atol=1e-6)


def test_an_approach_ends_near_the_solution(linear):
    planes, base, by_p, prior = linear
    model = model_of(base, by_p)
    near = warm_start(planes, weights, model, np.zeros(3), prior, np.full(3, 0.05))
    assert near is not None
    np.testing.assert_allclose(near[0], solve(planes, weights, model, np.zeros(3), prior).p, atol=5e-3)


def test_an_approach_that_leads_nowhere_is_none(linear):
    planes, base, by_p, prior = linear
    assert warm_start(planes, weights, model_of(base, by_p), np.zeros(3), prior, np.zeros(3)) is None


def test_a_restricted_solution_is_the_one_with_fewer_parameters(linear):
    planes, base, by_p, prior = linear
    slope = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.25]])
    free = solve(planes, weights, model_of(base, by_p, np.float64), TRUTH, prior, light=LIGHT)
    fewer = Prior(np.zeros(2), slope.T @ prior.precision @ slope)
    direct = solve(
        planes, weights, model_of(base, np.tensordot(slope.T, by_p, axes=1), np.float64), TRUTH[:2], fewer, light=LIGHT
    )
    information = np.linalg.inv(free.covariance)
    p = np.linalg.solve(slope.T @ information @ slope, slope.T @ information @ free.p)
    found = project_to_submodel(free, prior, p, slope @ p - free.p, slope, fewer)
    sd = np.sqrt(np.diag(direct.covariance))
    assert np.all(np.abs(found.p - direct.p) < 0.05 * sd)
    np.testing.assert_allclose(found.covariance, direct.covariance, rtol=0.02, atol=1e-9)
    np.testing.assert_allclose(found.signal, direct.signal, atol=0.5)
    assert found.dof == direct.dof
    assert found.cost == pytest.approx(direct.cost, rel=1e-3)


def test_sums_that_overflow_single_precision_leave_the_prior():
    dark = np.random.default_rng(1).random((1, 12, 12))
    values = 1000.0 * (1 - 0.9 * dark[0])
    planes = make_planes(Patch(values, np.zeros((12, 12), np.uint8), np.ones((12, 12), bool), (0, 0)))
    wild = np.full((2, *dark.shape), 1e30, dtype=np.float32)
    prior = Prior(np.array([0.0, 3.0]), np.diag([0.0, 1.0]))
    start = np.array([1.0, 2.0])
    found = solve(planes, lambda s: np.full(s.shape, 0.01), lambda _: (dark, wild), start, prior)
    np.testing.assert_allclose(found.p, [1.0, 3.0], atol=0.01)
