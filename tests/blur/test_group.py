import numpy as np
import pytest

from labdaemon.blur import Defocus, Dot, ExposureWindow, fit_sharp, measure_group
from labdaemon.blur.phase.time_reversal import reverse_time
from labdaemon.errors import UsageError
from labdaemon.flags import Flag

STILL = Defocus(0.0, 0.01)


@pytest.fixture(scope="module")
def sharp(area):
    scene = area.Scene(radius_px=12.0)
    patch = area.render(scene, (60, 60), (30.2, 29.7), seed=1)
    return fit_sharp(Dot(30, 30, 12, 12, 0.0, name="t"), [patch], noise=scene.noise)


def frames(area, motion, cycles, phases, drift=0.1):
    scene = area.Scene(radius_px=12.0)
    return [
        area.render(
            scene, (72, 76), (38 + drift * i, 36), area.part_cycles(*motion, cycles, p), seed=3 + i, samples=440
        )
        for i, p in enumerate(phases)
    ]


@pytest.mark.parametrize("motion", [(3.0, 1.0, 0.0, 0.0), (2.0, -0.5, -2.0, 0.5), (-2.5, 0.6, 1.2, 1.8)])
def test_two_phases_a_quarter_apart_give_signed_vectors_whatever_the_drift(area, sharp, motion):
    phases = (0.4, 0.4 + np.pi / 2)
    windows = [ExposureWindow(5.5, 1.0, p, 0.005, 0.0002) for p in phases]
    found = measure_group(sharp, frames(area, motion, 5.5, phases), windows, defocus=STILL)
    truth = np.array(motion)
    got = np.concatenate((found.a_px, found.b_px))
    sd = np.sqrt(np.diag(found.covariance_px2)[2:])
    assert found.phased
    assert np.all(np.abs(got - truth) < 4 * sd + 0.01)
    overlap = np.vdot(truth[:2] + 1j * truth[2:], got[:2] + 1j * got[2:])
    assert abs(np.degrees(np.angle(overlap))) < 6.0
    assert not found.flags


def test_timing_uncertainty_is_in_the_covariance(area, sharp):
    phases = (0.4, 0.4 + np.pi / 2)
    images = frames(area, (4.0, 0.0, 0.0, 0.0), 5.5, phases)
    exact, loose = (
        measure_group(sharp, images, [ExposureWindow(5.5, 1.0, p, sd) for p in phases], defocus=STILL)
        for sd in (0.0, 0.05)
    )
    # an error that both openings share turns the phase by as much: 4 px · 0.05 rad / sqrt 2 at least
    assert loose.covariance_px2[4, 4] > exact.covariance_px2[4, 4] + (0.6 * 4 * 0.05 / np.sqrt(2)) ** 2


def test_whole_cycles_hold_no_phase_and_are_averaged(area, sharp):
    phases = (0.4, 0.4 + np.pi / 2)
    images = frames(area, (3.0, 0.5, 0.0, 0.0), 5.0, phases)
    found = measure_group(sharp, images, [ExposureWindow(5.0, 1.0, p) for p in phases], defocus=STILL)
    assert not found.phased
    assert not found.flags
    assert np.hypot(*(found.a_px - (3.0, 0.5))) < 0.03


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_motion_too_small_for_its_phase_is_unflagged_and_says_how_little_is_known(area, sharp, seed):
    scene, motion, phases = area.Scene(radius_px=12.0), (0.3, 0.1, -0.35, -0.12), (0.4, 0.4 + np.pi / 2)
    images = [
        area.render(scene, (64, 66), (33, 31), area.part_cycles(*motion, 5.5, p), seed=10 * seed + i, samples=440)
        for i, p in enumerate(phases)
    ]
    found = measure_group(sharp, images, [ExposureWindow(5.5, 1.0, p) for p in phases], defocus=STILL)
    assert not found.flags
    got, sd = np.concatenate((found.a_px, found.b_px)), np.sqrt(np.diag(found.covariance_px2)[2:])
    assert np.all(np.abs(got - motion) < 3 * sd)
    assert abs(np.linalg.norm(got) - np.linalg.norm(motion)) < 0.1
    assert np.max(sd) > 0.1
    assert found.axes is not None
    assert not found.axes.phased
    assert abs(np.hypot(*found.axes.a_px) - np.linalg.norm(motion)) < 0.1
    assert np.hypot(*np.sqrt(np.diag(found.axes.covariance_px2)[2:4])) < 0.1


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_small_orbit_is_unflagged_within_its_deviations(area, sharp, seed):
    scene, motion, phases = area.Scene(radius_px=12.0), (1.0, 0.3, -0.2, 0.6), (0.4, 0.4 + np.pi / 2)
    images = [
        area.render(scene, (64, 66), (33, 31), area.part_cycles(*motion, 5.5, p), seed=10 * seed + i, samples=440)
        for i, p in enumerate(phases)
    ]
    found = measure_group(sharp, images, [ExposureWindow(5.5, 1.0, p) for p in phases], defocus=STILL)
    assert not found.flags
    got, sd = np.concatenate((found.a_px, found.b_px)), np.sqrt(np.diag(found.covariance_px2)[2:])
    assert np.all(np.abs(got - motion) < 4 * sd + 0.02)
    true_axes = np.linalg.svd(np.reshape(motion, (2, 2)), compute_uv=False)
    np.testing.assert_allclose(np.linalg.svd(got.reshape(2, 2), compute_uv=False), true_axes, atol=0.08)


