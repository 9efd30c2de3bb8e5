from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.brown import forward_from_backward
from labdaemon.geometry.bundle import adjust_network
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.network import Network, Pose, ScaleBar
from labdaemon.geometry.photomodeler_export import read_photomodeler

PLACES = [(-500, -1000, 300), (500, -1000, 500), (0, -1100, 900), (-100, -900, 100)]


def rig(look, rng, *, points: int = 30, sd_px: float = 0.05, control: int = 6, sd_mm: float = 0.3, noise: bool = True):
    """A network of four cameras, true points, and starting values that are off."""
    cameras = [look(place, roll=0.7 * i) for i, place in enumerate(PLACES)]
    true = rng.uniform([-200, -100, 100], [200, 100, 650], (points, 3))
    image = np.repeat(np.arange(len(cameras)), points)
    point = np.tile(np.arange(points), len(cameras))
    pixels = np.concatenate([camera.project(true) for camera in cameras])
    pixels = pixels + noise * rng.normal(0, sd_px, pixels.shape)
    start = true + noise * rng.normal(0, 2, true.shape)
    survey = np.full(true.shape, np.inf)
    survey[:control] = sd_mm
    start[:control] = true[:control] + noise * rng.normal(0, sd_mm, (control, 3))
    off = [camera.apply_change(noise * rng.normal(0, 1, 6) * [1e-3, 1e-3, 1e-3, 3, 3, 3]) for camera in cameras]
    poses = tuple(Pose(v.rotation, v.position_mm) for v in off)
    network = Network(
        (cameras[0].lens,), poses, np.zeros(len(cameras), dtype=np.intp), start, image, point, pixels, sd_px, survey
    )
    return network, true, cameras


@pytest.fixture(scope="module")
def camcal(shared_data: Path) -> Network:
    folder = shared_data / "camcal"
    project = read_photomodeler((folder / "camcal-pmexport.txt").read_text())
    points, sd = project.points.copy(), np.full(project.points.shape, np.inf)
    for line in (folder / "camcal-fixed.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            name, _, *numbers = line.split(",")
            index = project.point_ids.index(int(name))
            points[index], sd[index] = [float(n) for n in numbers], 0.0
    every = (np.ones(9, dtype=np.bool_),)
    return Network(
        (project.lens,),
        project.poses,
        np.zeros(len(project.poses), dtype=np.intp),
        points,
        project.image,
        project.point,
        project.image_px,
        1.0,
        sd,
        free_interior=every,
    )


def digits(value: float, published: float, text_digits: int = 6) -> bool:
    """Equal when rounded to the digits that were published."""
    return float(f"{value:.{text_digits}g}") == pytest.approx(published, rel=0.51 * 10 ** (1 - text_digits))


def test_camcal_gives_the_published_adjustment(camcal: Network, shared_data: Path) -> None:
    """Self-calibration in Brown's backward model against DBAT's report, to the digits given there."""
    published = json.loads((shared_data / "camcal/published.json").read_text())["published"]
    started = time.thread_time()
    result = adjust_network(camcal)
    took = time.thread_time() - started
    assert result.observations == 4148
    assert result.unknowns == 423
    assert result.degrees_of_freedom == published["redundancy"] == 3725
    assert round(result.sigma0, 5) == published["sigma0_px"] == 0.16148
    for value, expected in zip(
        result.network.lenses[0].parameters, published["io_c_px_py_as_K1_K2_K3_P1_P2_mm"], strict=True
    ):
        assert digits(value, expected), (value, expected)
    # Standard deviations as in the report's camera section, three digits.
    report = [0.00105, 0.00082, 0.00098, 2.08e-05, 2.21e-05, 2.65e-06, 1.01e-07, 3.52e-06, 3.94e-06]
    for value, expected in zip(result.interior_sd(), report, strict=True):
        assert digits(value, expected, 3), (value, expected)
    assert took < 60  # of its own time: others on the machine do not count


def test_camcal_gives_the_published_exteriors_and_points(camcal: Network, shared_data: Path) -> None:
    result = adjust_network(camcal)
    lines = (shared_data / "camcal/camcal-dbatreport.txt").read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if "Photo 1:" in line)
    values = [float(line.split()[1]) for line in lines[first : first + 19] if "Value" in line]
    deviations = [float(line.split()[1]) for line in lines[first : first + 19] if "Deviation" in line]
    np.testing.assert_allclose(result.network.poses[0].position, values[3:], atol=0.6e-6)
    start = result.interior_count
    sd = np.sqrt(np.diag(result.cofactor))[start + 3 : start + 6] * result.sigma0
    np.testing.assert_allclose(sd, deviations[3:], rtol=0.01)
    # The report's largest point standard deviations: 5e-05, 5.3e-05, 8.5e-05 m.
    spread = np.sqrt(np.einsum("pii->pi", result.point_covariance())).max(axis=0)
    np.testing.assert_allclose(spread, [5e-5, 5.3e-5, 8.5e-5], rtol=0.02)


