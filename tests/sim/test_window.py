"""Area sampling: what a window holds against geometry done on paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdrivers.sim.lens import CameraModel, FloatArray, SensorShift
from labdrivers.sim.optics import Optics
from labdrivers.sim.path import CameraView, MotionPath, follow
from labdrivers.sim.scene import Scene, SceneTarget
from labdrivers.sim.smear import blur_target
from labdrivers.sim.window import PixelWindow, develop, dwell_map

FOCAL = 3934.4
LENS = Optics("gaussian", sigma_px=0.8)
Motion = Callable[[FloatArray], FloatArray]


def frontal(distortion: tuple[float, float, float, float, float] = (0.0,) * 5) -> CameraModel:
    return CameraModel((3900, 2613), (FOCAL, FOCAL), (1950.3, 1306.7), distortion, (0.0, -1000.0, 0.0))


def ink_moments(x_mm: float, z_mm: float, motion: Motion | None, fine: int = 4) -> FloatArray:
    """Area, centroid and central second moments (xx, yy, xy) of the dot's ink on the sensor, green."""
    scene = Scene((SceneTarget("A", (x_mm, 0.0, z_mm)),), texture=0.0)
    view = CameraView(frontal(), SensorShift())
    rest = np.array([x_mm, 0.0, z_mm])
    path = MotionPath.at_rest(0.5) if motion is None else follow(view, rest, motion, (0.0, 1.0))
    smear = blur_target(scene, 0, view, path, fine)
    assert smear is not None
    window = smear.ink.window
    ink = develop(smear.ink.spectra, window, LENS)[0][1].astype(float) / (scene.paper - scene.ink)
    y, x = np.mgrid[0 : window.height, 0 : window.width].astype(float)
    x, y = x + window.x0, y + window.y0
    area = ink.sum()
    cx, cy = (ink * x).sum() / area, (ink * y).sum() / area
    xx, yy, xy = ((ink * u * v).sum() / area for u, v in ((x - cx, x - cx), (y - cy, y - cy), (x - cx, y - cy)))
    return np.array([area, cx, cy, xx, yy, xy])


@settings(max_examples=12, deadline=None, derandomize=True)
@given(x_mm=st.floats(-100, 100), z_mm=st.floats(-80, 80))
def test_a_dot_at_rest_has_its_area_place_and_size(x_mm: float, z_mm: float) -> None:
    area, cx, cy, xx, yy, xy = ink_moments(x_mm, z_mm, None)
    radius = 4.0 * FOCAL / 1000.0
    assert area == pytest.approx(np.pi * radius**2, rel=1e-5)
    assert cx == pytest.approx(1950.3 + x_mm * FOCAL / 1000.0, abs=3e-4)
    assert cy == pytest.approx(1306.7 - z_mm * FOCAL / 1000.0, abs=3e-4)
    expected = radius**2 / 4 + LENS.sigma_px**2 + 1 / 12
    assert xx == pytest.approx(expected, abs=1.5e-3)
    assert yy == pytest.approx(expected, abs=1.5e-3)
    assert xy == pytest.approx(0.0, abs=1.5e-3)


@pytest.mark.parametrize("a_mm", [0.1, 0.5, 2.0, 6.0])
def test_a_sinusoid_adds_half_its_amplitude_squared(a_mm: float) -> None:
    def motion(t: FloatArray) -> FloatArray:
        wave = a_mm * np.sin(2.0 * np.pi * 5.0 * t)
        return np.stack([wave, 0.0 * t, 0.3 * wave], axis=1)

    still, moved = ink_moments(3.3, 2.1, None), ink_moments(3.3, 2.1, motion)
    a_px = a_mm * FOCAL / 1000.0
    np.testing.assert_allclose(moved[1:3], still[1:3], atol=1e-4)
    np.testing.assert_allclose(
        moved[3:] - still[3:], a_px**2 * np.array([0.5, 0.045, -0.15]), atol=5e-4 + 3e-6 * a_px**2
    )


def test_any_law_of_motion_is_rendered_as_it_is() -> None:
    """A triangular motion's positions are spread evenly: variance A²/3."""

    def motion(t: FloatArray) -> FloatArray:
        wave = 2.0 * np.abs(2.0 * ((4.0 * t) % 1.0) - 1.0) - 1.0
        return np.stack([2.0 * wave, 0.0 * t, 0.0 * t], axis=1)

    still, moved = ink_moments(0.7, -1.9, None), ink_moments(0.7, -1.9, motion)
    a_px = 2.0 * FOCAL / 1000.0
    assert moved[3] - still[3] == pytest.approx(a_px**2 / 3, abs=2e-3)
    assert moved[4] - still[4] == pytest.approx(0.0, abs=1.5e-3)


def test_twice_the_sampling_changes_nothing() -> None:
    def motion(t: FloatArray) -> FloatArray:
        return np.stack([1.1 * np.sin(9 * t), 4.0 * np.sin(9 * t + 0.5), 0.6 * np.cos(9 * t)], axis=1)

    coarse, dense = (ink_moments(5.3, 2.1, motion, fine) for fine in (4, 8))
    np.testing.assert_allclose(coarse[1:3], dense[1:3], atol=5e-5)
    np.testing.assert_allclose(coarse[3:], dense[3:], atol=5e-4)


def test_dwell_map_keeps_time_place_and_spread() -> None:
    window = PixelWindow(0, 0, 24, 20)
    rng = np.random.default_rng(3)
    offsets = rng.normal(0.0, 1.3, (500, 2))
    weights = rng.uniform(0.5, 1.5, 500) / 500
    dwell = dwell_map(offsets, weights, window).astype(float)
    rows, columns = dwell.shape
    y = ((np.arange(rows) + rows // 2) % rows - rows // 2)[:, None] / window.fine
    x = ((np.arange(columns) + columns // 2) % columns - columns // 2)[None, :] / window.fine
    total = weights.sum()
    assert dwell.sum() == pytest.approx(total, rel=1e-6)
    for power_x, power_y in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 2)):
        expected = (weights * offsets[:, 0] ** power_x * offsets[:, 1] ** power_y).sum()
        assert (dwell * x**power_x * y**power_y).sum() == pytest.approx(expected, abs=2e-5 * total)


def test_a_label_may_stay_behind_its_dot() -> None:
    def motion(t: FloatArray) -> FloatArray:
        return np.stack([3.0 * np.sin(2 * np.pi * 5 * t), 0.0 * t, 0.0 * t], axis=1)

    view, rest = CameraView(frontal(), SensorShift()), np.zeros(3)
    path = follow(view, rest, motion, (0.0, 1.0))
    images = {}
    for still in (False, True):
        scene = Scene((SceneTarget("A", (0.0, 0.0, 0.0), 8.0, (40.0, 40.0)),), texture=0.0, still_paper=still)
        smear = blur_target(scene, 0, view, path, 4)
        assert smear is not None
        images[still] = [
            seen[1] for layer in (smear.paper, smear.ink) for seen in develop(layer.spectra, layer.window, LENS)
        ]
    np.testing.assert_allclose(images[True][2], images[False][2], atol=2e-6)
    edge = (images[True][1].shape[0] // 2, slice(0, images[True][1].shape[1] // 2))
    steepest = [np.abs(np.diff(images[still][1][edge])).max() for still in (False, True)]
    assert steepest[1] > 3 * steepest[0]
