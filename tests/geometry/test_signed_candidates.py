"""Twins of signed motions: settled by all cameras together, by the phase that targets share, or left ambiguous."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.flags import Flag
from labdaemon.geometry import ImageMotion, ObjectMotion, intersect_motion, intersect_targets
from labdaemon.geometry.common_phase import compare_phases
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.motion_candidates import phased_candidate
from labdaemon.geometry.orbit_prior import UNKNOWN_CAPTURE, AxisRatio, OrbitPrior, estimate_orbit_prior
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.geometry.signed_candidates import signed_candidates, with_phase_prior
from labdaemon.half_turn import major_phase_rad, within_half_turn

TWO = [(-500, -1000, 300), (500, -1000, 500)]
LEVEL = [(-500, -1000, 370), (500, -1000, 370)]
MEAN = np.array([20.0, 10.0, 370.0])
SD_PX = 0.01


def turned(a, b, angle):
    """The motion at another phase."""
    c, s = np.cos(angle), np.sin(angle)
    return c * a - s * b, s * a + c * b


def image(camera, a, b, *, twin_rad: float, excess: float, wrong: bool = False, sd_px: float = SD_PX) -> ImageMotion:
    """A camera's image of a motion and its twin; `wrong` takes the twin for the better one."""
    numbers = project_motion(camera.project_with_jacobians, np.stack([MEAN, a, b]))[0]
    twin = turned(numbers[2:4], numbers[4:], twin_rad)
    noise = np.eye(6) * sd_px**2
    motions = [(numbers[2:4], numbers[4:]), twin]
    first, second = motions[::-1] if wrong else motions
    other = ImageMotion(numbers[:2], *second, noise, True, excess=excess)
    return ImageMotion(numbers[:2], *first, noise, True, alternatives=(other,))


@pytest.mark.parametrize("places", [TWO, LEVEL])
@pytest.mark.parametrize("excess", [0.5, 5.0])
def test_a_camera_on_the_wrong_twin_is_overruled_by_the_others(look, places, excess: float) -> None:
    """Level motion in the epipolar plane too: rays do not decide there, but an orbit is less likely than a line."""
    cameras = [look(place) for place in places]
    a, b = np.array([-2.0, 1.0, 0.0]), np.array([-1.0, 0.5, 0.0])
    seen = [
        image(cameras[0], a, b, twin_rad=1.2, excess=14.0),
        image(cameras[1], a, b, twin_rad=2.5, excess=excess, wrong=True),
    ]
    joined = intersect_motion(cameras, seen)
    assert joined.motion.residual_ratio is not None
    np.testing.assert_allclose(joined.motion.a_mm, a, atol=0.05)
    if places is TWO:
        assert not joined.motion.flags
        assert joined.resolved_by == "phase"


def test_twins_that_no_camera_excludes_stay_ambiguous(look) -> None:
    cameras = [look(place) for place in TWO]
    a, b = np.array([-2.0, 1.0, 0.5]), np.array([-1.0, 0.5, 0.25])
    joined = intersect_motion(cameras, [image(one, a, b, twin_rad=2.0, excess=3.0) for one in cameras])
    assert Flag.AMBIGUOUS in joined.motion.flags
    assert joined.alternative is not None
    assert joined.motion.residual_ratio is not None
    assert joined.motion.residual_ratio >= 1.0


def test_evidence_of_several_cameras_adds_up(look) -> None:
    cameras = [look(place) for place in TWO]
    a, b = np.array([-2.0, 1.0, 0.5]), np.array([-1.0, 0.5, 0.25])
    joined = intersect_motion(cameras, [image(one, a, b, twin_rad=2.0, excess=6.0) for one in cameras])
    assert not joined.motion.flags


def test_a_neighbour_without_phase_does_not_hide_a_twin(look) -> None:
    """One camera hardly shows the phase: what the other leaves open stays open."""
    cameras = [look(place) for place in TWO]
    a, b = np.array([-2.0, 1.0, 0.5]), np.array([-1.0, 0.5, 0.25])
    open_one = image(cameras[0], a, b, twin_rad=2.0, excess=3.0)
    loose = image(cameras[1], a, b, twin_rad=2.0, excess=99.0)
    phasor = np.concatenate((loose.a_px, loose.b_px))
    wide = np.eye(6) * SD_PX**2
    wide[2:, 2:] += float(phasor @ phasor) * np.eye(4) * 0.4
    size = np.hypot(np.linalg.norm(loose.a_px), np.linalg.norm(loose.b_px))
    axes = ImageMotion(loose.mean_px, loose.a_px / np.linalg.norm(loose.a_px) * size, np.zeros(2), np.eye(6) * SD_PX**2)
    loose = replace(loose, covariance_px2=wide, axes=axes, alternatives=())
    assert Flag.AMBIGUOUS in intersect_motion(cameras, [open_one, loose]).motion.flags
    settled = replace(open_one, alternatives=())
    assert Flag.AMBIGUOUS not in intersect_motion(cameras, [settled, loose]).motion.flags


