"""Textured patches: what a texture shows is measured within its sd, and what it does not is flagged."""

import numpy as np
import pytest
from scipy import ndimage

from labdaemon.bench.textures import moved, random_texture, run_texture_trials
from labdaemon.blur import ExposureWindow, Patch, make_textured_patch, measure, measure_group
from labdaemon.blur.light_code import LightCode
from labdaemon.flags import Flag

BOX = (35, 35, 60, 60)


def grey(values):
    return Patch(values, np.zeros(values.shape, np.uint8), np.ones(values.shape, bool), (0, 0))


def shoot(rng, image, noise=1.0):
    return grey(128 + image + rng.normal(0, noise, image.shape))


def stripes(angle, shift, period=6.0):
    yy, xx = np.mgrid[:130, :130]
    return 80 * np.tanh(3 * np.sin((xx * -np.sin(angle) + yy * np.cos(angle) - shift) / period))


@pytest.mark.parametrize(("angle", "across_px", "frames"), [(0.0, 0.0, 1), (0.0, 2.0, 1), (0.7, 0.0, 8), (2.2, 2.0, 8)])
def test_motion_along_stripes_is_undetermined(angle, across_px, frames):
    rng = np.random.default_rng(int(10 * angle) + frames)
    steps = across_px * np.sin(2 * np.pi * (np.arange(64) + 0.5) / 64)
    image = np.mean([stripes(angle, s) for s in steps], axis=0)
    target = make_textured_patch([shoot(rng, stripes(angle, 0.0)) for _ in range(frames)], BOX)
    found = measure(target, shoot(rng, image))
    across, along = np.array([-np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    assert Flag.UNDETERMINED in found.flags
    covariance = found.covariance_px2[2:4, 2:4]
    assert abs(found.a_px @ along) < 0.1
    assert np.sqrt(along @ covariance @ along) > 10
    assert abs(abs(found.a_px @ across) - across_px) < 4 * np.sqrt(across @ covariance @ across) + 0.02
    assert np.sqrt(across @ covariance @ across) < 0.5


def test_stripes_with_some_structure_along_them_are_determined():
    rng = np.random.default_rng(3)
    texture = stripes(0.4, 0.0)[:130, :130] + 15 * random_texture(rng, 130, 2.0)
    target = make_textured_patch([shoot(rng, texture) for _ in range(4)], BOX)
    found = measure(target, shoot(rng, moved(texture, np.array([1.2, 0.9]))))
    assert Flag.UNDETERMINED not in found.flags
    sd = np.sqrt(np.diag(found.covariance_px2)[2:4])
    assert np.all(np.abs(found.a_px - (1.2, 0.9)) < 4 * sd + 0.02)


@pytest.mark.parametrize(("share", "is_cut"), [(0.001, False), (0.05, True)])
def test_a_texture_that_white_level_cuts_is_flagged(share, is_cut):
    rng = np.random.default_rng(26)
    texture = 30 * random_texture(rng, 130, 2.0)
    ceiling = 128 + np.quantile(texture, 1 - share)

    def clipped(image):
        values = 128 + image + rng.normal(0, 1, image.shape)
        return Patch(np.minimum(values, ceiling), np.zeros(values.shape, np.uint8), values < ceiling, (0, 0))

    found = measure(make_textured_patch(clipped(texture), BOX), clipped(moved(texture, np.array([1.8, 0.9]))))
    assert (Flag.SATURATED in found.flags) == is_cut


def test_a_surface_without_texture_is_not_found():
    rng = np.random.default_rng(4)
    blank = np.zeros((130, 130))
    found = measure(make_textured_patch(shoot(rng, blank), BOX), shoot(rng, blank))
    assert Flag.NOT_FOUND in found.flags
    assert np.isnan(found.a_px).all()


@pytest.mark.parametrize(("other_px", "share"), [(0.0, 0.33), (1.5, 0.5)])
def test_two_motions_in_one_box_are_flagged(other_px, share):
    rng = np.random.default_rng(11)
    one, two = (30 * random_texture(rng, 130, 2.0) for _ in range(2))
    border = 35 + int(60 * (1 - share))
    left = np.arange(130)[None, :] < border
    direction = np.array([np.cos(0.3), np.sin(0.3)])
    target = make_textured_patch([shoot(rng, np.where(left, one, two)) for _ in range(2)], BOX)
    image = np.where(left, moved(one, 3.0 * direction), moved(two, other_px * direction))
    assert Flag.MIXED_MOTION in measure(target, shoot(rng, image)).flags


def test_a_motion_that_varies_slightly_over_the_box_is_not_called_two():
    rng = np.random.default_rng(12)
    texture = 30 * random_texture(rng, 130, 2.0)
    slow, fast = moved(texture, np.array([1.9, 0.0])), moved(texture, np.array([2.1, 0.0]))
    part = np.linspace(0, 1, 130)[:, None]
    found = measure(make_textured_patch(shoot(rng, texture), BOX), shoot(rng, slow * (1 - part) + fast * part))
    assert not found.flags
    assert abs(np.hypot(*found.a_px) - 2.0) < 0.05


def test_a_low_contrast_texture_is_measured():
    rng = np.random.default_rng(5)
    texture = 5 * random_texture(rng, 130, 2.0)
    found = measure(
        make_textured_patch(shoot(rng, texture, 0.5), BOX), shoot(rng, moved(texture, np.array([2.0, 1.0])), 0.5)
    )
    assert not found.flags
    assert np.all(np.abs(found.a_px - (2.0, 1.0)) < 4 * np.sqrt(np.diag(found.covariance_px2)[2:4]))


def test_a_lamp_at_half_its_brightness_does_not_matter():
    rng = np.random.default_rng(6)
    texture = ndimage.gaussian_filter(rng.normal(size=(130, 130)), 2.0, mode="wrap")
    texture *= 30 / texture.std()
    dim = grey(64 + 0.5 * moved(texture, np.array([1.5, 0.0])) + rng.normal(0, 1, texture.shape))
    found = measure(make_textured_patch(shoot(rng, texture), BOX), dim)
    assert not found.flags
    assert np.all(np.abs(found.a_px - (1.5, 0.0)) < 4 * np.sqrt(np.diag(found.covariance_px2)[2:4]))


def test_rest_and_motion_agree_with_their_sd_on_a_sample_of_the_bench():
    rest = run_texture_trials(0.0, 4, seed=2)
    assert rest.false_motions == 0
    assert 0.6 < rest.pull < 1.5
    motion = run_texture_trials(1.0, 5, seed=3)
    assert 0.6 < motion.pull < 1.5
    assert motion.flagged <= 2


def through(texture, a, b, theta, brightness):
    """The texture averaged over instants of a motion, each with its light."""
    path = np.outer(np.sin(theta), a) + np.outer(np.cos(theta), b)
    fy, fx = (np.fft.fftfreq(n) for n in texture.shape)
    by_x, by_y = (np.exp(-2j * np.pi * np.outer(f, path[:, k])) for f, k in ((fx, 0), (fy, 1)))
    return np.fft.ifft2(np.fft.fft2(texture) * ((by_y * brightness) @ by_x.T) / brightness.sum()).real


def instants(window):
    """Excitation phase and light at instants of an exposure."""
    if window.is_coded:
        return 2 * np.pi * (np.arange(700) + 0.5) / 700, np.repeat(np.array(window.light.brightness, float), 100)
    return window.phase_rad + 2 * np.pi * window.cycles * (np.arange(700) + 0.5) / 700, np.ones(700)


CODE = (1, 1, 1, 0, 1, 0, 0)
CODED = ExposureWindow(10.0, 1.0, 0.0, light=LightCode(CODE, 0.0, 10))
PART = ExposureWindow(10.0, 0.55, 0.9)


@pytest.mark.parametrize("window", [PART, CODED])
def test_the_sharp_frame_s_noise_is_no_motion_through_a_window(window):
    rng = np.random.default_rng(21)
    texture = 10 * random_texture(rng, 130, 2.0)
    found = measure(make_textured_patch(shoot(rng, texture), BOX), shoot(rng, texture), window=window)
    assert found.flags == {Flag.AT_REST}


@pytest.mark.parametrize("window", [PART, CODED])
def test_two_motions_are_flagged_through_a_window_too(window):
    rng = np.random.default_rng(25)
    one, two = (30 * random_texture(rng, 130, 2.0) for _ in range(2))
    left = np.arange(130)[None, :] < 65
    target = make_textured_patch([shoot(rng, np.where(left, one, two)) for _ in range(2)], BOX)
    theta, light = instants(window)
    a, b = np.array([2.2, -1.0]), np.array([0.9, -0.4])
    image = np.where(left, through(one, a, b, theta, light), through(two, 0.5 * a, 0.5 * b, theta, light))
    assert Flag.MIXED_MOTION in measure(target, shoot(rng, image), window=window).flags


def test_two_codes_show_the_vectors_of_a_texture():
    rng = np.random.default_rng(22)
    texture, a, b = 25 * random_texture(rng, 130, 1.5), np.array([2.0, 0.8]), np.array([-1.0, -0.4])
    target = make_textured_patch([shoot(rng, texture) for _ in range(2)], BOX)
    theta = 2 * np.pi * (np.arange(1280) + 0.5) / 1280
    patches, windows = [], []
    for wave in (np.cos, np.sin):
        code = (1 + wave(2 * np.pi * (np.arange(64) + 0.5) / 64)) / 2
        patches.append(shoot(rng, through(texture, a, b, theta, np.repeat(code, 20))))
        windows.append(ExposureWindow(10.0, 1.0, 0.0, light=LightCode(tuple(code), 0.0, 10)))
    found = measure_group(target, patches, windows)
    assert found.phased
    assert not found.flags
    error = np.concatenate((found.a_px - a, found.b_px - b))
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(found.covariance_px2)[2:]) + 0.02)


