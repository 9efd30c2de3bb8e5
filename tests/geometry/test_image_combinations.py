"""A camera that looks along the path: its phase is the other camera's, its sign is by rays and the place of rest."""

from __future__ import annotations

import numpy as np

from labdaemon.flags import Flag
from labdaemon.geometry import ImageMotion, intersect_motion
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.image_combinations import combine_images
from labdaemon.geometry.orbit_prior import UNKNOWN_CAPTURE
from labdaemon.rest_place import RestPlace

LEVEL = [(-500, -1000, 370), (500, -1000, 370)]
MEAN = np.array([20.0, 10.0, 370.0])
SD_PX, AXIS_SD_PX, ARC_SD_RAD, SHIFT = 0.012, 0.03, 0.15, 0.35


def clear(camera, a, b, rng) -> ImageMotion:
    image = project_motion(camera.project_with_jacobians, np.stack([MEAN, a, b]))[0]
    return ImageMotion(*np.split(image + SD_PX * rng.normal(size=6), [2, 4]), np.eye(6) * SD_PX**2, True)


def along(camera, a, b, rng, *, at_rest: bool) -> ImageMotion:
    """An image that shows the axis, nothing of the phase, and the mean position less the code's shift."""
    image = project_motion(camera.project_with_jacobians, np.stack([MEAN, a, b]))[0]
    phase = np.angle(np.sum((image[2:4] + 1j * image[4:]) ** 2)) / 2
    v = np.cos(phase) * image[2:4] + np.sin(phase) * image[4:] + AXIS_SD_PX * rng.normal(size=2)
    seen = image[:2] + SHIFT * image[2:4] + 0.01 * rng.normal(size=2)
    n = np.array([-v[1], v[0]]) / np.linalg.norm(v)
    rest = RestPlace(image[:2], np.full(2, 1e-4)) if at_rest else None
    row = []
    for angle in np.arange(0.0, 2 * np.pi, 1.6 * ARC_SD_RAD):
        c, s = np.cos(angle), np.sin(angle)
        held, turn, across = np.zeros((6, 2)), np.zeros(6), np.zeros(6)
        held[:2], held[2:4], held[4:] = -SHIFT * c * np.eye(2), c * np.eye(2), s * np.eye(2)
        turn[:2], turn[2:4], turn[4:] = SHIFT * s * v, -s * v, c * v
        across[:2], across[2:4], across[4:] = SHIFT * s * n, -s * n, c * n
        covariance = (
            AXIS_SD_PX**2 * held @ held.T + ARC_SD_RAD**2 * np.outer(turn, turn) + 0.05**2 * np.outer(across, across)
        )
        covariance[:2, :2] += 1e-4 * np.eye(2)
        place = seen - SHIFT * c * v
        excess = 0.0 if rest is None else rest.excess(place, covariance[:2, :2])
        row.append(ImageMotion(place, c * v, s * v, covariance, True, excess=excess))
    row.sort(key=lambda one: one.excess)
    axes = ImageMotion(seen, v, np.zeros(2), np.eye(6) * AXIS_SD_PX**2)
    return ImageMotion(row[0].mean_px, row[0].a_px, row[0].b_px, np.eye(6), True, axes, (), tuple(row), rest)


def test_the_motion_along_a_ray_has_its_sign_and_true_deviations(look) -> None:
    rng = np.random.default_rng(11)
    cameras = [look(place) for place in LEVEL]
    ray = MEAN - cameras[1].position_mm
    pulls, ambiguous = [], 0
    for phase in np.linspace(0.0, 2 * np.pi, 30):
        path = rng.uniform(0.5, 2.5) * (ray / np.linalg.norm(ray) + [*rng.normal(0, 0.12, 2), 0.0])
        minor = 0.02 * np.linalg.norm(path) * rng.normal() * np.array([path[1], -path[0], 0.0]) / np.linalg.norm(path)
        a, b = np.cos(phase) * path - np.sin(phase) * minor, np.sin(phase) * path + np.cos(phase) * minor
        seen = [clear(cameras[0], a, b, rng), along(cameras[1], a, b, rng, at_rest=True)]
        motion = intersect_motion(cameras, seen).motion
        if Flag.AMBIGUOUS in motion.flags:
            ambiguous += 1
            continue
        error = np.concatenate((motion.a_mm - a, motion.b_mm - b))
        pulls.append(error / np.sqrt(np.diag(motion.covariance_mm2)[3:]))
    assert ambiguous <= 12  # where the shift of the code is nothing, no place of rest shows a sign
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.3
    assert np.abs(pulls).max() < 4.5


def test_signs_that_nothing_decides_are_ambiguous(look) -> None:
    rng = np.random.default_rng(12)
    cameras = [look(place) for place in LEVEL]
    ray = MEAN - cameras[1].position_mm
    path = 2.0 * ray / np.linalg.norm(ray) + np.array([0.3, 0.0, 0.0])
    seen = [clear(cameras[0], path, 0 * path, rng), along(cameras[1], path, 0 * path, rng, at_rest=False)]
    joined = intersect_motion(cameras, seen)
    assert Flag.AMBIGUOUS in joined.motion.flags
    assert joined.alternative is not None


def test_only_motions_that_the_rays_allow_are_intersected(look) -> None:
    rng = np.random.default_rng(13)
    cameras = [look(place) for place in LEVEL]
    path = np.array([1.0, 1.4, 0.8])
    seen = [clear(cameras[0], path, 0 * path, rng), along(cameras[1], path, 0 * path, rng, at_rest=False)]
    combinations = combine_images(cameras, seen, MEAN, UNKNOWN_CAPTURE)
    assert 1 <= len(combinations) < 8 < len(seen[1].arc)
    assert all(first is combinations[0][0] for first, _ in combinations)
