import numpy as np
import pytest
from scipy import ndimage

from labdaemon.blur import NoiseModel, Patch, measure_still, sharp_texture
from labdaemon.blur.mosaic import make_grid, split
from labdaemon.blur.soften import VARIANCE, transfer

NOISE = NoiseModel(7 / 8.5, 1 / 8.5)
SHAPE = (96, 96)


def chequers(pattern, seed):
    """Blurred chequers on a mosaic; `pattern` is the sensor's own sensitivity, the same in every frame."""
    rng = np.random.default_rng(3)
    code = np.kron(rng.random((12, 12)) > 0.5, np.ones((8, 8)))
    channel = np.zeros(SHAPE, np.uint8)
    channel[0::2, 1::2], channel[1::2, 0::2], channel[1::2, 1::2] = 1, 3, 2
    white = np.array([1500.0, 2600.0, 1200.0, 2600.0])[channel]
    light = ndimage.gaussian_filter(1 - 0.9 * code, 1.3) * white * pattern
    noise = np.random.default_rng(seed)
    values = (noise.poisson(light * 8.5) + noise.normal(0, 7, SHAPE)) / 8.5
    return Patch(values, channel, np.ones(SHAPE, bool), (0, 0))


def test_noise_and_fixed_pattern_are_not_read_as_focus():
    """Twelve pairs of frames of the same thing: the mean extra blur is nothing, and scatters as stated."""
    pattern = 1 + 0.004 * np.random.default_rng(8).standard_normal(SHAPE)
    found, stated = [], []
    for seed in range(12):
        sharp = sharp_texture(chequers(pattern, 2 * seed), (10, 10, 76, 76), noise=NOISE)
        still = measure_still(sharp, chequers(pattern, 2 * seed + 1))
        found.append(still.extra_blur_px2)
        stated.append(np.sqrt(still.covariance_px2[2, 2]))
    scatter = float(np.std(found, ddof=1))
    assert abs(float(np.mean(found))) < 3 * scatter / np.sqrt(12) + 0.001
    assert scatter < 2 * float(np.mean(stated))


@pytest.mark.parametrize("bayer", [False, True])
def test_the_transfer_is_that_of_smoothing_each_lattice(bayer):
    rng = np.random.default_rng(2)
    height, width = 32, 40
    values = rng.standard_normal((height, width))
    channel = np.zeros((height, width), np.uint8)
    if bayer:
        channel[0::2, 1::2], channel[1::2, 0::2], channel[1::2, 1::2] = 1, 3, 2
    planes = split(Patch(values, channel, np.ones((height, width), bool), (0, 0)))
    grid = make_grid((height, width))
    filtered = np.fft.irfft2(np.fft.rfft2(values) * transfer(grid, planes.period), s=(height, width))
    step = planes.period
    for plane, (ox, oy) in zip(planes.values, planes.offset_px.astype(int), strict=True):
        smooth = plane
        for axis in (0, 1):
            smooth = 0.25 * np.roll(smooth, 1, axis) + 0.5 * smooth + 0.25 * np.roll(smooth, -1, axis)
        np.testing.assert_allclose(filtered[oy::step, ox::step], smooth, atol=1e-12)


def test_what_is_left_of_white_noise():
    grid = make_grid((64, 64))
    full = np.abs(np.fft.fftfreq(64))[:, None] + np.zeros(64)
    leaves = (0.5 + 0.5 * np.cos(2 * np.pi * full)) * (0.5 + 0.5 * np.cos(2 * np.pi * full.T))
    assert float(np.mean(leaves**2)) == pytest.approx(VARIANCE)
    assert transfer(grid, 1).shape == grid.fx.shape
