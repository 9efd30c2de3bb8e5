from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.geometry.bundle import adjust_network
from labdaemon.geometry.network import Network, Pose
from labdaemon.geometry.reliability import adjust_without_gross_errors, compute_observation_tests, find_gross_error

NAMES = tuple(f"P{i:02d}" for i in range(24))


@pytest.fixture
def clean(look) -> Network:
    rng = np.random.default_rng(31)
    cameras = [look(p, roll=0.4 * i) for i, p in enumerate([(-500, -1000, 300), (500, -1000, 500), (0, -1100, 900)])]
    true = rng.uniform([-200, -100, 100], [200, 100, 650], (24, 3))
    pixels = np.concatenate([camera.project(true) for camera in cameras])
    survey = np.full(true.shape, np.inf)
    survey[:8] = 0.2
    return Network(
        (cameras[0].lens,),
        tuple(Pose(v.rotation, v.position_mm) for v in cameras),
        np.zeros(3, dtype=np.intp),
        true + np.where(np.isfinite(survey), rng.normal(0, 0.2, true.shape), 0.5),
        np.repeat(np.arange(3), 24),
        np.tile(np.arange(24), 3),
        pixels + rng.normal(0, 0.05, pixels.shape),
        0.05,
        survey,
    )


def test_a_clean_network_loses_nothing(clean: Network) -> None:
    adjustment, names, errors = adjust_without_gross_errors(clean, NAMES)
    assert errors == []
    assert names == NAMES
    tests = compute_observation_tests(adjustment)
    # Redundancies of all observations add up to the degrees of freedom; survey takes what observations leave.
    assert 2 * tests.redundancy.sum() < adjustment.degrees_of_freedom
    assert np.all(tests.detectable_px > 0.2)


def test_a_misread_sighting_is_named(clean: Network) -> None:
    pixels = clean.image_px.copy()
    pixels[24 + 13] += [1.2, -0.9]
    adjustment, _, errors = adjust_without_gross_errors(replace(clean, image_px=pixels), NAMES)
    assert [(e.kind, e.point, e.image) for e in errors] == [("observation", "P13", 1)]
    assert errors[0].size == pytest.approx(1.5, rel=0.4)
    assert adjustment.sigma0 == pytest.approx(1.0, abs=0.25)


def test_a_mis_surveyed_point_is_named(clean: Network) -> None:
    points = clean.points.copy()
    points[5] += [3.0, 0.0, -2.0]
    adjustment, _, errors = adjust_without_gross_errors(replace(clean, points=points), NAMES)
    assert [(e.kind, e.point) for e in errors] == [("survey", "P05")]
    assert errors[0].size == pytest.approx(np.hypot(3, 2), rel=0.3)
    assert np.abs(adjustment.network.points[5] - points[5]).max() > 1.5


def test_several_errors_are_named_one_after_the_other(clean: Network) -> None:
    pixels, points = clean.image_px.copy(), clean.points.copy()
    pixels[4] += [-2.0, 3.0]
    pixels[48 + 20] += [0.0, 4.0]
    points[2] += [0.0, 5.0, 0.0]
    _, _, errors = adjust_without_gross_errors(replace(clean, image_px=pixels, points=points), NAMES)
    assert {(e.kind, e.point) for e in errors} == {("observation", "P04"), ("observation", "P20"), ("survey", "P02")}


def test_a_point_left_with_one_ray_goes(clean: Network) -> None:
    keep = ~((clean.point == 20) & (clean.image == 2))
    pixels = clean.image_px.copy()
    pixels[20] += [30.0, -20.0]
    network = replace(clean, point=clean.point[keep], image=clean.image[keep], image_px=pixels[keep])
    _, names, errors = adjust_without_gross_errors(network, NAMES)
    assert {e.point for e in errors} == {"P20"}
    assert names == tuple(n for n in NAMES if n != "P20")


def test_optimistic_pixels_do_not_cost_observations(clean: Network) -> None:
    """Weights stated five times too high are no gross errors."""
    adjustment = adjust_network(replace(clean, sd_px=0.01))
    assert find_gross_error(adjustment, NAMES) is None or adjustment.sigma0 < 3
    _, _, errors = adjust_without_gross_errors(replace(clean, sd_px=0.02), NAMES)
    assert errors == []
