from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from labdaemon.blur import Defocus, Dot, NoiseModel, Patch, fit_sharp, measure
from labdaemon.blur.settings import TEXTURE_MAP
from labdaemon.blur.sharp.texture_map import half_plane_frequencies, texture_power, unmapped_power
from labdaemon.blur.spectra.closed_form import blurred_orbit_transfer

SIZE, CENTRE, RADIUS = (130, 130), (64.2, 65.1), 12.0
STILL = Defocus(0.0, 0.01)


def scene_of(area, texture=0.01, seed=7):
    return area.Scene(radius_px=RADIUS, texture=texture, texture_px=1.5, texture_seed=seed, sigma_px=0.9)


def estimate_texture(area, scene, path=None):
    """(h, w) what paper texture alone changes in an image without noise, relative to it (darkness: negative)."""
    plain = area.render(replace(scene, texture=0.0), SIZE, CENTRE, path, seed=None).values
    return 1 - area.render(scene, SIZE, CENTRE, path, seed=None).values / plain


def with_noise(scene, values, seed):
    rng = np.random.default_rng(seed)
    noisy = (rng.poisson(values * 8.5) + rng.normal(0, 7, values.shape)) / 8.5
    return Patch(np.round(noisy), np.zeros(values.shape, np.uint8), np.ones(values.shape, bool), (0, 0))


def sharp_of(area, scene, seed=1):
    dot = Dot(*CENTRE, RADIUS, RADIUS, 0.0, paper_px=60.0)
    return fit_sharp(dot, [area.render(scene, SIZE, CENTRE, seed=seed)])


def around(shape=SIZE):
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    return np.hypot(x - CENTRE[0], y - CENTRE[1])


def test_the_map_shows_the_grain_that_is_there(area):
    scene = scene_of(area)
    sharp = sharp_of(area, scene)
    assert sharp.texture_map is not None
    assert sharp.noise.texture == pytest.approx(0.01 * 1.5 / np.hypot(1.5, 0.95), rel=0.25)
    mapped = sharp.texture_map.shift(np.array(CENTRE), SIZE)
    paper = (around() > RADIUS + 6) & (around() < 50)
    true = estimate_texture(area, scene)[paper]
    assert np.corrcoef(mapped[paper], true)[0, 1] > 0.8
    # What a Wiener filter keeps is on average what is there.
    assert np.polyfit(mapped[paper], true, 1)[0] == pytest.approx(1.0, abs=0.15)


def test_smeared_with_the_target_it_is_the_grain_of_the_smear(area):
    scene, a = scene_of(area), np.array([8.0, 3.0])
    sharp = sharp_of(area, scene)
    moment = np.array([a[0] ** 2, a[0] * a[1], a[1] ** 2])
    smeared = sharp.texture_map.blur(
        lambda fx, fy: blurred_orbit_transfer(fx, fy, 0.0, moment), np.abs(a), np.array(CENTRE), SIZE
    )
    true = estimate_texture(area, scene, area.whole_cycles(*a))
    paper = (around() > RADIUS + 13) & (around() < 45)
    assert np.std(true[paper] - smeared[paper]) < 0.65 * np.std(true[paper])


def test_no_map_of_smooth_paper(area):
    sharp = sharp_of(area, scene_of(area, texture=0.0))
    assert sharp.texture_map is None
    assert sharp.noise.texture < 0.002


@pytest.mark.slow
def test_long_smears_are_measured_better_with_the_map_and_their_error_is_known(area):
    a = np.array([14.0, 5.0])
    size = float(np.hypot(*a))
    errors = {True: [], False: []}
    pulls = []
    for seed in range(7):
        scene = scene_of(area, texture=0.012, seed=seed)
        sharp = sharp_of(area, scene, seed=100 + seed)
        smear = area.render(scene, SIZE, CENTRE, area.whole_cycles(*a), seed=200 + seed, samples=120)
        for mapped in (True, False):
            found = measure(sharp if mapped else replace(sharp, texture_map=None), smear, defocus=STILL)
            errors[mapped].append(float(np.hypot(*found.a_px)) - size)
            if mapped:
                along = found.a_px / np.hypot(*found.a_px)
                pulls.append(errors[True][-1] / np.sqrt(along @ found.covariance_px2[2:4, 2:4] @ along))
    with_map, without = (float(np.sqrt(np.mean(np.square(errors[k])))) for k in (True, False))
    assert with_map < 0.85 * without
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.5