def test_camcal_in_opencvs_model(camcal: Network) -> None:
    lens, _ = forward_from_backward(camcal.lenses[0])  # type: ignore[arg-type]
    result = adjust_network(replace(camcal, lenses=(lens,)))
    assert result.sigma0 == pytest.approx(0.155, abs=0.002)
    assert result.degrees_of_freedom == 3725


def test_exact_observations_give_exact_numbers(look) -> None:
    network, true, cameras = rig(look, np.random.default_rng(0), noise=False)
    start = replace(network, points=np.where(np.isfinite(network.survey_sd), true, true + 3.0))
    result = adjust_network(start)
    np.testing.assert_allclose(result.network.points, true, atol=1e-6)
    np.testing.assert_allclose(result.network.poses[0].position, cameras[0].position_mm, atol=1e-6)
    assert result.sigma0 < 1e-5


def test_covariance_is_true_and_agrees_with_a_dense_inverse(look) -> None:
    """Pulls of points and cameras over many realisations; the Schur complement against the whole normal matrix."""
    rng = np.random.default_rng(13)
    pulls, camera_pulls, sigmas = [], [], []
    for _ in range(40):
        network, true, cameras = rig(look, rng, points=16)
        result = adjust_network(network)
        sigmas.append(result.sigma0)
        sd = np.sqrt(np.einsum("pii->pi", result.point_covariance(scaled=False)))
        pulls.append((result.network.points - true) / sd)
        sd = np.sqrt(np.diag(result.exterior_covariance(scaled=False)))[3:6]
        camera_pulls.append((result.network.poses[0].position - cameras[0].position_mm) / sd)
    assert np.mean(sigmas) == pytest.approx(1.0, abs=0.03)
    spread = np.sqrt(np.mean(np.square(pulls), axis=(0, 1)))
    assert np.all((spread > 0.8) & (spread < 1.3)), spread
    spread = np.std(camera_pulls, axis=0)
    assert np.all((spread > 0.7) & (spread < 1.4)), spread
    _compare_with_dense(result)


def _compare_with_dense(result) -> None:
    linear, network = result._linear, result.network
    count, points = len(network.image), len(network.points)
    k = linear.by_camera.shape[1]
    design = np.zeros((2 * count, k + 3 * points))
    design[:, :k] = linear.by_camera.toarray()
    for i in range(count):
        start = k + 3 * network.point[i]
        design[2 * i : 2 * i + 2, start : start + 3] = linear.by_point[i]
    normal = design.T @ (np.repeat(network.weights, 2)[:, None] * design)
    normal[np.arange(k, k + 3 * points), np.arange(k, k + 3 * points)] += linear.survey_weights.ravel()
    scale = 1 / np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    np.testing.assert_allclose(result.cofactor, inverse[:k, :k], rtol=1e-6, atol=1e-18)
    fitted = np.einsum("ij,jk,ik->i", design, inverse, design)
    np.testing.assert_allclose(np.einsum("nii->ni", result.fitted_cofactor()).ravel(), fitted, rtol=1e-6)


