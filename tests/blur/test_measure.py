"""Dots that move, against a renderer that samples areas and instants."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur import (
    Defocus,
    Dot,
    ExposureWindow,
    InitialGuess,
    MotionWaveform,
    fit_sharp,
    measure,
    measure_frame,
)
from labdaemon.flags import Flag

STILL = Defocus(0.0, 0.01)


def sharp_of(area, scene, seed=1, noise=True):
    size = int(2 * scene.radius_px + 34)
    centre = (size / 2 + 0.27, size / 2 - 0.19)
    patch = area.render(scene, (size, size), centre, seed=seed)
    dot = Dot(
        centre[0] + 0.7, centre[1] - 0.6, scene.radius_px + 0.4, scene.radius_px * scene.minor_ratio, 0.0, name="t"
    )
    return fit_sharp(dot, [patch], noise=scene.noise if noise else None), centre


def blurred_of(area, scene, a, b=(0.0, 0.0), seed=2, extra=0.0, **more):
    reach = np.hypot(a, b)
    width, height = (int(2 * (scene.radius_px + r) + 28) for r in reach)
    centre = (width / 2 + 0.13, height / 2 + 0.31)
    path = area.whole_cycles(a[0], a[1], b[0], b[1])
    samples = int(120 + 14 * np.max(reach))
    return area.render(
        scene, (height, width), centre, path, seed=seed, samples=samples, extra_sigma_px=extra, **more
    ), centre


def test_the_resting_dot_is_found_to_a_hundredth_of_a_pixel(area):
    for scene in (area.Scene(), area.Scene(bayer=True, offset_px=((0.3, 0), (0, 0), (-0.3, 0.1), (0, 0)))):
        sharp, centre = sharp_of(area, scene)
        expected = np.array(centre)
        if scene.offset_px is not None:
            expected = expected + np.mean(scene.offset_px, axis=0)
        assert np.all(np.abs(sharp.centre_px - expected) < 0.02)
        assert not sharp.flags
        assert sharp.form.half_size_px == pytest.approx((scene.radius_px, scene.radius_px), abs=0.03)


@pytest.mark.parametrize("size", [0.5, 2.0, 12.0, 24.0])
def test_amplitude_and_direction_are_within_their_deviations(area, size):
    scene = area.Scene(radius_px=9.6)
    sharp, _ = sharp_of(area, scene)
    truth = size * np.array([np.cos(0.4), np.sin(0.4)])
    patch, centre = blurred_of(area, scene, truth)
    found = measure(sharp, patch, defocus=STILL, initial_guess=InitialGuess(np.add(centre, (2.5, -2.0))))
    sd = np.sqrt(np.diag(found.covariance_px2))
    assert np.all(np.abs(found.a_px - truth) < 4 * sd[2:4])
    assert np.all(np.abs(found.centre_px - centre) < 5 * sd[:2])
    assert np.all(sd[2:4] < 0.05)
    assert not found.flags
    assert 0.85 < found.chi2 < 1.15


def test_orbits_of_any_colour(area):
    scene = area.Scene(bayer=True, white_dn=(1500, 2600, 1300, 2600), sigma_px=(1.0, 0.8, 0.7, 0.8))
    sharp, _ = sharp_of(area, scene)
    patch, centre = blurred_of(area, scene, (5.0, 1.0), (-0.4, 2.0))
    found = measure(sharp, patch, defocus=STILL, initial_guess=InitialGuess(np.array(centre)))
    assert np.hypot(*found.a_px) == pytest.approx(np.sqrt(np.linalg.eigvalsh([[25.16, 4.2], [4.2, 5.0]])[1]), abs=0.02)
    assert np.hypot(*found.b_px) == pytest.approx(np.sqrt(np.linalg.eigvalsh([[25.16, 4.2], [4.2, 5.0]])[0]), abs=0.03)
    assert found.a_px[0] > 0
    assert not found.phased


def test_a_straight_path_has_no_minor_axis_but_a_stated_doubt_of_it(area):
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    patch, _ = blurred_of(area, scene, (6.0, 1.0))
    found = measure(sharp, patch, defocus=STILL)
    across = np.array([-found.a_px[1], found.a_px[0]]) / np.hypot(*found.a_px)
    assert np.all(found.b_px == 0)
    assert 0.05 < np.sqrt(across @ found.covariance_px2[4:, 4:] @ across) < 0.6


def test_the_airy_pattern_is_no_worse_than_half_again_the_gaussian(area):
    """Errors of several seeds at two amplitudes, at the same width of the core."""
    rms = []
    for scene in (area.Scene(sigma_px=1.2), area.Scene(sigma_px=0.3, airy_px=(2.6,))):
        sharp, _ = sharp_of(area, scene)
        errors = []
        for seed in range(2):
            for a in (1.5, 6.0):
                patch, _ = blurred_of(area, scene, (a, 0.0), seed=10 + seed)
                errors.append(np.hypot(*measure(sharp, patch, defocus=STILL).a_px) - a)
        rms.append(np.sqrt(np.mean(np.square(errors))))
    assert rms[1] < max(1.5 * rms[0], 0.012)


def test_defocus_is_not_read_as_motion_when_controls_measure_it(area):
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    patch, _ = blurred_of(area, scene, (0.0, 0.0), extra=0.5)
    known = measure(sharp, patch, defocus=Defocus(0.25, 0.01))
    assert Flag.AT_REST in known.flags
    assert np.hypot(*known.a_px) < 0.35


def test_rest_is_said_so_and_keeps_an_estimate_with_its_deviation(area):
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    patch, _ = blurred_of(area, scene, (0.0, 0.0))
    found = measure(sharp, patch, defocus=STILL)
    assert Flag.AT_REST in found.flags
    assert np.all(np.isfinite(found.a_px))
    assert np.hypot(*found.a_px) < 4 * np.sqrt(found.covariance_px2[2, 2])


@settings(max_examples=6, deadline=None, derandomize=True)
@given(
    radius=st.floats(8, 22),
    ratio=st.floats(0.75, 1.0),
    size=st.floats(1.0, 12.0),
    angle=st.floats(0, np.pi),
    gradient=st.tuples(st.floats(-0.002, 0.002), st.floats(-0.002, 0.002)),
    white=st.floats(900, 3200),
    read=st.floats(3, 20),
    seed=st.integers(0, 10_000),
)
def test_any_geometry_light_and_noise(area, radius, ratio, size, angle, gradient, white, read, seed):
    scene = area.Scene(
        radius_px=radius, minor_ratio=ratio, angle_rad=0.3, gradient=gradient, white_dn=(white,), read_electrons=read
    )
    sharp, _ = sharp_of(area, scene, seed=seed)
    truth = size * np.array([np.cos(angle), np.sin(angle)])
    patch, centre = blurred_of(area, scene, truth, seed=seed + 1)
    found = measure(sharp, patch, defocus=STILL, initial_guess=InitialGuess(np.array(centre) + 1.5))
    error = min(np.abs(np.hypot(*found.a_px) - size), 99)
    assert error < 5 * np.sqrt(np.trace(found.covariance_px2[2:4, 2:4])) + 0.003
    assert error < 0.15
    turn = abs((np.arctan2(found.a_px[1], found.a_px[0]) - angle + np.pi / 2) % np.pi - np.pi / 2)
    assert np.degrees(turn) < 3.0
    assert not found.flags & {Flag.POOR_FIT, Flag.NOT_FOUND, Flag.OCCLUDED}


@pytest.mark.slow
def test_errors_are_as_large_as_stated(area):
    """Pulls over size, light, noise, amplitude and paper texture have an rms of about one."""
    pulls = []
    for index, (radius, white, texture) in enumerate(
        ((9.6, 2500.0, 0.0), (15.7, 1200.0, 0.004), (20.0, 2500.0, 0.004))
    ):
        scene = area.Scene(radius_px=radius, white_dn=(white,), texture=texture, texture_px=1.5)
        for a in (0.8, 4.0):
            for seed in range(2):
                scene_now = area.Scene(radius_px=radius, white_dn=(white,), texture=texture, texture_seed=seed)
                sharp, rest = sharp_of(area, scene_now, seed=50 + seed, noise=False)
                patch, place = blurred_of(area, scene_now, (a, 0.0), seed=100 * index + seed)
                # It moves where it rested.
                patch = replace(patch, origin_px=(round(rest[0] - place[0]), round(rest[1] - place[1])))
                found = measure(sharp, patch, defocus=Defocus(0.0, 0.002))
                along = found.a_px / np.hypot(*found.a_px)
                sd = np.sqrt(along @ found.covariance_px2[2:4, 2:4] @ along)
                pulls.append((np.hypot(*found.a_px) - a) / sd)
        assert scene.radius_px == radius
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.35
    assert abs(np.mean(pulls)) < 0.45


def test_white_that_clips_is_left_out(area):
    scene = area.Scene(bayer=True, white_dn=(1500, 4800, 1200, 4800))
    sharp, _ = sharp_of(area, scene)
    patch, _ = blurred_of(area, scene, (4.0, 1.0))
    assert patch.valid.mean() < 0.7
    found = measure(sharp, patch, defocus=STILL)
    assert np.hypot(*(found.a_px - (4.0, 1.0))) < 0.03
    assert not found.flags


def test_a_motion_that_is_no_sinusoid_is_called_a_poor_fit_and_a_declared_one_is_measured(area):
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)

    def triangle(t):
        s = 4 * np.abs((7 * t) % 1 - 0.5) - 1
        return 5.0 * s, 1.0 * s

    patch = area.render(scene, (76, 84), (42.1, 38.2), triangle, seed=4, samples=700)
    assert Flag.POOR_FIT in measure(sharp, patch, defocus=STILL).flags
    found = measure(sharp, patch, defocus=STILL, waveform=MotionWaveform.triangular())
    assert np.hypot(*(found.a_px - (5.0, 1.0))) < 0.04
    assert not found.flags


def test_a_gauge_record_and_harmonics_are_the_same_law():
    t = np.arange(4000) / 4000
    values = 3.0 * (np.sin(2 * np.pi * t) + 0.3 * np.sin(4 * np.pi * t + 0.5)) + 7.0
    record, harmonics = MotionWaveform.record(values), MotionWaveform.harmonics([1.0, 0.3], [0.0, 0.5])
    for law in (record, harmonics):
        assert np.ptp(law.displacement) == pytest.approx(2.0, abs=1e-2)
        assert law.weight @ law.displacement == pytest.approx(0.0, abs=1e-9)
    assert record.weight @ record.displacement**2 == pytest.approx(
        harmonics.weight @ harmonics.displacement**2, rel=1e-3
    )


def test_part_cycles_with_and_without_a_known_window(area):
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    patch = area.render(scene, (76, 84), (42, 38), area.part_cycles(4, 0, 0, 0, 5.37, 1.1), seed=3, samples=537)
    known = measure(sharp, patch, window=ExposureWindow(5.37, 1.0, 1.1), defocus=STILL)
    assert np.hypot(*known.a_px) == pytest.approx(4.0, abs=0.02)
    assert not known.flags
    unknown = measure(sharp, patch, window=ExposureWindow(5.37, 1.0), defocus=STILL)
    assert unknown.flags == {Flag.PART_CYCLES}
    assert np.hypot(*unknown.a_px) == pytest.approx(4.0, rel=0.03)


def test_a_frame_without_controls_finds_its_own_defocus(area):
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    truths = [(0.0, 0.0), (3.0, 0.0), (0.0, 4.0), (2.0, 2.0), (6.0, 0.0)]
    patches = [blurred_of(area, scene, a, seed=20 + i, extra=0.5)[0] for i, a in enumerate(truths)]
    found = measure_frame([sharp] * 5, patches)
    assert Flag.AT_REST in found[0].flags
    for one, truth in zip(found[1:], truths[1:], strict=True):
        assert np.hypot(*one.a_px) == pytest.approx(np.hypot(*truth), abs=0.06)
        assert one.defocus_px2 == pytest.approx(0.25, abs=0.08)


def test_what_goes_to_a_worker_survives_the_journey(area):
    sharp, _ = sharp_of(area, area.Scene(bayer=True))
    patch, _ = blurred_of(area, area.Scene(bayer=True), (3.0, 0.0))
    again = pickle.loads(pickle.dumps(sharp))
    np.testing.assert_array_equal(measure(again, patch, defocus=STILL).a_px, measure(sharp, patch, defocus=STILL).a_px)


def test_nothing_warns_on_a_clean_measurement(area):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = area.Scene()
        sharp, _ = sharp_of(area, scene, noise=False)
        patch, _ = blurred_of(area, scene, (3.0, 1.0))
        assert not measure(sharp, patch).flags


def test_a_dot_that_came_nearer_on_its_way_aside_is_larger_and_moves_no_more(area):
    """Eight millimetres aside and five nearer at a metre: 31 px, and half a per cent of its size."""
    scene, a, pulls = area.Scene(radius_px=12.0), np.array([1.1, 0.5]), []
    sharp, centre = sharp_of(area, scene)
    nearer = area.Scene(radius_px=12.0 * 1.005)
    aside = (24, 20)
    for seed in range(6):
        place = (centre[0] + aside[0] + 0.3, centre[1] + aside[1] - 0.2)
        origin = (int(place[0]) - 24, int(place[1]) - 24)
        smear = area.render(nearer, (48, 48), place, area.whole_cycles(*a), seed=seed, origin=origin)
        found = measure(sharp, smear, initial_guess=InitialGuess(np.array(place)), defocus=STILL)
        along = found.a_px / np.hypot(*found.a_px)
        sd = np.sqrt(along @ found.covariance_px2[2:4, 2:4] @ along)
        pulls.append((np.hypot(*found.a_px) - np.hypot(*a)) / sd)
    assert np.sqrt(np.mean(np.square(pulls))) < 1.7


@pytest.mark.parametrize("depth", [0.1, 0.3])
def test_bands_of_flicker_are_flagged_or_measured(area, depth):
    """Light that comes and goes from row to row resembles something in front, until nothing is left to see."""
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    blurred, _ = blurred_of(area, scene, (5.0, 2.0))
    bands = 1 + depth * np.sin(0.15 * np.arange(blurred.shape[0]))[:, None]
    found = measure(sharp, replace(blurred, values=blurred.values * bands))
    right = np.hypot(*found.a_px) == pytest.approx(np.hypot(5.0, 2.0), abs=0.1)
    assert right or found.flags


def test_what_may_all_have_clipped_shows_no_motion(area):
    """Of an even patch at the ceiling no pixel counts: no numbers, no crash."""
    scene = area.Scene()
    sharp, _ = sharp_of(area, scene)
    patch, _ = blurred_of(area, scene, (5.0, 2.0))
    bright = np.full(patch.shape, float(patch.values.max()))
    valid = np.random.default_rng(3).random(patch.shape) < 0.9
    found = measure(sharp, replace(patch, values=bright, valid=valid))
    assert found.flags
    assert not np.isfinite(found.a_px).any()
