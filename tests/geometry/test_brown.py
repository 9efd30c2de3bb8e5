from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.geometry.brown import BrownLens, forward_from_backward

CAMCAL = BrownLens(
    (2272, 1704),
    5.43764 / 1704,
    7.457,
    (3.61546, 2.61329),
    0.000389598,
    (0.00458861, -4.51351e-05, -2.05253e-06),
    (-6.12803e-05, -4.41172e-05),
)


def grid(size: tuple[int, int]) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0, size[0] - 1, 21), np.linspace(0, size[1] - 1, 17))
    return np.column_stack([x.ravel(), y.ravel()])


def test_distort_is_the_inverse_of_undistort() -> None:
    pixels = grid(CAMCAL.image_size)
    np.testing.assert_allclose(CAMCAL.distort(CAMCAL.undistort(pixels)), pixels, atol=1e-8)


def test_a_lens_without_distortion_is_a_pinhole() -> None:
    brown = BrownLens((1000, 800), 0.005, 10.0, (2.5, 2.0))
    lens, worst = forward_from_backward(brown)
    assert worst < 1e-9
    np.testing.assert_allclose(lens.focal_px, [2000, 2000])
    np.testing.assert_allclose(lens.principal_point_px, [499.5, 399.5])
    np.testing.assert_allclose(lens.distortion, 0, atol=1e-12)


def test_derivatives_agree_with_differences() -> None:
    rng = np.random.default_rng(6)
    pixels = rng.uniform(100, 1600, (12, 2))
    slopes = CAMCAL.undistort(pixels) + rng.normal(0, 1e-3, (12, 2))
    _, by_slope, by_interior = CAMCAL.linearise(pixels, slopes)
    for axis in range(2):
        step = 1e-6 * np.eye(2)[axis]
        numeric = CAMCAL.linearise(pixels, slopes + step)[0] - CAMCAL.linearise(pixels, slopes - step)[0]
        np.testing.assert_allclose(by_slope[:, :, axis], -numeric / 2e-6, rtol=1e-6, atol=1e-4)
    for column, value in enumerate(CAMCAL.parameters):
        change = np.zeros(9)
        change[column] = 1e-4 * abs(value)
        above = CAMCAL.with_parameters(CAMCAL.parameters + change).linearise(pixels, slopes)[0]
        below = CAMCAL.with_parameters(CAMCAL.parameters - change).linearise(pixels, slopes)[0]
        numeric = -(above - below) / (2 * change[column])
        np.testing.assert_allclose(by_interior[:, :, column], numeric, rtol=1e-5, atol=1e-5 * np.abs(numeric).max())


@settings(max_examples=15, deadline=None, derandomize=True)
@given(k1=st.floats(-0.12, 0.1), k2=st.floats(-0.05, 0.08), p=st.floats(-4e-5, 4e-5), affinity=st.floats(-1e-3, 1e-3))
def test_conversion_keeps_its_stated_misfit(k1: float, k2: float, p: float, affinity: float) -> None:
    """A lens of ordinary distortion keeps its rays within the stated misfit, and that is small."""
    brown = BrownLens((3872, 2592), 0.0061, 24.0, (11.85, 7.83), affinity, (k1 / 576, k2 / 576**2, 0.0), (p, -p))
    lens, worst = forward_from_backward(brown)
    assert worst < 0.3
    pixels = grid(brown.image_size)
    apart = np.abs(lens.distort(brown.undistort(pixels)) - pixels).max()
    assert apart <= worst + 0.02


def test_camcal_converts_with_its_misfit_stated() -> None:
    """116 px of distortion in the corners: two three-term polynomials differ by a third of a pixel there."""
    lens, worst = forward_from_backward(CAMCAL)
    assert 0.05 < worst < 0.4
    pixels = grid(CAMCAL.image_size)
    assert np.abs(lens.distort(CAMCAL.undistort(pixels)) - pixels).max() <= worst + 0.02


def test_nonsense_has_no_counterpart() -> None:
    wild = BrownLens((2272, 1704), 0.0032, 7.5, (3.6, 2.7), 0.0, (-0.9, 0.0, 0.0))
    with pytest.raises(DataError, match="no counterpart"):
        forward_from_backward(wild)
