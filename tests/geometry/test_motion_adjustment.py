"""One target's motion from its images: the nearest point of rays, and the adjustment with its covariance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.motion_adjustment import Candidate, adjust_motion, nearest_point
from labdaemon.geometry.oriented_camera import OrientedCamera

MOTION = np.array([[30.0, -20.0, 380.0], [3.0, 1.0, 0.5], [-0.5, 1.5, 0.2]])


@pytest.fixture(scope="module")
def cameras(look: Callable[..., OrientedCamera]) -> list[OrientedCamera]:
    return [look((-400.0, -900.0, 500.0)), look((400.0, -900.0, 450.0)), look((0.0, -950.0, 900.0), roll=1.5)]


def images(cameras: list[OrientedCamera], motion: np.ndarray = MOTION) -> list[np.ndarray]:
    return [project_motion(camera.project_with_jacobians, motion)[0] for camera in cameras]


def adjust(cameras: list[OrientedCamera], observed: list[np.ndarray], exterior: np.ndarray | None = None) -> Candidate:
    return adjust_motion(
        cameras,
        np.zeros((6 * len(cameras),) * 2) if exterior is None else exterior,
        observed,
        [1e-4 * np.eye(6)] * len(cameras),
        lambda image, by_motion, by_exterior: (image, by_motion, by_exterior),
        range(9),
        np.stack([MOTION[0] + 5.0, np.ones(3), np.zeros(3)]),
    )


@pytest.mark.parametrize("count", [2, 3])
def test_exact_images_give_the_motion(cameras: list[OrientedCamera], count: int) -> None:
    found = adjust(cameras[:count], images(cameras[:count]))
    np.testing.assert_allclose(found.motion_mm, MOTION, atol=1e-5)
    assert found.cost < 1e-6
    assert found.freedom == 6 * count - 9
    assert found.total_cost == found.cost


def test_the_covariance_is_the_scatter_of_noisy_images(cameras: list[OrientedCamera]) -> None:
    rng = np.random.default_rng(3)
    exact, pulls = images(cameras), []
    for _ in range(60):
        found = adjust(cameras, [one + rng.normal(0, 1e-2, 6) for one in exact])
        sd = np.sqrt(np.diag(found.covariance_mm2))
        pulls.append((found.motion_mm - MOTION).reshape(9) / sd)
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((spread > 0.7) & (spread < 1.35)), spread


def test_uncertain_cameras_make_the_place_uncertain_not_the_motion(cameras: list[OrientedCamera]) -> None:
    """A camera that is turned shifts all of a path's points together."""
    exterior = np.kron(np.eye(3), np.diag([1e-8, 1e-8, 1e-8, 0.04, 0.04, 0.04]))
    sure, unsure = (np.sqrt(np.diag(adjust(cameras, images(cameras), e).covariance_mm2)) for e in (None, exterior))
    assert np.all(unsure[:3] > 3 * sure[:3])
    assert np.all(unsure[3:] < 1.5 * sure[3:])


def test_a_second_moment_leaves_the_phase_free(cameras: list[OrientedCamera]) -> None:
    """What shows no phase is solved with the phase held, and the minimum does not depend on where it is held."""
    found = adjust_motion(
        cameras, np.zeros((18, 18)), images(cameras), [1e-4 * np.eye(6)] * 3,
        lambda image, by_motion, by_exterior: (image, by_motion, by_exterior), range(9), MOTION.copy(), phase_free=True,
    )  # fmt: skip
    turn = np.concatenate([np.zeros(3), MOTION[2], -MOTION[1]])
    free = adjust(cameras, images(cameras))
    assert turn @ found.covariance_mm2 @ turn <= turn @ free.covariance_mm2 @ turn * (1 + 1e-6)
    assert found.freedom == free.freedom + 1


def test_the_nearest_point_of_exact_rays_is_where_they_meet(cameras: list[OrientedCamera]) -> None:
    place = np.array([50.0, 10.0, 300.0])
    pixels = [camera.project(place[None])[0] for camera in cameras]
    np.testing.assert_allclose(nearest_point(cameras, pixels), place, atol=1e-5)


def test_rays_that_say_nothing_of_the_depth_are_refused(
    cameras: list[OrientedCamera], look: Callable[..., OrientedCamera]
) -> None:
    with pytest.raises(DataError, match="one camera only"):
        nearest_point(cameras[:1], [np.array([1900.0, 1300.0])])
    close = [cameras[0], look((-399.0, -900.0, 500.0))]
    pixels = [camera.project(MOTION[:1])[0] for camera in close]
    with pytest.raises(DataError, match="nearly parallel"):
        nearest_point(close, pixels)
    with pytest.raises(DataError, match="folds over"):
        nearest_point(cameras[:2], [np.array([np.nan, 0.0])] * 2)
