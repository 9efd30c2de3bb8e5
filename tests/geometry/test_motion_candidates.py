"""Which solution is meant when cameras see a path without its phase."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.motion import ImageMotion
from labdaemon.geometry.motion_candidates import (
    orbit_candidates,
    phased_candidate,
    sign_penalty_of,
    straight_candidates,
)
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.orbit_axes import principal_axes

MEAN, A, B = np.array([30.0, -20.0, 380.0]), np.array([3.0, 1.0, 2.0]), np.array([-0.6, 1.2, 0.3])
NOISE = 1e-4 * np.eye(6)


@pytest.fixture(scope="module")
def cameras(look: Callable[..., OrientedCamera]) -> list[OrientedCamera]:
    return [look((-400.0, -900.0, 500.0)), look((400.0, -900.0, 450.0)), look((0.0, -950.0, 1000.0), roll=1.5)]


def seen(cameras: list[OrientedCamera], a: np.ndarray, b: np.ndarray, *, phased: bool = False) -> list[ImageMotion]:
    found = []
    for camera in cameras:
        image = project_motion(camera.project_with_jacobians, np.stack([MEAN, a, b]))[0]
        one, other = image[2:4], image[4:]
        if not phased:
            one, other, _ = principal_axes(one, other, np.zeros((4, 4)))
        found.append(ImageMotion(image[:2], one, other, NOISE, phased=phased))
    return found


def exterior(count: int) -> np.ndarray:
    return np.zeros((6 * count, 6 * count))


@pytest.mark.parametrize("count", [2, 3])
def test_ends_are_matched_by_the_better_fit(cameras: list[OrientedCamera], count: int) -> None:
    some = cameras[:count]
    best, other = straight_candidates(some, exterior(count), seen(some, A, np.zeros(3)))
    assert min(np.linalg.norm(best.motion_mm[1] - A), np.linalg.norm(best.motion_mm[1] + A)) < 0.01
    np.testing.assert_allclose(best.motion_mm[2], 0.0)
    assert best.total_cost < other.total_cost


def test_evidence_of_signs_is_weighed_against_the_fit(cameras: list[OrientedCamera]) -> None:
    """Cameras whose images point to different sides: what they say of the signs decides where the fit does not."""
    pair = cameras[:2]
    motions = seen(pair, A, np.zeros(3))
    best, other = straight_candidates(pair, exterior(2), motions)
    signs = [np.sign(m.a_px @ project_motion(c.project_with_jacobians, best.motion_mm)[0][2:4])
             for m, c in zip(motions, pair, strict=True)]  # fmt: skip
    agreeing = straight_candidates(pair, exterior(2), motions, [5.0 * sign for sign in signs])
    assert agreeing[0].sign_penalty == 0.0
    against = straight_candidates(pair, exterior(2), motions, [5.0 * signs[0], -5.0 * signs[1]])
    assert next(one for one in against if one.sign_penalty > 0).cost == pytest.approx(best.cost, abs=1e-6)
    assert other.sign_penalty == 0.0


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(-50, 50), st.sampled_from([-1.0, 1.0])), min_size=2, max_size=5))
def test_a_penalty_is_bounded_and_knows_no_overall_sign(pairs: list[tuple[float, float]]) -> None:
    evidence, signs = np.array([one for one, _ in pairs]), [sign for _, sign in pairs]
    penalty = sign_penalty_of(evidence, signs)
    assert 0.0 <= penalty <= len(pairs) * INTERSECTION.max_evidence
    assert sign_penalty_of(evidence, [-sign for sign in signs]) == penalty
    assert sign_penalty_of(np.abs(evidence) * signs, signs) == 0.0, "all on one side"


def test_signed_vectors_leave_nothing_to_match(cameras: list[OrientedCamera]) -> None:
    found = phased_candidate(cameras, exterior(3), seen(cameras, A, B, phased=True))
    np.testing.assert_allclose(found.motion_mm, np.stack([MEAN, A, B]), atol=1e-4)


def axes(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    major, minor, _ = principal_axes(a, b, np.zeros((6, 6)))
    return major, minor


def test_an_orbit_is_among_the_roots_of_two_cameras_and_alone_for_three(cameras: list[OrientedCamera]) -> None:
    major, minor = axes(A, B)

    def miss(motion_mm: np.ndarray) -> float:
        return max(
            min(np.linalg.norm(got - true), np.linalg.norm(got + true))
            for got, true in ((motion_mm[1], major), (motion_mm[2], minor))
        )

    two = orbit_candidates(cameras[:2], exterior(2), seen(cameras[:2], A, B))
    assert min(miss(one.motion_mm) for one in two) < 0.02
    three = orbit_candidates(cameras, exterior(3), seen(cameras, A, B))
    assert miss(three[0].motion_mm) < 0.02
    assert all(other.cost > three[0].cost for other in three[1:])


def test_candidates_come_best_first_and_are_distinct(cameras: list[OrientedCamera]) -> None:
    found = orbit_candidates(cameras, exterior(3), seen(cameras, A, B))
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    for index, one in enumerate(found):
        for other in found[:index]:
            assert np.abs(one.motion_mm - other.motion_mm).max() > 1e-3


def test_one_camera_has_no_candidate(cameras: list[OrientedCamera]) -> None:
    motions = seen(cameras[:1], A, np.zeros(3))
    for solve in (straight_candidates, orbit_candidates, phased_candidate):
        with pytest.raises(DataError, match="one camera only"):
            solve(cameras[:1], exterior(1), motions)
