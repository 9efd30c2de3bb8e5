"""Normal equations with the points eliminated, against the whole matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.network import Network, Pose, ScaleBar
from labdaemon.geometry.normal_equations import LinearisedNetwork, apply_change, form_normal, linearise
from labdaemon.geometry.oriented_camera import OrientedCamera

FREE = np.array([True, False, True, True, True, False, False, False, False])


@pytest.fixture
def network(look: Callable[..., OrientedCamera], control_mm: np.ndarray) -> Network:
    """Three images of eight points, half of them surveyed, starting values a little off."""
    rng = np.random.default_rng(3)
    cameras = [look((-300.0, -900.0, 500.0)), look((300.0, -900.0, 450.0), roll=1.5), look((0.0, -950.0, 800.0))]
    image, point = np.repeat([0, 1, 2], 8), np.tile(np.arange(8), 3)
    pixels = np.concatenate([camera.project(control_mm) for camera in cameras]) + rng.normal(0, 0.2, (24, 2))
    sd = np.full((8, 3), np.inf)
    sd[:4] = 0.1
    sd[0] = 0.0
    points = control_mm.copy()
    points[4:] += rng.normal(0, 0.5, (4, 3))
    return Network(
        (cameras[0].lens,), tuple(Pose(camera.rotation, camera.position_mm + 0.2) for camera in cameras),
        np.zeros(3, dtype=np.intp), points, image, point, pixels, sd_px=0.2, control_sd=sd,
        bars=(ScaleBar(4, 5, float(np.linalg.norm(control_mm[4] - control_mm[5])), 0.05),), free_interior=(FREE,),
    )  # fmt: skip


def dense_step(network: Network, linear: LinearisedNetwork, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """The same step from the whole matrix of camera unknowns, multipliers and points."""
    cameras, points, bars = linear.by_camera.shape[1], len(network.points), linear.extra.shape[0]
    weight = np.repeat(network.weights, 2)
    a = linear.by_camera.toarray()
    b = np.zeros((2 * len(network.image), 3 * points))
    for row, (index, block) in enumerate(zip(network.point, linear.by_point, strict=True)):
        b[2 * row : 2 * row + 2, 3 * index : 3 * index + 3] = block
    residual, free = linear.residuals.ravel(), (network.survey_sd > 0).ravel()
    u, w, v = a.T * weight @ a, a.T * weight @ b, b.T * weight @ b + np.diag(linear.survey_weights.ravel())
    u[np.diag_indices_from(u)] *= 1 + damping
    v[np.diag_indices_from(v)] *= 1 + damping
    extra = linear.extra.toarray()
    whole = np.block([
        [u, np.zeros((cameras, bars)), w], [np.zeros((bars, cameras)), np.diag(linear.extra_diagonal), extra],
        [w.T, extra.T, v],
    ])  # fmt: skip
    right = np.concatenate([
        a.T @ (weight * residual), linear.extra_misclosure,
        b.T @ (weight * residual) + (linear.survey_weights * linear.survey).ravel(),
    ])  # fmt: skip
    keep = np.concatenate([np.ones(cameras + bars, dtype=bool), free])
    solution = np.zeros(len(keep))
    solution[keep] = np.linalg.solve(whole[np.ix_(keep, keep)], right[keep])
    return solution[:cameras], solution[cameras + bars :].reshape(points, 3)


@pytest.mark.parametrize("damping", [0.0, 1e-3, 1.0])
def test_eliminating_the_points_changes_nothing(network: Network, damping: float) -> None:
    linear = linearise(network, network.points.copy())
    cameras, points = form_normal(network, linear, damping).solve()
    expected_cameras, expected_points = dense_step(network, linear, damping)
    count = linear.by_camera.shape[1]
    np.testing.assert_allclose(cameras[:count], expected_cameras, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(points, expected_points, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(points[0], 0.0)  # held fixed


def test_derivatives_are_those_of_the_residuals(network: Network) -> None:
    linear = linearise(network, network.points.copy())
    count = linear.by_camera.shape[1]
    rng = np.random.default_rng(5)
    scale = np.concatenate([network.lenses[0].parameters[FREE], np.tile([1.0, 1.0, 1.0, 300.0, 300.0, 300.0], 3)])
    change = 1e-7 * scale * rng.normal(size=count)
    moved = 1e-5 * rng.normal(size=(8, 3)) * (network.survey_sd > 0)
    after = linearise(apply_change(network, change, moved), network.points.copy())
    by_point = np.einsum("nij,nj->ni", linear.by_point, moved[network.point])
    predicted = linear.residuals - (linear.by_camera @ change).reshape(-1, 2) - by_point
    np.testing.assert_allclose(after.residuals, predicted, atol=2e-7)


def test_a_step_lowers_the_cost(network: Network) -> None:
    surveyed = network.points.copy()
    linear = linearise(network, surveyed)
    stepped = apply_change(network, *form_normal(network, linear, 1e-6).solve())
    assert linearise(stepped, surveyed).cost(stepped) < 0.1 * linear.cost(network)


def test_a_point_behind_a_camera_costs_infinitely_much(network: Network) -> None:
    behind = network.points.copy()
    behind[5] = [0.0, -5000.0, 500.0]
    there = replace(network, points=behind)
    assert linearise(there, behind).cost(there) == float("inf")


def test_unknowns_that_nothing_determines_are_refused(network: Network) -> None:
    loose = replace(network, control_sd=np.full((8, 3), np.inf), bars=())
    normal = form_normal(loose, linearise(loose, loose.points.copy()))
    with pytest.raises(DataError, match="do not determine all unknowns"):
        normal.cofactor()