def test_part_cycles_of_stripes_give_the_component_across_and_a_code_gives_none():
    rng = np.random.default_rng(23)
    target = make_textured_patch(shoot(rng, stripes(0.0, 0.0)), BOX)
    steps = 2.0 * np.sin(PART.phase_rad + 2 * np.pi * PART.cycles * (np.arange(110) + 0.5) / 110)
    image = np.mean([stripes(0.0, s) for s in steps], axis=0)
    part, coded = (measure(target, shoot(rng, image), window=window) for window in (PART, CODED))
    assert Flag.UNDETERMINED in part.flags
    assert abs(abs(part.a_px[1]) - 2.0) < 4 * np.sqrt(part.covariance_px2[3, 3]) + 0.02
    assert {Flag.UNDETERMINED, Flag.NOT_FOUND} <= coded.flags
    assert np.isnan(coded.a_px).all()


def test_a_frame_that_lost_sharpness_does_not_lengthen_a_path():
    rng = np.random.default_rng(24)
    texture = 40 * random_texture(rng, 130, 1.5)
    image = ndimage.gaussian_filter(moved(texture, np.array([1.2, 0.0])), 0.05**0.5, mode="wrap", truncate=8.0)
    found = measure(make_textured_patch([shoot(rng, texture, 0.5) for _ in range(4)], BOX), shoot(rng, image, 0.5))
    assert not found.flags
    assert abs(np.hypot(*found.a_px) - 1.2) < 2 * found.sd_px
    assert not found.b_px.any()