def test_a_single_frame_of_a_group_has_a_mirror_image(area, sharp):
    found = measure_group(
        sharp, frames(area, (3.0, 1.0, 0.0, 0.0), 5.5, (0.9,)), [ExposureWindow(5.5, 1.0, 0.9)], defocus=STILL
    )
    assert Flag.AMBIGUOUS in found.flags
    assert abs(np.linalg.norm([*found.a_px, *found.b_px]) - np.sqrt(10)) < 0.05


def test_a_group_needs_its_phases(area, sharp):
    images = frames(area, (3.0, 0.5, 0.0, 0.0), 5.5, (0.1,))
    with pytest.raises(UsageError, match="phase"):
        measure_group(sharp, images, [ExposureWindow(5.5, 1.0)])
    with pytest.raises(UsageError, match="window"):
        measure_group(sharp, images, [])


@pytest.mark.parametrize(("size", "bent"), [(1.5, True), (7.0, False)])
def test_a_phase_that_shows_less_than_its_circle_is_straight_keeps_its_axis_apart(area, sharp, size, bent):
    """Cameras are joined by the axis then: two tangents of one circle would cross where neither phase is."""
    phases = (0.4, 0.4 + np.pi / 2)
    windows = [ExposureWindow(5.5, 1.0, p) for p in phases]
    images = frames(area, (size, 0.3 * size, 0.5 * size, 0.15 * size), 5.5, phases)
    found = measure_group(sharp, images, windows, defocus=STILL)
    assert found.phased
    assert (found.axes is not None) == bent


@pytest.mark.parametrize(
    ("motion", "apart"),
    [((6.0, 1.5, -4.0, -1.0), 0.0), ((6.0, 1.5, -4.0, -1.0), np.pi), ((5.0, 1.0, -1.0, 2.5), 0.002)],
)
def test_frames_that_see_the_same_part_of_the_cycle_have_a_mirror_image(area, sharp, motion, apart):
    phases = (0.9, 0.9 + apart)
    found = measure_group(
        sharp, frames(area, motion, 5.5, phases), [ExposureWindow(5.5, 1.0, p) for p in phases], defocus=STILL
    )
    assert Flag.AMBIGUOUS in found.flags
    got = np.concatenate((found.a_px, found.b_px))
    middle = 0.9 + 5.5 * np.pi
    images = [np.array(motion), np.concatenate(reverse_time(np.array(motion[:2]), np.array(motion[2:]), middle))]
    assert min(np.abs(got - one).max() for one in images) < 0.3
    if found.axes is not None:  # all phases are in its covariance
        return
    # The other one is reported: several cameras together may decide.
    others = [np.concatenate((one.a_px, one.b_px)) for one in found.alternatives]
    assert all(min(np.abs(one - image).max() for one in (got, *others)) < 0.3 for image in images)


def test_a_mirror_image_is_the_same_picture_from_the_middle_on():
    a, b, middle = np.array([6.0, 1.5]), np.array([-4.0, 2.0]), 0.7
    images = reverse_time(a, b, middle)
    for away in (0.3, 1.1):
        before = a * np.sin(middle - away) + b * np.cos(middle - away)
        after = images[0] * np.sin(middle + away) + images[1] * np.cos(middle + away)
        np.testing.assert_allclose(before, after)