def test_the_prior_prefers_lines_and_does_not_forbid_orbits(look) -> None:
    cameras = [look(place) for place in TWO]
    exterior = np.zeros((12, 12))
    penalties = []
    for ratio in (0.0, 0.01, 0.3, 1.0):
        a, b = np.array([-2.0, 0.0, 0.5]), ratio * np.array([0.0, 2.0, 0.0])
        seen = [image(one, a, b, twin_rad=2.0, excess=50.0) for one in cameras]
        found = with_phase_prior(phased_candidate(cameras, exterior, seen)).axis_ratio
        assert found is not None
        penalties.append(found.penalty(UNKNOWN_CAPTURE))
    assert penalties[0] < 0.5
    assert np.all(np.diff(penalties) > -1e-6)
    assert 5.0 < penalties[-1] < 12.0


def test_targets_that_need_no_prior_say_how_many_orbits_there_are() -> None:
    lines = [AxisRatio(0.01 * (index % 4), 0.03) for index in range(30)]
    orbits = [AxisRatio(ratio, 0.03) for ratio in np.linspace(0.2, 0.9, 30)]
    assert estimate_orbit_prior([]) == UNKNOWN_CAPTURE
    assert estimate_orbit_prior(lines).orbit_share < 0.06
    assert estimate_orbit_prior(lines).in_phase_ratio == INTERSECTION.in_phase_ratio
    assert 0.4 < estimate_orbit_prior([*lines, *orbits]).orbit_share < 0.6
    few = OrbitPrior(0.03)
    assert lines[0].penalty(few) == pytest.approx(0.0, abs=1e-9)
    assert orbits[0].penalty(few) > orbits[0].penalty(OrbitPrior(0.2)) + 3.0


def test_targets_that_all_move_on_thin_orbits_widen_what_counts_as_in_phase() -> None:
    """Between two modes of different direction: lines of no width pulled the others' phases by several sd."""
    ratios = np.abs(np.random.default_rng(4).normal(0.0, 0.1, 12))
    found = estimate_orbit_prior([AxisRatio(float(ratio), 0.02) for ratio in ratios])
    assert 0.05 < found.in_phase_ratio < 0.2
    assert found.orbit_share < 0.25


def test_level_motion_on_lines_leaves_no_twin_open(look) -> None:
    """In the epipolar plane every twin is an orbit that the rays allow: the other targets say that there are none."""
    cameras = dict(zip("lr", [look(place) for place in LEVEL], strict=True))
    a, b = np.array([-2.0, 1.0, 0.0]), np.array([-1.0, 0.5, 0.0])
    seen = {
        f"T{index}": {
            name: image(one, a, b, twin_rad=1.2 + (name == "l"), excess=0.5 if index < 2 else 40.0, sd_px=0.8)
            for name, one in cameras.items()
        }
        for index in range(12)
    }
    assert Flag.AMBIGUOUS in intersect_targets(cameras, {"T0": seen["T0"]}).motions["T0"].flags
    found = intersect_targets(cameras, seen)
    assert not any(motion.flags for motion in found.motions.values())


def noisy_image(camera, a, b, sd_phase: float, rng) -> ImageMotion:
    """A camera's image of a motion in phase, of which it knows the phase within `sd_phase`."""
    numbers = project_motion(camera.project_with_jacobians, np.stack([MEAN, a, b]))[0]
    later = np.concatenate((np.zeros(2), -numbers[4:], numbers[2:4]))
    noise = np.eye(6) * SD_PX**2 + sd_phase**2 * np.outer(later, later)
    return ImageMotion(*np.split(numbers + rng.multivariate_normal(np.zeros(6), noise), [2, 4]), noise, True)


def test_level_motion_takes_its_phase_from_the_camera_that_knows_it(look) -> None:
    """One camera looks along the path, and knows little of the phase: rays alone make an orbit of that."""
    cameras = [look(place) for place in LEVEL]
    rng = np.random.default_rng(3)
    free_errors, errors, squares = [], [], []
    for phase in np.linspace(0.0, 3.0, 40):
        path = np.array([1.0, -1.3, 0.0])
        a, b = path * np.cos(phase), path * np.sin(phase)
        seen = [noisy_image(cameras[0], a, b, 0.004, rng), noisy_image(cameras[1], a, b, 0.15, rng)]
        free = phased_candidate(cameras, np.zeros((12, 12)), seen)
        joined = intersect_motion(cameras, seen).motion
        away = np.concatenate((joined.a_mm - a, joined.b_mm - b))
        free_errors.append(np.linalg.norm(free.motion_mm[1:] - np.stack((a, b))))
        errors.append(np.linalg.norm(away))
        squares.append(away @ np.linalg.pinv(joined.covariance_mm2[3:, 3:], hermitian=True) @ away / 6)
    assert np.percentile(errors, 95) < 0.5 * np.percentile(free_errors, 95)
    assert 0.4 < np.mean(squares) < 1.4


