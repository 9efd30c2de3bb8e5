"""The Cramér–Rao bound against cases that can be worked out, and against a dense computation."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.bench.bound import PX_PER_MM, BoundTable, ImageNoise, _Covariance, motion_bound_mm
from labdaemon.bench.simulator import renderer

SMALL = 3.0


def test_less_light_and_more_noise_raise_it_as_they_must() -> None:
    render = renderer()
    plain = ImageNoise(texture=0.0, read_noise_e=0.0)
    bright = motion_bound_mm(render, SMALL, 0.5, plain)[0]
    dim = motion_bound_mm(render, SMALL, 0.5, ImageNoise(white_dn=725.0, texture=0.0, read_noise_e=0.0))[0]
    assert dim / bright == pytest.approx(2.0, rel=1e-3), "photons count by their square root"
    assert motion_bound_mm(render, SMALL, 0.5, ImageNoise(texture=0.0))[0] > bright
    assert motion_bound_mm(render, SMALL, 0.5, ImageNoise(texture=0.004))[0] > bright


def test_below_a_pixel_it_grows_as_one_over_the_amplitude() -> None:
    render, light = renderer(), ImageNoise(texture=0.0)
    low, high = (motion_bound_mm(render, SMALL, a, light)[0] for a in (0.05, 0.1))
    assert low / high == pytest.approx(2.0, rel=0.05), "only the square of the amplitude shows"


def test_it_is_of_the_size_that_edges_allow() -> None:
    """One pixel of motion of an 8 mm dot: some hundredths of a pixel at most, some thousandths at least."""
    bound_px = motion_bound_mm(renderer(), 8.0, 0.5, ImageNoise())[0] * PX_PER_MM
    assert 0.003 < bound_px < 0.01


def test_the_covariance_is_inverted() -> None:
    rng = np.random.default_rng(4)
    middle = rng.uniform(500.0, 2900.0, (14, 17))
    light = ImageNoise(texture=0.05, texture_length_mm=0.5)
    covariance = _Covariance(middle, light, np.array([2.0, 1.0]))
    dense = np.stack([covariance.times(unit.reshape(middle.shape)).ravel() for unit in np.eye(middle.size)], axis=1)
    np.testing.assert_allclose(dense, dense.T, rtol=1e-9, atol=1e-9 * np.abs(dense).max())
    assert np.linalg.eigvalsh(dense)[0] > 0
    right = rng.normal(size=middle.shape)
    expected = np.linalg.solve(dense, right.ravel())
    np.testing.assert_allclose(covariance.solve(right).ravel(), expected, rtol=1e-5, atol=1e-7)


def test_table_interpolates() -> None:
    across = {8.0: np.array([0.001, 0.001, 0.001])}
    table = BoundTable(np.array([0.1, 1.0, 10.0]), {8.0: np.array([0.01, 0.001, 0.004])}, across)
    assert table.at(8.0, 1.0) == pytest.approx(0.001)
    assert table.at(8.0, 10.0**0.5) == pytest.approx(0.002)
    assert table.direction_deg(8.0, 1.0) == pytest.approx(np.degrees(0.001), rel=1e-5)


def test_direction_is_seen_only_as_far_as_the_target_moves() -> None:
    render, light = renderer(), ImageNoise(texture=0.0)
    turn = [motion_bound_mm(render, SMALL, a, light)[1] / a for a in (0.1, 0.5, 2.0)]
    assert turn[0] > 4 * turn[1] > 4 * turn[2]