def test_free_network_with_scale_bars(look) -> None:
    """Inner constraints: the same residuals and shape as any datum gives, the smallest covariance, scale from bars."""
    rng = np.random.default_rng(2)
    network, true, _ = rig(look, rng, control=0)
    bars = tuple(
        ScaleBar(i, j, float(np.linalg.norm(true[i] - true[j])) + rng.normal(0, 0.02), 0.02)
        for i, j in ((0, 1), (2, 3), (4, 5))
    )
    free = adjust_network(replace(network, control_sd=None, bars=bars, datum=True))
    assert free.degrees_of_freedom == 2 * len(network.image) + 3 - 3 * 30 - 6 * 4 + 6
    ratio = [
        np.linalg.norm(free.network.points[i] - free.network.points[j]) / np.linalg.norm(true[i] - true[j])
        for i in range(30)
        for j in range(i)
        if np.linalg.norm(true[i] - true[j]) > 200
    ]
    assert np.mean(ratio) == pytest.approx(1.0, abs=2e-4)
    # Datum: neither shifted nor turned from the starting values.
    np.testing.assert_allclose((free.network.points - network.points).mean(axis=0), 0, atol=1e-3)
    minimal = np.full(true.shape, np.inf)
    minimal[0], minimal[1, :2], minimal[2, 0] = 0.0, 0.0, 0.0
    other = adjust_network(replace(network, control_sd=minimal, bars=bars))
    assert other.degrees_of_freedom == free.degrees_of_freedom
    assert other.sigma0 == pytest.approx(free.sigma0, rel=1e-6)
    np.testing.assert_allclose(other.residuals_px, free.residuals_px, atol=1e-5)
    total = [np.einsum("pii->", a.point_covariance(scaled=False)) for a in (free, other)]
    assert total[0] < total[1]


def test_free_network_without_scale_keeps_the_starting_scale(look) -> None:
    network, true, _ = rig(look, np.random.default_rng(2), control=0)
    free = adjust_network(replace(network, control_sd=None, datum=True, points=true))
    assert free.degrees_of_freedom == 2 * len(network.image) - 3 * 30 - 6 * 4 + 7
    size = np.linalg.norm(free.network.points - free.network.points.mean(axis=0))
    assert size == pytest.approx(np.linalg.norm(true - true.mean(axis=0)), rel=1e-5)


def test_interior_parameters_come_back(look, lens: Lens) -> None:
    """Self-calibration from eight images, half of them rolled."""
    rng = np.random.default_rng(4)
    places = [(x, y, z) for x in (-600, 500) for y in (-1000, -800) for z in (150, 650)]
    cameras = [look(place, roll=1.57 * (i % 2)) for i, place in enumerate(places)]
    true = rng.uniform([-350, -150, 50], [350, 150, 700], (120, 3))
    entries = []
    for i, camera in enumerate(cameras):
        pixels = camera.project(true)
        entries += [(i, j, pixels[j]) for j in np.flatnonzero(lens.contains(pixels)).tolist()]
    survey = np.full(true.shape, np.inf)
    survey[:10] = 0.05
    start = replace(lens, focal_px=(3900.0, 3900.0), principal_point_px=(1935.5, 1295.5), distortion=(0.0,) * 5)
    network = Network(
        (start,),
        tuple(Pose(v.rotation, v.position_mm) for v in cameras),
        np.zeros(len(cameras), dtype=np.intp),
        true + np.where(np.isfinite(survey), rng.normal(0, 0.05, true.shape), 1.0),
        np.array([e[0] for e in entries]),
        np.array([e[1] for e in entries]),
        np.array([e[2] for e in entries]) + rng.normal(0, 0.05, (len(entries), 2)),
        0.05,
        survey,
        free_interior=(np.ones(9, dtype=np.bool_),),
    )
    result = adjust_network(network)
    pulls = (result.network.lenses[0].parameters - lens.parameters) / result.interior_sd()
    assert np.all(np.abs(pulls) < 3.5), pulls
    assert result.sigma0 == pytest.approx(1.0, abs=0.06)
    only_focal = adjust_network(replace(network, lenses=(lens,), free_interior=(np.arange(9) < 2,)))
    assert only_focal.network.lenses[0].parameters[4] == lens.distortion[0]
    assert np.all(only_focal.interior_sd()[2:] == 0)


