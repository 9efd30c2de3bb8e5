"""Rough camera positions to start an adjustment from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from labdaemon.geometry.initial_pose import initial_cameras
from labdaemon.geometry.oriented_camera import OrientedCamera


@pytest.mark.parametrize("roll", [0.0, 1.5, 3.0])
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (4.5e6, 5.3e6, 400e3)])
def test_the_best_is_near_the_truth(
    look: Callable[..., OrientedCamera], control_mm: np.ndarray, roll: float, origin: tuple[float, float, float]
) -> None:
    """Also in a site grid, whose numbers are large."""
    camera = look((300.0, -900.0, 500.0), roll=roll)
    rng = np.random.default_rng(1)
    pixels = camera.project(control_mm) + rng.normal(0, 0.3, (8, 2))
    best = initial_cameras(camera.lens, pixels, control_mm + origin)[0]
    assert np.linalg.norm(best.position_mm - origin - camera.position_mm) < 10.0
    assert np.abs(best.rotation - camera.rotation).max() < 0.02


def test_a_gross_error_costs_little(look: Callable[..., OrientedCamera], control_mm: np.ndarray) -> None:
    camera = look((0.0, -900.0, 500.0))
    pixels = camera.project(control_mm)
    pixels[3] += [400.0, -300.0]
    best = initial_cameras(camera.lens, pixels, control_mm)[0]
    assert np.linalg.norm(best.position_mm - camera.position_mm) < 10.0


def test_no_camera_stands_with_the_points_behind_it(
    look: Callable[..., OrientedCamera], control_mm: np.ndarray
) -> None:
    camera = look((0.0, -900.0, 500.0))
    for one in initial_cameras(camera.lens, camera.project(control_mm), control_mm):
        assert np.median(one.to_camera_axes(control_mm)[:, 2]) > 0


def test_three_points_are_not_enough(look: Callable[..., OrientedCamera], control_mm: np.ndarray) -> None:
    camera = look((0.0, -900.0, 500.0))
    pixels = camera.project(control_mm)
    assert initial_cameras(camera.lens, pixels[:3], control_mm[:3]) == []
    outside = np.full((8, 2), np.nan)
    outside[:3] = pixels[:3]
    assert initial_cameras(camera.lens, outside, control_mm) == [], "pixels that have no ray"
