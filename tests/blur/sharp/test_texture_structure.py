"""Where a texture's power lies among spatial frequencies."""

import numpy as np
import pytest

from labdaemon.bench.textures import random_texture
from labdaemon.blur import Patch, make_textured_patch
from labdaemon.blur.sharp.texture_structure import texture_band, without_noise


@pytest.mark.parametrize("mosaic", [False, True])
def test_frequencies_without_texture_weigh_nothing(mosaic):
    rng = np.random.default_rng(1)
    image = 128 + 20 * random_texture(rng, 130, 2.5) + rng.normal(0, 1, (130, 130))
    y, x = np.mgrid[:130, :130]
    channel = (2 * (y % 2) + x % 2).astype(np.uint8) if mosaic else np.zeros((130, 130), np.uint8)
    form = make_textured_patch(Patch(image, channel, np.ones(image.shape, bool), (0, 0)), (35, 35, 60, 60)).form
    band = texture_band(form, (60, 60), 1.0 / form.spread_dn**2)
    frequency = np.hypot(band.fx, band.fy)
    double = np.where((band.fx > 0) & (band.fx < 0.5), 2.0, 1.0)
    assert band.count == pytest.approx(60 * 60 / (2 if mosaic else 1), rel=0.04)
    assert np.mean((band.weight / double)[frequency < 0.08]) > 0.95
    assert np.mean((band.weight / double)[frequency > 0.3]) < 0.25


@pytest.mark.parametrize(("contrast", "gain"), [(4.0, 0.6), (20.0, 0.8)])
def test_the_most_probable_texture_is_nearer_to_the_true_one(contrast, gain):
    rng = np.random.default_rng(2)
    texture = contrast * random_texture(rng, 130, 2.0)
    image = 128 + texture + rng.normal(0, 1, (130, 130))
    channel, valid = np.zeros(image.shape, np.uint8), np.ones(image.shape, bool)
    form = make_textured_patch(Patch(image, channel, valid, (0, 0)), (35, 35, 60, 60)).form
    clean = without_noise(form, 1.0 / form.spread_dn**2)

    def error(dark):
        # Darkness is the negative of brightness, in parts of the spread.
        away = -dark[0] * form.spread_dn - texture
        return np.std(away[20:-20, 20:-20])

    assert error(clean.dark) < gain * error(form.dark)
    assert clean.dark.shape == form.dark.shape
    assert clean.dark.mean() == pytest.approx(form.dark.mean(), abs=0.01)


def test_a_surface_without_texture_keeps_its_brightness_alone():
    rng = np.random.default_rng(3)
    image = 128 + rng.normal(0, 1, (100, 100))
    channel, valid = np.zeros(image.shape, np.uint8), np.ones(image.shape, bool)
    form = make_textured_patch(Patch(image, channel, valid, (0, 0)), (30, 30, 40, 40)).form
    clean = without_noise(form, 1.0 / form.spread_dn**2)
    assert np.std(clean.dark) < 0.5 * np.std(form.dark)
