"""Whole frames: against brute force, and against what a photograph has to show."""

from __future__ import annotations

import numpy as np
import pytest

from labdrivers.sim.lens import CameraModel, FloatArray
from labdrivers.sim.optics import Optics
from labdrivers.sim.render import render_frame
from labdrivers.sim.scene import Occluder, Scene, SceneTag, SceneTarget
from labdrivers.sim.sensor import Sensor

PLAIN = Sensor(gains=(1.0, 1.0, 1.0), prnu=0.0, hot=0.0)


def small_camera(size: tuple[int, int] = (161, 140)) -> CameraModel:
    middle = ((size[0] - 1) / 2 + 0.3, (size[1] - 1) / 2 - 0.2)
    return CameraModel(size, (1968.8, 1968.8), middle, (-0.09, 0.07, 3e-4, -2e-4, 0.0), (0.0, -1000.0, 0.0))


def circle(t: FloatArray) -> FloatArray:
    angle = 2 * np.pi * 3.0 * t
    return np.stack([1.7 * np.sin(angle), 0.8 * np.sin(angle), 0.9 * np.cos(angle)], axis=1)


def test_agrees_with_brute_force() -> None:
    """Points thrown on every pixel at every moment, one by one through the lens, then blurred in space."""
    target = SceneTarget("A", (0.3, 0.0, 0.2), 8.0, (60.0, 52.0))
    scene = Scene((target,), texture=0.0, gradient=(0.0, 0.0), vignetting=0.0, clutter=0)
    camera = small_camera()
    sigma = 1.1
    frame = render_frame(
        scene, camera, motions={"A": circle}, optics=Optics("gaussian", sigma_px=sigma), sensor=PLAIN, white_dn=850.0
    )
    fine, moments = 8, 240
    width, height = camera.image_size
    x = (np.arange(width * fine) + 0.5) / fine - 0.5
    y = (np.arange(height * fine) + 0.5) / fine - 0.5
    ink = np.zeros((y.size, x.size))
    rim = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    for t in (np.arange(moments) + 0.5) / moments:
        d = circle(np.array([t]))[0]
        outline = camera.project(target.points(4.0 * np.stack([np.cos(rim), np.sin(rim)], axis=1)) + d)
        # an ellipse through the projected rim; distortion bends it by less than 1e-3 px here
        centre = outline.mean(axis=0)
        shape = np.linalg.inv(2.0 * np.cov((outline - centre).T, bias=True))
        dx, dy = grid_x - centre[0], grid_y - centre[1]
        ink += (shape[0, 0] * dx * dx + 2 * shape[0, 1] * dx * dy + shape[1, 1] * dy * dy) < 1.0
    ink = ink.reshape(height, fine, width, fine).mean(axis=(1, 3)) / moments
    reach = np.arange(-8, 9)
    kernel = np.exp(-0.5 * (reach / sigma) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        ink = np.apply_along_axis(lambda line: np.convolve(line, kernel, "same"), axis, ink)
    expected = 850.0 * (1.0 + (scene.ink / scene.paper - 1.0) * ink)
    inner = (slice(48, 92), slice(58, 102))
    assert np.ptp(expected[inner]) > 300.0
    np.testing.assert_allclose(frame.mean_dn[inner], expected[inner], atol=1.5)


def test_truth_in_the_image_is_the_projected_path() -> None:
    scene = Scene((SceneTarget("A", (0.3, 0.0, 0.2)), SceneTarget("B", (20.0, 0.0, 0.0))), texture=0.0)
    camera = small_camera()
    truth = render_frame(scene, camera, motions={"A": circle}, frequency_hz=3.0).truth
    image = camera.project(np.array([0.3, 0.0, 0.2]) + circle(np.linspace(0.0, 1.0, 3001)[:-1]))
    np.testing.assert_allclose(truth["A"].mean_px, image.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(truth["A"].moment_px2, np.cov(image.T, bias=True), atol=1e-4)
    np.testing.assert_allclose(truth["A"].a_mm, (1.7, 0.8, 0.0), atol=1e-9)
    np.testing.assert_allclose(truth["A"].b_mm, (0.0, 0.0, 0.9), atol=1e-9)
    np.testing.assert_allclose(truth["B"].moment_px2, 0.0, atol=1e-12)


def test_a_part_cycle_moves_the_mean() -> None:
    scene = Scene((SceneTarget("A", (0.0, 0.0, 0.0)),), texture=0.0)
    truth = render_frame(
        scene, small_camera(), motions={"A": circle}, opened_s=0.02, exposure_s=0.4, frequency_hz=3.0, phase_rad=0.3
    ).truth["A"]
    t = 0.02 + np.linspace(0.0, 0.4, 4001)
    np.testing.assert_allclose(truth.mean_mm, circle(t).mean(axis=0), atol=1e-3)


def test_paper_grain_moves_with_the_paper_and_has_its_size() -> None:
    label = SceneTarget("A", (0.0, 0.0, 0.0), 8.0, (60.0, 52.0))
    scene = Scene((label,), texture=0.02, texture_length_mm=1.5, gradient=(0.0, 0.0), vignetting=0.0)
    lens = Optics("gaussian", sigma_px=0.3)
    options = {"optics": lens, "sensor": PLAIN, "white_dn": 1000.0}
    shift_mm = 4.0 / 1968.8 * 1000.0
    still = render_frame(scene, small_camera(), **options).mean_dn  # type: ignore[arg-type]
    moved = render_frame(
        scene,
        small_camera(),
        motions={"A": lambda t: np.tile((shift_mm, 0.0, 0.0), (t.size, 1))},
        **options,  # type: ignore[arg-type]
    ).mean_dn
    one, two = still[25:50, 30:120], moved[25:50, 34:124]
    assert one.std() / one.mean() == pytest.approx(0.02, rel=0.25)
    assert np.corrcoef(one.ravel(), two.ravel())[0, 1] > 0.98
    assert np.corrcoef(one.ravel(), moved[25:50, 30:120].ravel())[0, 1] < 0.6


def test_the_label_uncovers_what_is_behind_it() -> None:
    scene = Scene(
        (SceneTarget("A", (0.0, 0.0, 0.0), 6.0, (20.0, 20.0)),), clutter=0, gradient=(0.0, 0.0), vignetting=0.0
    )

    def wide(t: FloatArray) -> FloatArray:
        return np.stack([8.0 * np.sin(2 * np.pi * 3 * t), 0 * t, 0 * t], axis=1)

    still = render_frame(scene, small_camera(), sensor=PLAIN).mean_dn
    moved = render_frame(scene, small_camera(), motions={"A": wide}, sensor=PLAIN).mean_dn
    near_edge = (69, 80 + 16)
    assert still[near_edge] > 2500.0
    assert 0.35 * still[near_edge] < moved[near_edge] < 0.95 * still[near_edge]


def test_occluders_shift_noise_and_tags() -> None:
    scene = Scene((SceneTarget("A", (0.0, 0.0, 0.0)),), (SceneTag(3, (24.0, 0.0, 18.0), 16.0, 24.0),))
    camera = small_camera()
    plain = render_frame(scene, camera, seed=1)
    again = render_frame(scene, camera, seed=1)
    np.testing.assert_array_equal(plain.mosaic, again.mosaic)
    assert np.any(plain.mosaic != render_frame(scene, camera, seed=2).mosaic)
    hidden = render_frame(scene, camera, occluders=(Occluder(((70, 60), (90, 60), (90, 80), (70, 80)), 0.9),))
    assert hidden.mean_dn[69, 80] > 4.0 * plain.mean_dn[69, 80]
    moved = render_frame(scene, camera, shift=(2.0, 0.0, 0.0), sensor=PLAIN).mean_dn
    base = render_frame(scene, camera, sensor=PLAIN).mean_dn
    np.testing.assert_allclose(moved[60:80, 72:92], base[60:80, 70:90], rtol=0.02)


def test_plain_values_do_for_a_caller_without_the_classes() -> None:
    frame = render_frame(
        {"targets": [{"name": "A", "centre_mm": (0.0, 0.0, 0.0)}], "clutter": 0},
        {
            "image_size": (120, 101),
            "focal_px": (1968.8, 1968.8),
            "principal_point_px": (60.0, 50.0),
            "position_mm": (0.0, -1000.0, 0.0),
        },
        optics={"kind": "gaussian"},
        sensor={"pattern": "GRAY"},
    )
    assert frame.mosaic.shape == (101, 120)
    assert frame.mosaic[50, 60] < 600 < frame.mosaic[50, 80]