@pytest.mark.slow
def test_grain_that_stands_still_behind_the_dot_is_taken_off_too(area):
    a, pulls = np.array([9.0, 4.0]), []
    for seed in range(5):
        scene = scene_of(area, texture=0.012, seed=seed)
        sharp = sharp_of(area, scene, seed=100 + seed)
        plain = area.render(replace(scene, texture=0.0), SIZE, CENTRE, area.whole_cycles(*a), seed=None, samples=120)
        still = plain.values * (1 - estimate_texture(area, scene))  # also where the dot covered it at rest
        found = measure(sharp, with_noise(scene, still, 300 + seed), defocus=STILL)
        along = found.a_px / np.hypot(*found.a_px)
        sd = np.sqrt(along @ found.covariance_px2[2:4, 2:4] @ along)
        pulls.append((float(np.hypot(*found.a_px)) - float(np.hypot(*a))) / sd)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.4


def test_bent_light_does_not_stretch_a_smear(area):
    """Without noise: what is left is the light's doing, in parts of the standard deviation that noise would make."""
    scene, a = scene_of(area, texture=0.0), np.array([12.0, 4.0])
    sharp = sharp_of(area, scene)
    smear = area.render(scene, SIZE, CENTRE, area.whole_cycles(*a), seed=None, samples=120)
    x = (np.arange(SIZE[1]) - CENTRE[0]) / 60.0
    found = measure(sharp, replace(smear, values=smear.values * (1 - 0.15 * x**2)), defocus=STILL)
    along = found.a_px / np.hypot(*found.a_px)
    sd = float(np.sqrt(along @ found.covariance_px2[2:4, 2:4] @ along))
    assert abs(float(np.hypot(*found.a_px)) - float(np.hypot(*a))) < 0.5 * sd


def test_frequencies_are_those_of_a_real_transform():
    fx, fy = half_plane_frequencies((6, 8))
    np.testing.assert_allclose(fx[0], np.fft.rfftfreq(8))
    np.testing.assert_allclose(fy[:, 0], np.fft.fftfreq(6))


def test_what_is_left_of_the_grain_has_the_stated_power():
    """Paper texture less its map, both as images: filtered by the Wiener filter, and the mean of a square taken off."""
    size, noise, map_noise = (256, 256), NoiseModel(1.0, 0.1, 0.01, 2.0), 2e-5
    fx, fy = half_plane_frequencies(size)
    power = texture_power(noise, fx**2 + fy**2)
    decide_sign = unmapped_power(power, map_noise, fx, fy)
    found = np.zeros_like(decide_sign)
    rng = np.random.default_rng(3)
    for _ in range(100):
        texture = np.fft.irfft2(np.fft.rfft2(rng.normal(size=size)) * np.sqrt(power), s=size)
        seen = texture + rng.normal(0.0, np.sqrt(map_noise), size)
        seen -= ndimage.uniform_filter(seen, TEXTURE_MAP.background_size_px, mode="wrap")
        mapped = np.fft.irfft2(np.fft.rfft2(seen) * (power / (power + map_noise)), s=size)
        found += np.abs(np.fft.rfft2(texture - mapped)) ** 2 / (100 * size[0] * size[1])
    f = np.hypot(fx, fy)
    for low, high in ((0.0, 0.02), (0.02, 0.05), (0.05, 0.1), (0.1, 0.3)):
        band = (f >= low) & (f < high)
        assert np.mean(found[band]) == pytest.approx(np.mean(decide_sign[band]), rel=0.1)
    assert unmapped_power(power, np.inf, fx, fy) == pytest.approx(power)