class TestBadInput:
    def test_a_point_seen_once(self, look) -> None:
        network, _, _ = rig(look, np.random.default_rng(0))
        keep = ~((network.point == 20) & (network.image > 0))
        lonely = replace(network, point=network.point[keep], image=network.image[keep], image_px=network.image_px[keep])
        names = [f"T{i:02d}" for i in range(30)]
        with pytest.raises(DataError, match=r"fewer than two images.*T20"):
            adjust_network(lonely, names=names)

    def test_no_datum(self, look) -> None:
        network, _, _ = rig(look, np.random.default_rng(0), control=0)
        with pytest.raises(DataError, match="neither control points nor a free network"):
            adjust_network(network)

    def test_unknowns_that_the_pictures_do_not_fix(self, look) -> None:
        """One image of a plane does not separate focal length and distance."""
        camera = look((0, -1000, 370))
        flat = np.array([[x, 0.0, z] for x in (-200.0, 0.0, 200.0) for z in (200.0, 400.0, 600.0)])
        network = Network(
            (camera.lens,),
            (Pose(camera.rotation, camera.position_mm),),
            np.zeros(1, dtype=np.intp),
            flat,
            np.zeros(9, dtype=np.intp),
            np.arange(9),
            camera.project(flat),
            0.05,
            np.zeros(flat.shape),
            free_interior=(np.ones(9, dtype=np.bool_),),
        )
        with pytest.raises(DataError, match=r"do not determine|more images|did not converge"):
            adjust_network(network)


@pytest.mark.slow
def test_a_whole_campaign_in_one_adjustment(look) -> None:
    """200 targets, 4 cameras, 20 captures: both ends of every target, under 30 s on one core."""
    rng = np.random.default_rng(9)
    cameras = [look(place, roll=0.3 * i) for i, place in enumerate(PLACES)]
    targets, control = rng.uniform([-200, -100, 100], [200, 100, 700], (200, 3)), rng.uniform(-300, 300, (16, 3))
    control = control * [1, 0.5, 1] + [0, 0, 380]
    true = [control]
    for _ in range(20):
        a = rng.normal(0, 2, (200, 3))
        true += [targets + a, targets - a]
    true = np.concatenate(true)
    image, point, pixels, poses = [], [], [], []
    for capture in range(20):
        for camera in cameras:
            moved = camera.apply_change(rng.normal(0, 1e-4, 6))  # every frame has its own orientation
            seen = np.concatenate([np.arange(16), 16 + capture * 400 + np.arange(400)])
            image.append(np.full(len(seen), len(poses)))
            point.append(seen)
            pixels.append(moved.project(true[seen]) + rng.normal(0, 0.02, (len(seen), 2)))
            poses.append(Pose(camera.rotation, camera.position_mm))
    survey = np.full(true.shape, np.inf)
    survey[:16] = 0.3
    start = true + np.where(np.isfinite(survey), rng.normal(0, 0.3, true.shape), rng.normal(0, 1.0, true.shape))
    network = Network(
        (cameras[0].lens,),
        tuple(poses),
        np.zeros(len(poses), dtype=np.intp),
        start,
        np.concatenate(image),
        np.concatenate(point),
        np.concatenate(pixels),
        0.02,
        survey,
    )
    started = time.thread_time()
    result = adjust_network(network)
    covariance = result.point_covariance()
    took = time.thread_time() - started
    assert took < 30
    assert result.sigma0 == pytest.approx(1.0, abs=0.02)
    ends = result.network.points[16:].reshape(20, 2, 200, 3)
    vectors = (ends[:, 0] - ends[:, 1]) / 2
    wanted = true[16:].reshape(20, 2, 200, 3)
    error = vectors - (wanted[:, 0] - wanted[:, 1]) / 2
    assert np.quantile(np.linalg.norm(error, axis=-1), 0.95) < 0.05
    assert np.all(np.einsum("pii->pi", covariance) > 0)
