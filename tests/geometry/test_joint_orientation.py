from __future__ import annotations

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry import ControlPoint, ImageMotion, ImageObservation, intersect_motion, orient_jointly
from labdaemon.geometry.harmonic import project_motion

SD_MM, SD_TAG_PX, SD_DOT_PX = 0.3, 0.05, 0.02


def scene(look, control_mm, rng, *, ties: int = 10, wrong_tie: bool = False):
    places = {"left": (-500, -1000, 300), "right": (500, -1000, 500)}
    cameras = {name: look(np.array(p) + rng.normal(0, 40, 3), roll=0.1) for name, p in places.items()}
    tie_mm = rng.uniform([-150, -60, 150], [150, 60, 600], (ties, 3))
    observations = {}
    for name, camera in cameras.items():
        tags = camera.project(control_mm) + rng.normal(0, SD_TAG_PX, (len(control_mm), 2))
        dots = camera.project(tie_mm) + rng.normal(0, SD_DOT_PX, (ties, 2))
        if wrong_tie and name == "right":
            dots[3] = camera.project(tie_mm[3:4] + np.array([0.0, 0.0, 25.0]))[0]
        observations[name] = [ImageObservation(str(i), x, y, SD_TAG_PX) for i, (x, y) in enumerate(tags)]
        observations[name] += [ImageObservation(f"T{i}", x, y, SD_DOT_PX) for i, (x, y) in enumerate(dots)]
    survey = [
        ControlPoint(str(i), place, SD_MM)
        for i, place in enumerate(control_mm + rng.normal(0, SD_MM, control_mm.shape))
    ]
    return cameras, observations, survey, tie_mm


def test_cameras_agree_to_the_pixel_and_the_covariance_says_so(look, control_mm, lens) -> None:
    """A survey good to 0.3 mm (about a pixel): joined positions carry it, the residuals between cameras do not."""
    rng = np.random.default_rng(17)
    pulls, misses = [], []
    for _ in range(30):
        cameras, observations, survey, _ = scene(look, control_mm, rng)
        together = orient_jointly(dict.fromkeys(cameras, lens), observations, survey)
        assert together.sigma0 == pytest.approx(1.0, abs=0.5)
        mean, a = rng.uniform([-150, -60, 150], [150, 60, 600]), np.array([3.0, 0.8, 0.2])
        seen = []
        for camera in cameras.values():
            numbers = project_motion(camera.project_with_jacobians, np.stack([mean, a, 0 * a]))[0]
            numbers[:4] += rng.normal(0, 0.01, 4)
            seen.append(ImageMotion(numbers[:2], numbers[2:4], numbers[4:], np.eye(6) * 1e-4))
        oriented = list(together.cameras.values())
        motion = intersect_motion(oriented, seen, covariance=together.covariance).motion
        assert not motion.flags
        sd = np.sqrt(np.diag(motion.covariance_mm2))
        pulls.append([*((motion.a_mm - a) / sd[3:6]), *((motion.mean_mm - mean) / sd[:3])])
        misses.append(
            [np.hypot(*(v.project(motion.mean_mm[None])[0] - s.mean_px)) for v, s in zip(oriented, seen, strict=True)]
        )
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((spread > 0.7) & (spread < 1.35)), spread
    assert np.median(misses) < 0.1


def test_a_mis_surveyed_target_is_distinguished_from_a_misread_one(look, control_mm, lens) -> None:
    rng = np.random.default_rng(3)
    cameras, observations, survey, _ = scene(look, control_mm, rng)
    lenses = dict.fromkeys(cameras, lens)
    moved = [*survey]
    moved[4] = ControlPoint("4", survey[4].position_mm + np.array([0.0, 7.0, -6.0]), SD_MM)
    together = orient_jointly(lenses, observations, moved)
    assert list(together.excluded) == ["4"]
    assert "mis-surveyed: the cameras see it" in together.excluded["4"]
    np.testing.assert_allclose(together.points["4"], control_mm[4], atol=1.5)
    misread = dict(observations)
    first = observations["left"][2]
    misread["left"] = [*observations["left"][:2], ImageObservation("2", first.x_px + 25, first.y_px - 8, SD_TAG_PX)]
    misread["left"] += observations["left"][3:]
    together = orient_jointly(lenses, misread, survey)
    assert list(together.excluded) == ["2"]
    assert together.excluded["2"].startswith("left: ")


