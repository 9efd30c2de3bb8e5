"""Mean and first harmonic of a path's image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.oriented_camera import OrientedCamera

FloatArray = np.ndarray


def affine(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A camera that is linear: u = 2x − z, v = y + 0.5."""
    matrix = np.array([[2.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    offset = np.tile(np.eye(2)[None], (len(points), 1, 1))
    return points @ matrix.T + [0.0, 0.5], np.tile(matrix, (len(points), 1, 1)), offset


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(st.floats(-5.0, 5.0), min_size=9, max_size=9))
def test_a_linear_camera_maps_mean_and_harmonic_each_by_itself(numbers: list[float]) -> None:
    motion = np.array(numbers).reshape(3, 3)
    image, by_motion, by_offset = project_motion(affine, motion)
    for part in range(3):
        u, v = 2 * motion[part, 0] - motion[part, 2], motion[part, 1] + (0.5 if part == 0 else 0.0)
        np.testing.assert_allclose(image[2 * part : 2 * part + 2], [u, v], atol=1e-12)
    np.testing.assert_allclose(by_motion @ motion.reshape(9) + [0, 0.5, 0, 0, 0, 0], image, atol=1e-12)
    np.testing.assert_allclose(by_offset, [[1, 0], [0, 1], [0, 0], [0, 0], [0, 0], [0, 0]], atol=1e-12)


@pytest.fixture(scope="module")
def camera(look: Callable[..., OrientedCamera]) -> OrientedCamera:
    return look((0.0, -900.0, 500.0))


def test_derivatives_are_those_of_the_image(camera: OrientedCamera) -> None:
    motion = np.array([[20.0, 10.0, 300.0], [4.0, 3.0, 1.0], [-1.0, 2.0, 0.5]])
    _, by_motion, _ = project_motion(camera.project_with_jacobians, motion)
    numeric = np.empty((6, 9))
    for column in range(9):
        change = np.zeros(9)
        change[column] = 1e-4
        above = project_motion(camera.project_with_jacobians, motion + change.reshape(3, 3))[0]
        below = project_motion(camera.project_with_jacobians, motion - change.reshape(3, 3))[0]
        numeric[:, column] = (above - below) / 2e-4
    np.testing.assert_allclose(by_motion, numeric, rtol=1e-5, atol=1e-6)


def test_twelve_phases_are_as_good_as_many(camera: OrientedCamera) -> None:
    """A path of 60 mm towards the camera: its image's mean is not the image of its mean."""
    motion = np.array([[0.0, 0.0, 370.0], [5.0, -60.0, 10.0], [0.0, 10.0, 0.0]])
    image, _, _ = project_motion(camera.project_with_jacobians, motion)
    phase = 2 * np.pi * (np.arange(2000) + 0.5) / 2000
    path = motion[0] + np.sin(phase)[:, None] * motion[1] + np.cos(phase)[:, None] * motion[2]
    pixels = camera.project(path)
    np.testing.assert_allclose(image[:2], pixels.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(image[2:4], 2 * np.sin(phase) @ pixels / 2000, atol=1e-6)
    np.testing.assert_allclose(image[4:], 2 * np.cos(phase) @ pixels / 2000, atol=1e-6)
    assert np.abs(pixels.mean(axis=0) - camera.project(motion[:1])[0]).max() > 0.01
