"""Members of a phased group that show another motion than the others are flagged; members of one motion are not."""

import numpy as np
import pytest

from labdaemon.blur import Defocus, Dot, ExposureWindow, LightCode, fit_sharp, measure_group, named_code
from labdaemon.blur.smear.frame_set import orbit_vectors
from labdaemon.blur.smear.member_agreement import _explained
from labdaemon.flags import Flag

STILL = Defocus(0.0, 0.01)
PHASES = (0.4, 0.4 + np.pi / 2)
MOTION = (3.0, 1.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def sharp(area):
    scene = area.Scene(radius_px=12.0)
    return fit_sharp(
        Dot(30, 30, 12, 12, 0.0, name="t"), [area.render(scene, (60, 60), (30.2, 29.7), seed=1)], noise=scene.noise
    )


def group(area, sharp, motions, seed=3):
    scene = area.Scene(radius_px=12.0)
    images = [
        area.render(scene, (64, 60), (30 + 0.1 * i, 32), area.part_cycles(*m, 5.5, p), seed=10 * seed + i, samples=160)
        for i, (m, p) in enumerate(zip(motions, PHASES, strict=True))
    ]
    windows = [ExposureWindow(5.5, 1.0, p) for p in PHASES]
    return measure_group(sharp, images, windows, defocus=STILL)


@pytest.fixture(scope="module")
def agreeing_sd_px(area, sharp):
    return group(area, sharp, (MOTION, MOTION)).sd_px


@pytest.mark.parametrize("other", [(3.3, 1.1, 0.0, 0.0), (2.9, 1.3, 0.0, 0.0), (1.0, -3.0, 0.0, 0.0)])
def test_a_member_of_another_motion_is_flagged_and_the_sd_covers_both(area, sharp, agreeing_sd_px, other):
    found = group(area, sharp, (MOTION, other))
    assert Flag.CONTRADICTS_GROUP in found.flags
    assert found.sd_px > 2 * agreeing_sd_px


@pytest.mark.parametrize("motion", [MOTION, (2.0, -0.5, -2.0, 0.5)])
def test_members_of_one_motion_agree(area, sharp, motion):
    assert Flag.CONTRADICTS_GROUP not in group(area, sharp, (motion, motion), seed=5).flags


@pytest.mark.parametrize(("other", "contradicts"), [((2.4, 1.8, 0.0, 0.0), False), ((2.4, -1.8, 0.0, 0.0), True)])
def test_members_under_coded_light_are_compared(area, sharp, other, contradicts):
    code = named_code("1110100")
    theta = (np.arange(20_000) + 0.5) / 20_000 * 2 * np.pi
    light = np.asarray(code)[(theta / (2 * np.pi) * len(code)).astype(int)]
    share = np.concatenate(([0.0], np.cumsum(light) / light.sum()))

    def path(motion):
        def places(t):
            angle = np.interp(t, share, np.linspace(0, 2 * np.pi, 20_001))
            ax, ay, bx, by = motion
            return ax * np.sin(angle) + bx * np.cos(angle), ay * np.sin(angle) + by * np.cos(angle)

        return places

    scene = area.Scene(radius_px=12.0)
    images = [
        area.render(scene, (60, 60), (30.2, 29.8), path(motion), seed=4 + i, samples=160)
        for i, motion in enumerate(((2.4, 1.8, 0.0, 0.0), other))
    ]
    windows = [ExposureWindow(5.0, 1.0, light=LightCode(code, 0.0, 5))] * 2
    found = measure_group(sharp, images, windows, defocus=STILL)
    assert (Flag.CONTRADICTS_GROUP in found.flags) is contradicts


@pytest.mark.parametrize(("motion", "expected"), [((1.0, 2.0, 0.5), None), ((1.0, 2.0, 3.0, 4.0), (1, 2, 3, 4))])
def test_vectors_of_an_in_phase_motion_and_of_an_orbit(motion, expected):
    got = orbit_vectors(np.array(motion))
    if expected is None:
        expected = (np.cos(0.5), 2 * np.cos(0.5), np.sin(0.5), 2 * np.sin(0.5))
    assert got == pytest.approx(expected)


def test_directions_without_information_do_not_count():
    squared, rank = _explained(np.diag([4.0, 1.0, 1e-9, 0.0]), np.array([2.0, 1.0, 5.0, 5.0]))
    assert rank == 2
    assert squared == pytest.approx(2.0, rel=1e-3)
