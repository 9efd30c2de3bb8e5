from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.geometry import orient
from labdaemon.geometry.lens import Lens

NAMES = [str(i) for i in range(8)]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(x=st.floats(-600, 600), y=st.floats(-1500, -800), z=st.floats(100, 700), roll=st.floats(-3.1, 3.1))
def test_recovers_any_camera_exactly(look, control_mm, x: float, y: float, z: float, roll: float) -> None:
    camera = look((x, y, z), roll=roll)
    found = orient(camera.lens, camera.project(control_mm), control_mm, names=NAMES)
    np.testing.assert_allclose(found.camera.position_mm, camera.position_mm, atol=1e-5)
    np.testing.assert_allclose(found.camera.rotation, camera.rotation, atol=1e-8)
    assert not found.excluded


def test_stated_uncertainty_is_true(look, control_mm) -> None:
    """Pulls of the six exterior parameters over many surveys and readings."""
    rng = np.random.default_rng(11)
    pulls, sigmas = [], []
    for _ in range(60):
        camera = look(np.array([-400.0, -1000.0, 380.0]) + rng.normal(0, 60, 3), roll=float(rng.uniform(-3, 3)))
        pixels = camera.project(control_mm + rng.normal(0, 0.3, control_mm.shape)) + rng.normal(0, 0.05, (8, 2))
        found = orient(camera.lens, pixels, control_mm, names=NAMES, sd_image_px=0.05, sd_object_mm=0.3, volume=True)
        turn = found.camera.rotation @ camera.rotation.T
        error = np.array([turn[2, 1], turn[0, 2], turn[1, 0], *(found.camera.position_mm - camera.position_mm)])
        pulls.append(error / np.sqrt(np.diag(found.camera.covariance)))
        sigmas.append(found.sigma0)
    spread = np.std(pulls, axis=0)
    assert np.all((spread > 0.8) & (spread < 1.3)), spread
    assert np.mean(sigmas) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("wrong", range(8))
@pytest.mark.parametrize("kind", ["survey", "reading"])
def test_one_wrong_point_is_named_and_left_out(look, control_mm, wrong: int, kind: str) -> None:
    rng = np.random.default_rng(wrong)
    camera = look((-400, -1000, 380))
    pixels = camera.project(control_mm) + rng.normal(0, 0.05, (8, 2))
    surveyed = control_mm + rng.normal(0, 0.1, control_mm.shape)
    if kind == "survey":
        surveyed[wrong] += [6.0, -3.0, 8.0]
    else:
        pixels[wrong] += [15.0, -9.0]
    found = orient(camera.lens, pixels, surveyed, names=NAMES, sd_image_px=0.05, sd_object_mm=0.1)
    assert list(found.excluded) == [str(wrong)]
    assert "misread in the frame or mis-surveyed" in found.excluded[str(wrong)]
    assert not found.used[wrong]
    sd = np.sqrt(np.diag(found.camera.covariance))[3:]
    assert np.all(np.abs(found.camera.position_mm - camera.position_mm) < 5 * sd)


def test_planar_control_orients_one_camera(look) -> None:
    """A flat set fixes a calibrated camera; only three-dimensional measuring refuses it."""
    flat = np.array([[x, 0.0, z] for x in (-200.0, 0.0, 200.0) for z in (100.0, 600.0)])
    names = list("abcdef")
    camera = look((300, -1100, 400))
    found = orient(camera.lens, camera.project(flat), flat, names=names)
    np.testing.assert_allclose(found.camera.position_mm, camera.position_mm, atol=1e-4)
    with pytest.raises(DataError, match="all lie in a plane"):
        orient(camera.lens, camera.project(flat), flat, names=names, volume=True)


def test_worse_pixels_than_stated_widen_the_covariance_and_lose_no_point(look, control_mm) -> None:
    rng = np.random.default_rng(5)
    camera = look((-400, -1000, 380))
    pixels = camera.project(control_mm) + rng.normal(0, 0.3, (8, 2))
    tight = orient(camera.lens, pixels, control_mm, names=NAMES, sd_image_px=0.1)
    stated = orient(camera.lens, pixels, control_mm, names=NAMES, sd_image_px=0.3)
    assert not tight.excluded
    ratio = np.sqrt(np.diag(tight.camera.covariance) / np.diag(stated.camera.covariance))
    assert np.all((ratio > 0.6) & (ratio < 1.6))


class TestBadInput:
    def test_three_points(self, look, control_mm) -> None:
        camera = look((-400, -1000, 380))
        with pytest.raises(DataError, match=r"3 surveyed control targets in view \(0, 1, 2\); at least 4"):
            orient(camera.lens, camera.project(control_mm[:3]), control_mm[:3], names=NAMES[:3])

    def test_none(self, lens: Lens) -> None:
        with pytest.raises(DataError, match="0 surveyed control targets"):
            orient(lens, np.zeros((0, 2)), np.zeros((0, 3)), names=[])

    def test_all_in_a_line(self, look) -> None:
        line = np.linspace([-200.0, 0.0, 100.0], [200.0, 50.0, 600.0], 6)
        camera = look((-400, -1000, 380))
        with pytest.raises(DataError, match="in a line"):
            orient(camera.lens, camera.project(line), line, names=NAMES[:6])

    def test_an_id_twice(self, look, control_mm) -> None:
        camera = look((-400, -1000, 380))
        with pytest.raises(DataError, match="control target 3 is there more than once"):
            orient(camera.lens, camera.project(control_mm), control_mm, names=[*"0123", "3", *"567"])

    def test_survey_in_metres_shows_by_its_extent(self, look, control_mm) -> None:
        camera = look((-400, -1000, 380))
        with pytest.raises(DataError, match="metres"):
            orient(camera.lens, camera.project(control_mm), control_mm / 1000.0, names=NAMES)

    @pytest.mark.parametrize(("factor", "unit"), [(0.1, "decimetres"), (1 / 25.4, "inches"), (1000.0, "micrometres")])
    def test_other_units_show_by_the_targets_size(self, look, control_mm, factor: float, unit: str) -> None:
        camera = look((-400, -1000, 380))
        depth = camera.to_camera_axes(control_mm)[:, 2]
        sides = 36.0 * camera.lens.focal_px[0] / depth * 0.95
        with pytest.raises(DataError, match=unit):
            orient(
                camera.lens, camera.project(control_mm), control_mm * factor, names=NAMES, side_px=sides, side_mm=36.0
            )
        orient(camera.lens, camera.project(control_mm), control_mm, names=NAMES, side_px=sides, side_mm=36.0)

    def test_another_cameras_frame(self, look, control_mm, lens: Lens) -> None:
        camera = look((-400, -1000, 380))
        other = Lens(lens.image_size, (2600.0, 2600.0), (1700.0, 1400.0), (0.1, 0.0, 0.0, 0.0, 0.0))
        with pytest.raises(DataError, match="do not fit together"):
            orient(other, camera.project(control_mm), control_mm, names=NAMES, sd_image_px=0.05, sd_object_mm=0.1)

    def test_names_mixed_up(self, look, control_mm) -> None:
        camera = look((-400, -1000, 380))
        mixed = control_mm[[3, 5, 0, 7, 1, 6, 2, 4]]
        with pytest.raises(DataError, match=r"do not fit together|no camera position"):
            orient(camera.lens, camera.project(control_mm), mixed, names=NAMES, sd_image_px=0.05, sd_object_mm=0.1)
