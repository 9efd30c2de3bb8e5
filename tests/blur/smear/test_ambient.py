"""Ambient light as a parameter: its derivative, its prior, and what it costs."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.blur import ExposureWindow, LightCode, named_code
from labdaemon.blur.smear.frame_set import ambient_transfer, window_orbit_transfer
from labdaemon.blur.waveform import light_parts, window_nodes
from labdaemon.errors import UsageError

MOTION = np.array([1.3, -0.4, 0.6, 0.9])
F = np.meshgrid(np.linspace(-0.2, 0.2, 5), np.linspace(-0.2, 0.2, 4))


def window(ambient: float) -> ExposureWindow:
    return ExposureWindow(5.0, 1.0, light=LightCode(named_code("1110100"), 0.3, 4, ambient))


@pytest.mark.parametrize("ambient", [0.0, 0.4])
def test_the_correction_is_what_the_light_says(ambient: float) -> None:
    corrected = ambient_transfer(window(ambient), window_orbit_transfer, 4.0)
    stated = window_orbit_transfer(*window_nodes(window(ambient + 0.2), 4.0))
    transfer, slopes = corrected(*F, np.concatenate(([0.2], MOTION)))
    expected, by_motion = stated(*F, MOTION)
    np.testing.assert_allclose(transfer, expected, atol=1e-10)
    np.testing.assert_allclose(slopes[1:], by_motion, atol=1e-9)


def test_its_derivative_is_that_of_the_transfer_function() -> None:
    transfer = ambient_transfer(window(0.3), window_orbit_transfer, 4.0)
    up, down = (transfer(*F, np.concatenate(([step], MOTION)))[0] for step in (1e-5, -1e-5))
    slope = transfer(*F, np.concatenate(([0.0], MOTION)))[1][0]
    np.testing.assert_allclose(slope, (up - down) / 2e-5, atol=1e-8)


def test_constant_light_has_no_ambient_part() -> None:
    plain = ExposureWindow(5.5, 1.0, 0.2)
    transfer, slopes = ambient_transfer(plain, window_orbit_transfer, 4.0)(*F, np.concatenate(([0.5], MOTION)))
    expected, _ = window_orbit_transfer(*window_nodes(plain, 4.0))(*F, MOTION)
    np.testing.assert_allclose(transfer, expected)
    assert not slopes[0].any()
    with pytest.raises(UsageError):
        light_parts(plain, 4.0)
