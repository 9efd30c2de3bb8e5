import numpy as np
import pytest
from scipy import ndimage

from labdaemon.blur import (
    Dot,
    NoiseModel,
    Patch,
    estimate_frame_defocus,
    fit_sharp,
    make_textured_patch,
    measure_displacement,
    measure_static,
)
from labdaemon.errors import DataError, UsageError

NOISE = NoiseModel(7 / 8.5, 1 / 8.5)
FINE = 6


def tag(centre, sigma, seed, bayer, shape=(104, 104)):
    """A chequered tag, drawn in sub-pixels and binned; each colour through its own lens blur."""
    code = np.random.default_rng(3).random((8, 8)) > 0.5
    code[0] = code[-1] = code[:, 0] = code[:, -1] = True
    height, width = shape
    y, x = np.mgrid[0 : height * FINE, 0 : width * FINE]
    i = np.floor(((x - (FINE - 1) / 2) / FINE - centre[0]) / 9 + 4).astype(int)
    j = np.floor(((y - (FINE - 1) / 2) / FINE - centre[1]) / 9 + 4).astype(int)
    inside = (i >= 0) & (i < 8) & (j >= 0) & (j < 8)
    reflect = np.where(inside, 1 - 0.9 * code[np.clip(j, 0, 7), np.clip(i, 0, 7)], 1.0)
    channel = np.zeros(shape, np.uint8)
    if bayer:
        channel[0::2, 1::2], channel[1::2, 0::2], channel[1::2, 1::2] = 1, 3, 2
    image = np.zeros(shape)
    for c, white in enumerate((1500, 2600, 1200, 2600) if bayer else (2600,)):
        seen = ndimage.gaussian_filter(reflect, sigma[c % len(sigma)] * FINE)
        image = np.where(channel == c, seen.reshape(height, FINE, width, FINE).mean(axis=(1, 3)) * white, image)
    rng = np.random.default_rng(seed)
    image = np.round((rng.poisson(image * 8.5) + rng.normal(0, 7, shape)) / 8.5)
    return Patch(image, channel, np.ones(shape, bool), (0, 0))


@pytest.mark.parametrize(("bayer", "sigma"), [(False, (0.8,)), (True, (1.1, 1.0, 0.9, 1.0))])
@pytest.mark.parametrize("extra", [0.0, 0.5])
def test_a_tags_shift_and_defocus(bayer, sigma, extra):
    """Sub-pixel shifts of whole sub-pixels, so that the drawing adds no error of its own."""
    first = tag((52.0, 52.0), sigma, 10, bayer)
    moved = (52.0 + 2 / FINE, 52.0 - 1 / FINE)
    later = tag(moved, tuple(np.hypot(s, extra) for s in sigma), 20, bayer)
    sharp = make_textured_patch(first, (10, 10, 84, 84), noise=NOISE)
    still = measure_static(sharp, later)
    np.testing.assert_allclose(still.shift_px, (2 / FINE, -1 / FINE), atol=0.01)
    assert still.defocus_px2 == pytest.approx(extra**2, abs=0.02)


def test_controls_agree_on_the_frames_blur_whatever_one_of_them_says(area):
    scene = area.Scene()
    sharp = fit_sharp(
        Dot(33, 33, 15.7, 15.7, 0.0), [area.render(scene, (66, 66), (33.2, 32.9), seed=1)], noise=scene.noise
    )
    stills = [
        measure_static(sharp, area.render(scene, (66, 66), (33.5, 32.6), seed=s, extra_sigma_px=0.6)) for s in (2, 3, 4)
    ]
    stills.append(measure_static(sharp, area.render(scene, (66, 66), (33.5, 32.6), seed=9, extra_sigma_px=1.6)))
    blur = estimate_frame_defocus(stills)
    assert stills[0].shift_px == pytest.approx((0.3, -0.3), abs=0.01)
    assert blur.mean_px2 == pytest.approx(0.36, abs=0.03)
    clean = estimate_frame_defocus(stills[:3])
    assert clean.mean_px2 == pytest.approx(0.36, abs=0.02)


def test_no_control_seen_is_an_error(area):
    scene = area.Scene()
    sharp = fit_sharp(Dot(33, 33, 15.7, 15.7, 0.0), [area.render(scene, (66, 66), (33.2, 32.9), seed=1)])
    blank = Patch(np.full((66, 66), 2500.0), np.zeros((66, 66), np.uint8), np.ones((66, 66), bool), (0, 0))
    with pytest.raises(DataError, match="control target"):
        estimate_frame_defocus([measure_static(sharp, blank)])


def test_static_displacement_between_two_sharp_sets(area):
    scene = area.Scene()
    one, two = (
        fit_sharp(Dot(33, 33, 15.7, 15.7, 0.0), [area.render(scene, (66, 66), at, seed=s)], noise=scene.noise)
        for s, at in ((1, (33.2, 32.9)), (2, (33.45, 32.6)))
    )
    shift, covariance = measure_displacement(one, two)
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(shift - (0.25, -0.3)) < 4 * sd + 0.002)
    assert np.all(sd < 0.01)


def test_a_box_must_lie_in_the_picture():
    patch = tag((52.0, 52.0), (0.8,), 1, False)
    with pytest.raises(UsageError, match="inside"):
        make_textured_patch(patch, (60, 60, 60, 60))
    with pytest.raises(UsageError, match="8 px"):
        make_textured_patch(patch, (10, 10, 4, 60))
