"""Motions with harmonics, against a renderer that samples areas and instants."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import (
    Defocus,
    Dot,
    ExposureWindow,
    LightCode,
    MotionHarmonics,
    fit_sharp,
    make_textured_patch,
    measure,
    measure_frame,
    measure_group,
    named_code,
)
from labdaemon.blur.waveform import window_nodes
from labdaemon.errors import UsageError
from labdaemon.flags import Flag
from labdaemon.half_turn import major_phase_rad

STILL = Defocus(0.0, 0.01)
AXIS = np.array((math.cos(0.4), math.sin(0.4)))


def third(delta_rad=0.3, ratio=0.05, sd=0.0):
    """A third harmonic alone."""
    return MotionHarmonics((0.0, ratio * math.cos(delta_rad)), (0.0, ratio * math.sin(delta_rad)), (sd, sd))


@pytest.fixture(scope="module")
def scene(area):
    return area.Scene(radius_px=6.0)


@pytest.fixture(scope="module")
def sharp(area, scene):
    size = int(2 * scene.radius_px + 34)
    centre = (size / 2 + 0.27, size / 2 - 0.19)
    dot = Dot(centre[0] + 0.7, centre[1] - 0.6, scene.radius_px + 0.4, scene.radius_px, 0.0, name="t")
    return fit_sharp(dot, [area.render(scene, (size, size), centre, seed=1)], noise=scene.noise)


def blurred(area, scene, a, b, harmonics, *, phase_rad=0.0, cycles=1.0, opening_rad=0.0, seed=2, light=None):
    """A blurred frame; under a code the instants at which the lamp is on."""
    reach = float(np.hypot(*a) + np.hypot(*b))
    size = int(2 * (scene.radius_px + reach) + 34)
    samples = int(160 + 24 * reach)
    angle = opening_rad + 2 * np.pi * cycles * (np.arange(samples) + 0.5) / samples
    if light is not None:
        angle = angle[light.at(angle) > 0.5]
    basis = harmonics.at_phase(phase_rad).basis(angle)

    def path(t):
        return a[0] * basis[0] + b[0] * basis[1], a[1] * basis[0] + b[1] * basis[1]

    return area.render(scene, (size, size), (size / 2 + 0.13, size / 2 - 0.31), path, seed=seed, samples=len(angle))


@pytest.mark.parametrize(("size", "delta"), [(1.5, 0.0), (3.0, math.pi)])
def test_a_known_third_harmonic_leaves_no_bias(area, scene, sharp, size, delta):
    harmonics = third(delta)
    patch = blurred(area, scene, size * AXIS, (0, 0), harmonics, seed=None)
    found = measure(sharp, patch, defocus=STILL, harmonics=harmonics)
    assert found.amplitude_px == pytest.approx(size, rel=1e-3)
    assert not found.flags
    sine = measure(sharp, patch, defocus=STILL)
    assert abs(sine.amplitude_px / size - 1) > 2 * abs(found.amplitude_px / size - 1)


def test_an_uncertain_harmonic_enters_the_standard_deviation(area, scene, sharp):
    patch = blurred(area, scene, 3.0 * AXIS, (0, 0), third(0.0))
    exact = measure(sharp, patch, defocus=STILL, harmonics=third(0.0))
    loose = measure(sharp, patch, defocus=STILL, harmonics=third(0.0, sd=0.05))
    # At 3 px a third harmonic of 5 % in the worst phase is worth 1 % of the amplitude.
    added = math.sqrt(loose.sd_px**2 - exact.sd_px**2)
    assert added == pytest.approx(0.01 * 3.0, rel=0.5)


def test_an_orbit_keeps_its_axes(area, scene, sharp):
    harmonics = MotionHarmonics((0.016, 0.048), (0.025, 0.015), (0.0, 0.0))
    minor = 1.5 * np.array((-AXIS[1], AXIS[0]))
    found = measure(sharp, blurred(area, scene, 3.0 * AXIS, minor, harmonics), defocus=STILL, harmonics=harmonics)
    assert found.amplitude_px == pytest.approx(3.0, abs=4 * found.sd_px)
    assert np.hypot(*found.b_px) == pytest.approx(1.5, abs=0.03)
    assert not found.flags


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_even_harmonic_moves_the_middle_to_the_right_side(area, scene, sharp, sign):
    harmonics = MotionHarmonics((0.046,), (0.038,), (0.0,))
    patch = blurred(area, scene, sign * 5.0 * AXIS, (0, 0), harmonics)
    found = measure(sharp, patch, defocus=STILL, harmonics=harmonics)
    middle = np.array(patch.shape)[::-1] / 2 + (0.13, -0.31)
    assert np.hypot(*(found.centre_px - middle)) < 0.01
    assert found.a_px @ AXIS == pytest.approx(5.0, abs=0.02)


def test_rest_and_lost_targets_stay_as_they_are(area, scene, sharp):
    patch = blurred(area, scene, (0.0, 0.0), (0.0, 0.0), third())
    sine, found = (measure(sharp, patch, defocus=STILL, harmonics=one) for one in (None, third()))
    assert Flag.AT_REST in found.flags
    np.testing.assert_array_equal(sine.a_px, found.a_px)
    empty = replace(patch, values=np.full(patch.shape, 2500.0))
    assert not np.isfinite(measure(sharp, empty, defocus=STILL, harmonics=third()).a_px).any()


def test_part_cycles_show_the_fundamental(area, scene, sharp):
    harmonics, phase = third(0.4), 0.8
    a, b = 3.0 * AXIS * math.cos(phase), 3.0 * AXIS * math.sin(phase)
    patch = blurred(area, scene, a, b, harmonics, phase_rad=phase, cycles=2.5, opening_rad=0.3, seed=9)
    window = ExposureWindow(2.5, 1.0, 0.3)
    found = measure_group(sharp, [patch], [window], defocus=STILL, harmonics=harmonics)
    assert found.phased
    assert np.hypot(found.a_px @ AXIS, found.b_px @ AXIS) == pytest.approx(3.0, abs=0.03)


def test_coded_light_with_a_harmonic(area, scene, sharp):
    harmonics, phase = third(0.3), 0.8
    code = LightCode(named_code("1110100"), 0.0, 5)
    a, b = 3.0 * AXIS * math.cos(phase), 3.0 * AXIS * math.sin(phase)
    patch = blurred(area, scene, a, b, harmonics, phase_rad=phase, light=code, seed=None)
    window = ExposureWindow(5.0, 1.0, light=code)
    sine, found = (measure(sharp, patch, window=window, defocus=STILL, harmonics=one) for one in (None, harmonics))
    errors = [abs(np.hypot(one.a_px @ AXIS, one.b_px @ AXIS) - 3.0) for one in (sine, found)]
    assert errors[1] < 0.01 < errors[0]
    assert math.atan2(found.b_px @ AXIS, found.a_px @ AXIS) == pytest.approx(phase, abs=0.01)


def test_a_frames_targets_have_harmonics_of_their_own(area, scene, sharp):
    patch = blurred(area, scene, 3.0 * AXIS, (0, 0), third(0.0), seed=None)
    with_third, sine = measure_frame([sharp, sharp], [patch, patch], defocus=STILL, harmonics=[third(0.0), None])
    assert abs(with_third.amplitude_px - 3.0) < 0.003 < abs(sine.amplitude_px - 3.0)


def test_a_textured_patch_is_scaled(area):
    rng = np.random.default_rng(3)
    scene = area.Scene(radius_px=0.0, texture=0.06, texture_px=1.6, texture_seed=int(rng.integers(99)))
    centre = (32.0, 32.0)
    rest = area.render(scene, (64, 64), centre, seed=1)
    sharp = make_textured_patch([rest], (14, 14, 36, 36), name="p", noise=scene.noise)

    def moved(harmonics):
        wave = harmonics.basis(2 * np.pi * (np.arange(80) + 0.5) / 80)[0]
        return area.render(scene, (64, 64), centre, lambda t: (4 * wave, 2 * wave), seed=None, samples=80)

    plain = measure(sharp, moved(third(ratio=0.0))).amplitude_px
    patch = moved(third(0.0))
    sine, found = (measure(sharp, patch, harmonics=one).amplitude_px for one in (None, third(0.0)))
    assert abs(found - plain) < 0.5 * abs(sine - plain)


def test_the_basis_is_a_sinusoid_without_harmonics_and_has_no_mean() -> None:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    none = MotionHarmonics((), (), ())
    np.testing.assert_allclose(none.basis(angle), (np.sin(angle), np.cos(angle)), atol=1e-12)
    basis, weight = window_nodes(ExposureWindow(1.0, 1.0, 0.0, harmonics=third()), 5.0)
    np.testing.assert_allclose(basis @ weight, 0.0, atol=1e-9)


def test_the_waveform_goes_with_the_fundamentals_phase() -> None:
    angle = np.linspace(0, 2 * np.pi, 100)
    one = MotionHarmonics((0.02, 0.03), (0.01, -0.02), (0.0, 0.0))
    turned = one.at_phase(0.7)
    along = math.cos(0.7) * turned.basis(angle)[0] + math.sin(0.7) * turned.basis(angle)[1]
    np.testing.assert_allclose(along, one.basis(angle + 0.7)[0], atol=1e-12)
    assert major_phase_rad(math.cos(0.7) * AXIS, math.sin(0.7) * AXIS) == pytest.approx(0.7)


@pytest.mark.parametrize(
    "parts", [((0.1,), (), (0.1,)), ((math.nan,), (0.0,), (0.0,)), ((0.9,), (0.9,), (0.0,)), ((0.1,), (0.1,), (-1.0,))]
)
def test_harmonics_that_make_no_sense_are_refused(parts) -> None:
    with pytest.raises(UsageError):
        MotionHarmonics(*parts)


def test_the_sine_parts_may_be_known_less_well() -> None:
    plain = MotionHarmonics((0.0, 0.02), (0.0, 0.01), (0.0, 0.001))
    assert plain.sds == ((0.0, 0.0), (0.001, 0.001))
    assert replace(plain, sd_sine=(0.0, 0.02)).sds == ((0.0, 0.0), (0.001, 0.02))
    with pytest.raises(UsageError, match="sine part"):
        replace(plain, sd_sine=(0.02,))
