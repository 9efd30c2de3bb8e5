"""Diffraction against the textbook's Airy pattern and Hopkins' defocus."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j1

from labdrivers.sim.optics import Optics, _pupil_curve


def test_point_spread_is_an_airy_pattern() -> None:
    grid, curve = _pupil_curve(0.0)
    # Hankel transform of the OTF at radius r (in units of wavelength times f-number), by quadrature
    radii = np.array([0.05, 0.4, 0.9, 1.22, 1.6, 2.3])
    angle = np.linspace(0.0, 2.0 * np.pi, 721)[:-1]
    spread = []
    for radius in radii:
        ring = np.cos(2.0 * np.pi * radius * grid[:, None] * np.cos(angle)[None, :]).mean(axis=1)
        spread.append(np.trapezoid(curve * ring * 2.0 * np.pi * grid, grid))
    airy = np.pi / 4.0 * (2.0 * j1(np.pi * radii) / (np.pi * radii)) ** 2
    np.testing.assert_allclose(spread, airy, atol=2e-5)


def test_defocus_agrees_with_the_pupils_autocorrelation() -> None:
    waves, size = 0.3, 512
    y, x = np.mgrid[-size : size + 1, -size : size + 1] / (size / 2)
    pupil = np.where(np.hypot(x, y) <= 1.0, np.exp(2j * np.pi * waves * (x**2 + y**2)), 0.0)
    spectrum = np.fft.fft2(pupil, (4 * size, 4 * size))
    correlation = np.fft.ifft2(np.abs(spectrum) ** 2)
    lag = (np.array([0.2, 0.5, 0.8]) * size).astype(int)  # two radii are the cut-off
    expected = (correlation[0, lag] / correlation[0, 0]).real
    grid, curve = _pupil_curve(waves)
    np.testing.assert_allclose(np.interp(lag / size, grid, curve), expected, atol=3e-3)


@pytest.mark.parametrize("kind", ["airy", "gaussian"])
def test_all_light_arrives(kind: str) -> None:
    optics = Optics(kind)  # type: ignore[arg-type]
    for colour in range(3):
        assert optics.transfer(np.zeros(1), colour)[0] == pytest.approx(1.0, abs=1e-6)


def test_f32_blurs_a_d80_by_more_than_a_pixel_and_red_most() -> None:
    optics = Optics()
    # the curvature at low frequency of a diffraction OTF is a cusp; compare the frequency of half modulation instead
    f = np.linspace(0.0, 0.5, 5001)
    half = [float(f[np.argmin(np.abs(optics.transfer(f, c) - 0.5))]) for c in range(3)]
    sigma = np.sqrt(np.log(2.0) / 2.0) / np.pi / np.array(half)
    assert sigma[0] > sigma[1] > sigma[2]
    assert 1.0 < sigma[2] < 1.25
    assert 1.35 < sigma[0] < 1.65
    assert optics.cutoff_per_px() is not None
