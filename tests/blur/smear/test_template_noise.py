import numpy as np
from scipy import ndimage

from labdaemon.blur import Patch, make_textured_patch, measure_static

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
    """Twelve pairs of frames of one thing: on average there is no extra blur, though its noise is far from known."""
    pattern = 1 + 0.01 * np.random.default_rng(8).standard_normal(SHAPE)
    found, decide_sign = [], []
    for seed in range(12):
        sharp = make_textured_patch(chequers(pattern, 2 * seed), (10, 10, 76, 76))
        still = measure_static(sharp, chequers(pattern, 2 * seed + 1))
        found.append(still.defocus_px2)
        decide_sign.append(np.sqrt(still.covariance_px2[2, 2]))
    scatter = float(np.std(found, ddof=1))
    assert abs(float(np.mean(found))) < 3 * scatter / np.sqrt(12) + 0.001
    assert scatter < 2 * float(np.mean(decide_sign))