@pytest.mark.parametrize("places", [TWO, LEVEL])
def test_an_orbit_that_the_rays_show_stays_an_orbit(look, places) -> None:
    cameras = [look(place) for place in places]
    a, b = np.array([-2.0, 0.4, 0.3]), np.array([0.1, 0.2, 0.9])
    seen = [noisy_image(camera, a, b, 0.003, np.random.default_rng(5)) for camera in cameras]
    free = phased_candidate(cameras, np.zeros((12, 12)), seen)
    np.testing.assert_allclose(with_phase_prior(free).motion_mm, free.motion_mm, atol=1e-3)


def test_a_small_minor_axis_stays_within_its_standard_deviation(look) -> None:
    """A complex mode of a lightly damped structure: the prior leans towards a line, and says by how much."""
    cameras = [look(place) for place in LEVEL]
    rng = np.random.default_rng(8)
    squares = []
    for _ in range(30):
        minor = 0.02 * 1.6 * rng.normal()
        a, b = np.array([1.0, -1.3, 0.0]), minor * np.array([1.3, 1.0, 0.0]) / 1.64
        seen = [noisy_image(camera, a, b, 0.03, rng) for camera in cameras]
        joined = intersect_motion(cameras, seen).motion
        away = np.concatenate((joined.a_mm - a, joined.b_mm - b))
        squares.append(away @ np.linalg.pinv(joined.covariance_mm2[3:, 3:], hermitian=True) @ away / 6)
    assert 0.4 < np.mean(squares) < 1.5


def test_combinations_are_sorted_by_all_that_speaks_against_them(look) -> None:
    cameras = [look(place) for place in TWO]
    a, b = np.array([-2.0, 1.0, 0.5]), np.array([-1.0, 0.5, 0.25])
    seen = [image(one, a, b, twin_rad=2.0, excess=6.0) for one in cameras]
    found = signed_candidates(cameras, np.zeros((12, 12)), seen)
    assert len(found) == 4
    costs = [one.total_cost for one in found]
    assert costs == sorted(costs)
    assert costs[-1] > 100  # one camera on its twin, the other not: the rays do not meet


def motion(phase: float, sign: float = 1.0, place: float = 0.0) -> ObjectMotion:
    v = sign * np.array([1.0, 0.4, 0.2])
    zero = np.array([place, 0.0, 0.0])
    return ObjectMotion(zero, v * np.cos(phase), v * np.sin(phase), np.eye(9) * 1e-4)


def test_the_phase_of_a_motion_does_not_depend_on_its_sign() -> None:
    one, opposite = (major_phase_rad(each.a_mm, each.b_mm) for each in (motion(0.7), motion(0.7, -1.0)))
    assert abs(within_half_turn(np.array(one - opposite))) < 1e-9


def test_targets_at_one_phase_speak_for_the_twin_that_shares_it() -> None:
    settled = [motion(0.7 + 0.01 * index, (-1.0) ** index) for index in range(8)]
    assert compare_phases((motion(0.72), motion(2.0)), settled) > 4.0
    assert compare_phases((motion(2.0), motion(0.72)), settled) < -4.0


def test_targets_at_any_phase_speak_for_nothing() -> None:
    scattered = [motion(phase) for phase in np.linspace(0, np.pi, 9)[:-1]]
    assert compare_phases((motion(0.72), motion(2.0)), scattered) == 0.0
    assert compare_phases((motion(0.72), motion(2.0)), scattered[:3]) == 0.0


def test_a_common_phase_settles_what_the_cameras_leave_open(look) -> None:
    cameras = dict(zip("lr", [look(place) for place in TWO], strict=True))
    a, b = np.array([-2.0, 1.0, 0.5]), np.array([-1.0, 0.5, 0.25])
    images = {
        f"T{index}": {
            name: image(one, a, b, twin_rad=2.0, excess=3.0 if index == 0 else 40.0) for name, one in cameras.items()
        }
        for index in range(8)
    }
    found = intersect_targets(cameras, images)
    assert found.resolved_by["T0"] == "common phase"
    assert not found.motions["T0"].flags
