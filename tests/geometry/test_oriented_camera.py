from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.geometry.oriented_camera import rotation_from_vector, skew


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_rotation_agrees_with_opencv(vector: tuple[float, float, float]) -> None:
    expected = cv2.Rodrigues(np.array(vector))[0]
    np.testing.assert_allclose(rotation_from_vector(np.array(vector)), expected, atol=1e-9)


def test_skew_is_the_cross_product() -> None:
    rng = np.random.default_rng(3)
    v, w = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(v), w), np.cross(v, w))


def test_project_agrees_with_opencv(look, control_mm) -> None:
    camera = look((-400, -1000, 380), roll=0.4)
    expected, _ = cv2.projectPoints(
        control_mm,
        cv2.Rodrigues(camera.rotation)[0],
        -camera.rotation @ camera.position_mm,
        camera.lens.matrix,
        np.array(camera.lens.distortion),
    )
    np.testing.assert_allclose(camera.project(control_mm), expected[:, 0], atol=1e-8)


def test_a_camera_sees_nothing_behind_it(look) -> None:
    camera = look((0, -1000, 370))
    assert np.isnan(camera.project(np.array([[0.0, -1100.0, 370.0]]))).all()


def test_jacobians_agree_with_differences(look, control_mm) -> None:
    camera = look((-400, -1000, 380), roll=0.4)
    pixels, by_point, by_exterior = camera.project_with_jacobians(control_mm)
    np.testing.assert_allclose(pixels, camera.project(control_mm))
    for axis in range(3):
        step = 1e-3 * np.eye(3)[axis]
        numeric = (camera.project(control_mm + step) - camera.project(control_mm - step)) / 2e-3
        np.testing.assert_allclose(by_point[:, :, axis], numeric, rtol=1e-6, atol=1e-6)
    for column in range(6):
        change = np.zeros(6)
        change[column] = 1e-6 if column < 3 else 1e-3
        numeric = camera.apply_change(change).project(control_mm) - camera.apply_change(-change).project(control_mm)
        np.testing.assert_allclose(by_exterior[:, :, column], numeric / (2 * change[column]), rtol=1e-5, atol=1e-4)


def test_rays_meet_their_points(look, control_mm) -> None:
    camera = look((300, -900, 500), roll=-1.0)
    directions = camera.rays(camera.project(control_mm))
    expected = control_mm - camera.position_mm
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(directions, expected, atol=1e-12)
    assert pytest.approx(1.0) == np.linalg.norm(directions[0])