def test_a_misidentified_tie_is_named(look, control_mm, lens) -> None:
    rng = np.random.default_rng(4)
    cameras, observations, survey, _ = scene(look, control_mm, rng, wrong_tie=True)
    together = orient_jointly(dict.fromkeys(cameras, lens), observations, survey)
    assert list(together.excluded) == ["T3"]
    assert "T3" not in together.points
    assert "misidentified" in together.excluded["T3"]


def test_ties_come_back_where_they_are(look, control_mm, lens) -> None:
    rng = np.random.default_rng(5)
    cameras, observations, survey, tie_mm = scene(look, control_mm, rng)
    together = orient_jointly(dict.fromkeys(cameras, lens), observations, survey)
    found = np.stack([together.points[f"T{i}"] for i in range(len(tie_mm))])
    assert np.abs(found - tie_mm).max() < 1.0


def test_bad_input_names_the_camera(look, control_mm, lens) -> None:
    rng = np.random.default_rng(6)
    cameras, observations, survey, _ = scene(look, control_mm, rng)
    lenses = dict.fromkeys(cameras, lens)
    few = {**observations, "right": observations["right"][:3]}
    with pytest.raises(DataError, match=r"camera right: 3 surveyed control targets"):
        orient_jointly(lenses, few, survey)
    with pytest.raises(DataError, match="more than once"):
        orient_jointly(lenses, observations, [*survey, survey[2]])
    with pytest.raises(DataError, match="camera left: control target 0 is there more than once"):
        orient_jointly(lenses, {**observations, "left": [*observations["left"], observations["left"][0]]}, survey)
    metres = [ControlPoint(p.name, p.position_mm / 1000, p.sd_mm / 1000) for p in survey]
    with pytest.raises(DataError, match="metres"):
        orient_jointly(lenses, observations, metres)
    flat = [ControlPoint(p.name, p.position_mm * [1, 0, 1], p.sd_mm) for p in survey]
    with pytest.raises(DataError, match="all lie in a plane"):
        orient_jointly(lenses, observations, flat)


def test_control_that_is_held_fixed(look, control_mm, lens) -> None:
    """A survey of standard deviation 0 does not move; the cameras answer for the residuals."""
    rng = np.random.default_rng(8)
    cameras, observations, _, _ = scene(look, control_mm, rng)
    survey = [ControlPoint(str(i), place, 0.0) for i, place in enumerate(control_mm)]
    together = orient_jointly(dict.fromkeys(cameras, lens), observations, survey)
    np.testing.assert_array_equal(together.points["3"], control_mm[3])
    sd = np.sqrt(np.diag(together.covariance))
    for i, (name, camera) in enumerate(cameras.items()):
        error = together.cameras[name].position_mm - camera.position_mm
        assert np.all(np.abs(error) < 4 * sd[6 * i + 3 : 6 * i + 6])


def test_one_camera_is_oriented_too(look, control_mm, lens) -> None:
    rng = np.random.default_rng(9)
    cameras, observations, survey, _ = scene(look, control_mm, rng)
    together = orient_jointly({"left": lens}, {"left": observations["left"]}, survey)
    assert list(together.cameras) == ["left"]
    assert together.covariance.shape == (6, 6)
    sd = np.sqrt(np.diag(together.covariance))[3:]
    assert np.all(np.abs(together.cameras["left"].position_mm - cameras["left"].position_mm) < 4 * sd)
