import numpy as np
import pytest

from labdaemon.blur.average import average_measurements
from labdaemon.blur.motion import Measurement
from labdaemon.flags import Flag


def member(a, b=(0.0, 0.0), sd=0.01, sd_minor_px2=0.02, flags=()):
    """A straight path's measurement, as the fit of whole cycles reports it."""
    a, b = np.array(a, float), np.array(b, float)
    across = np.array([-a[1], a[0]]) / max(np.hypot(*a), 1e-12)
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = sd**2 * np.eye(4)
    covariance[4:, 4:] = sd_minor_px2 * np.outer(across, across) if not b.any() else sd**2 * np.eye(2)
    return Measurement("t", np.array([30.0, 30.0]), a, b, covariance, flags=frozenset(flags))


@pytest.mark.parametrize(
    ("first", "second"),
    [((6, 0), (0, 6)), ((6, 0), (6.4, 0)), ((0.8, 0.0), (1.2, 0.0)), ((3, 3), (3, -3)), ((40, 0), (2, 0))],
)
def test_members_that_contradict_each_other_are_flagged_whatever_the_size(first, second):
    mean = average_measurements([member(first), member(second)])
    assert Flag.CONTRADICTS_GROUP in mean.flags
    sd = np.sqrt(np.diag(mean.covariance_px2)[2:4])
    assert np.all(np.abs(np.abs(mean.a_px) - np.abs(second)) < 3 * sd + 0.05)


def test_one_of_many_members_that_differs_is_seen():
    same = [member((5.0, 1.0)) for _ in range(7)]
    assert not average_measurements(same).flags
    assert Flag.CONTRADICTS_GROUP in average_measurements([*same, member((5.15, 1.0))]).flags


def test_an_orbit_against_a_straight_path_of_the_same_major_axis_is_a_contradiction():
    assert Flag.CONTRADICTS_GROUP in average_measurements([member((5, 0), (0, 2)), member((5, 0))]).flags


def test_rest_in_one_member_and_motion_in_the_other_is_a_contradiction():
    still = member((0.05, 0.0), sd=0.2, sd_minor_px2=0.05, flags={Flag.AT_REST})
    mean = average_measurements([still, member((3, 0))])
    assert mean.flags == {Flag.CONTRADICTS_GROUP}


def test_members_of_one_motion_are_not_flagged_whatever_sign_their_axes_have():
    rng = np.random.default_rng(1)
    for size in (0.0, 0.3, 1.0, 5.0, 30.0):
        for _ in range(100):
            group = [
                member(rng.choice([-1, 1]) * (np.array([size, 0.3 * size]) + 0.01 * rng.normal(size=2))) for _ in "ab"
            ]
            assert Flag.CONTRADICTS_GROUP not in average_measurements(group).flags
