"""Read noise and photon gain from the images themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.patch.noise import estimate_noise
from labdaemon.blur.patch.pixels import NoiseModel, Patch


def patch(read_dn: float, gain_dn: float, *, bayer: bool = False, seed: int = 1, size: int = 90) -> Patch:
    """A soft dark disc on paper with a gradient, and noise of a known model."""
    y, x = np.mgrid[0:size, 0:size].astype(float)
    signal = 1800.0 - 1600.0 / (1.0 + np.exp((np.hypot(x - size / 2, y - size / 2) - size / 4) / 2.0)) + 2.0 * x
    channel = np.zeros((size, size), np.uint8)
    if bayer:
        channel[::2, 1::2], channel[1::2, ::2], channel[1::2, 1::2] = 1, 2, 3
        signal = signal * np.array([0.6, 1.0, 1.0, 0.7])[channel]
    sd = np.sqrt(read_dn**2 + gain_dn * signal)
    values = signal + sd * np.random.default_rng(seed).normal(size=signal.shape)
    return Patch(values, channel, np.ones(signal.shape, dtype=bool), (0, 0))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(read=st.floats(2.0, 15.0), gain=st.floats(0.05, 1.0), bayer=st.booleans())
def test_the_model_is_found_where_it_matters(read: float, gain: float, bayer: bool) -> None:
    """Read noise and gain are each less sure than the noise that both make at the paper's brightness."""
    found = estimate_noise([patch(read, gain, bayer=bayer, seed=seed) for seed in range(4)])
    for signal in (300.0, 1000.0, 1800.0):
        true = np.sqrt(read**2 + gain * signal)
        assert np.sqrt(found.variance(np.array(signal))) == pytest.approx(true, rel=0.15)
    assert found.texture == 0.0


def test_an_even_image_says_its_noise_and_no_gain() -> None:
    values = 1000.0 + np.random.default_rng(2).normal(0, 7.0, (60, 60))
    even = Patch(values, np.zeros((60, 60), np.uint8), np.ones((60, 60), dtype=bool), (0, 0))
    assert np.sqrt(estimate_noise([even]).variance(np.array(1000.0))) == pytest.approx(7.0, rel=0.1)


@pytest.mark.parametrize("values", [np.zeros((3, 3)), np.zeros((40, 40)), np.full((40, 40), 1000.0)])
def test_where_nothing_shows_the_model_is_still_one(values: np.ndarray) -> None:
    """Without noise the weights would be infinite."""
    found = estimate_noise([Patch(values, np.zeros(values.shape, np.uint8), np.ones(values.shape, dtype=bool), (0, 0))])
    assert np.isfinite([found.read_dn, found.gain_dn]).all()
    assert found.read_dn > 0
    assert found.gain_dn >= 0


def test_no_patch_is_a_model_too() -> None:
    assert estimate_noise([]) == NoiseModel(1.0, 0.0)


def test_invalid_pixels_are_no_noise() -> None:
    spoilt = patch(5.0, 0.2)
    spoilt.values[10:60, 10:60] = np.random.default_rng(5).uniform(0, 4000, (50, 50))
    spoilt.valid[10:60, 10:60] = False
    found = estimate_noise([spoilt, patch(5.0, 0.2, seed=3)])
    assert np.sqrt(found.variance(np.array(1500.0))) == pytest.approx(np.sqrt(25 + 300), rel=0.2)


def test_variance_never_falls_below_the_read_noise() -> None:
    model = NoiseModel(5.0, 0.5)
    np.testing.assert_allclose(model.variance(np.array([-100.0, 0.0, 100.0])), [25.0, 25.0, 75.0])


@pytest.mark.parametrize(("box", "origin", "shape"), [
    ((5, 6, 10, 8), (5, 6), (8, 10)), ((-5, -5, 10, 10), (0, 0), (5, 5)), ((85, 85, 20, 20), (85, 85), (5, 5)),
    ((200, 200, 5, 5), (200, 200), (0, 0)),
])  # fmt: skip
def test_a_crop_keeps_the_frames_coordinates(
    box: tuple[int, int, int, int], origin: tuple[int, int], shape: tuple[int, int]
) -> None:
    whole = patch(5.0, 0.2)
    part = whole.crop(*box)
    assert part.shape == shape
    if min(shape):
        assert part.origin_px == origin
        np.testing.assert_array_equal(
            part.values, whole.values[origin[1] : origin[1] + shape[0], origin[0] : origin[0] + shape[1]]
        )
