"""The lens model against OpenCV's own projection."""

from __future__ import annotations

import cv2
import numpy as np

from labdrivers.sim.lens import CameraModel, SensorShift


def a_camera() -> CameraModel:
    return CameraModel.looking_at(
        (0.0, 0.0, 380.0),
        (-420.0, -900.0, 450.0),
        image_size=(3900, 2613),
        focal_px=(3937.7, 3935.1),
        principal_point_px=(1956.8, 1296.2),
        distortion=(-0.09, 0.07, 0.0003, -0.0002, 0.01),
        roll_rad=0.03,
    )


def test_projection_agrees_with_opencv() -> None:
    camera = a_camera()
    points = np.random.default_rng(1).uniform((-300, -100, 50), (300, 100, 700), (200, 3))
    rotation = np.array(camera.rotation)
    matrix = np.array([[3937.7, 0, 1956.8], [0, 3935.1, 1296.2], [0, 0, 1]])
    translation = -rotation @ np.array(camera.position_mm)
    expected, _ = cv2.projectPoints(
        points, cv2.Rodrigues(rotation)[0], translation, matrix, np.array(camera.distortion)
    )
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-8)


def test_axes_are_right_handed_and_the_aim_is_near_the_middle() -> None:
    camera = a_camera()
    rotation = np.array(camera.rotation)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    aim = camera.project(np.array([[0.0, 0.0, 380.0]]))[0]
    np.testing.assert_allclose(aim, (1956.8, 1296.2), atol=1e-6)
    higher = camera.project(np.array([[0.0, 0.0, 390.0]]))[0]
    assert higher[1] < aim[1], "y runs down"


def test_shift_rolls_about_the_middle_of_the_image() -> None:
    middle = np.array([[1949.5, 1306.0]])
    np.testing.assert_allclose(SensorShift(2.0, -1.0, 0.3).apply(middle, (3900, 2613)), middle + np.array([2.0, -1.0]))
    right = SensorShift(0.0, 0.0, np.pi / 2).apply(middle + np.array([10.0, 0.0]), (3900, 2613))
    np.testing.assert_allclose(right, middle + np.array([0.0, 10.0]), atol=1e-9)
