"""Photon transfer, fixed pattern, clipping and compression."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdrivers.sim.sensor import D80_LEVELS, Sensor, nef_curve

QUIET = Sensor(prnu=0.0, hot=0.0)


@pytest.mark.parametrize("level", [50.0, 800.0, 3000.0])
def test_noise_is_photons_and_readout(level: float) -> None:
    counts = QUIET.expose(np.full((500, 600), level, np.float32), seed=1).astype(float)
    expected = level / 8.5 + (7.0 / 8.5) ** 2 + 1.0 / 12.0
    assert counts.mean() == pytest.approx(level, abs=4 * np.sqrt(expected / counts.size))
    assert counts.var() == pytest.approx(expected, rel=0.02)


def test_seed_decides_and_the_fixed_pattern_belongs_to_the_body() -> None:
    image = np.full((300, 300), 2000.0, np.float32)
    body = Sensor(hot=1e-3, serial=5)
    np.testing.assert_array_equal(body.expose(image, 1), body.expose(image, 1))
    mean = [np.mean([replace(body, serial=s).expose(image, k) for k in range(12)], axis=0) for s in (5, 5, 6)]
    again = np.mean([body.expose(image, 100 + k) for k in range(12)], axis=0)
    assert np.corrcoef(mean[0].ravel(), again.ravel())[0, 1] > 0.5
    assert abs(np.corrcoef(mean[0].ravel(), mean[2].ravel())[0, 1]) < 0.1


def test_blacks_and_whites_are_clipped() -> None:
    counts = QUIET.expose(np.array([[0.0, 9000.0]] * 200, np.float32).reshape(20, 20), 1)
    assert counts.min() == 0
    assert counts.max() == 4095
    lifted = replace(QUIET, black=200).expose(np.zeros((50, 50), np.float32), 1)
    assert lifted.mean() == pytest.approx(200.0, abs=0.2)


def test_compressed_nef_has_683_levels_finer_than_photon_noise() -> None:
    curve = nef_curve(4095)
    levels = np.unique(curve)
    assert levels.size == D80_LEVELS
    assert levels[0] == 0
    assert levels[-1] == 4095
    assert np.all(np.diff(levels) <= np.maximum(1.0, np.sqrt(levels[1:] / 8.5 + 0.68)))
    error = np.abs(curve.astype(int) - np.arange(4096))
    assert error.max() <= np.diff(levels).max() / 2


def test_mosaic_patterns() -> None:
    assert [Sensor("GBRG").colour(r, c) for r in (0, 1) for c in (0, 1)] == [1, 2, 0, 1]
    assert Sensor("GRAY").gain(0) == 1.0
