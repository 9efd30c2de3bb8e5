"""Signed vectors of which two cameras hardly know the phase."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.geometry import ImageMotion, ObjectMotion, intersect_motion
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.motion_candidates import sign_penalty_of, straight_candidates
from labdaemon.geometry.phase_fusion import with_minor_axes

PLACES = [(-500, -1000, 300), (500, -1000, 500)]
SD_PX = 0.005


def seen(camera, mean, v, phase: float, kappa: float, rng) -> ImageMotion:
    """One camera's signed vectors, their phase drawn from a von Mises distribution; and the same without phase."""
    off = phase + rng.vonmises(0.0, kappa)
    image = project_motion(camera.project_with_jacobians, np.stack([mean, v, 0 * v]))[0]
    axis = image[2:4] + SD_PX * rng.normal(size=2)
    draws = np.array([[np.cos(p), np.sin(p)] for p in off + rng.vonmises(0.0, kappa, 4000)])
    away = (draws - [np.cos(off), np.sin(off)])[:, :, None] * axis
    covariance = np.eye(6) * SD_PX**2
    covariance[2:, 2:] += np.einsum("nij,nkl->ijkl", away, away).reshape(4, 4) / len(draws)
    place = image[:2] + SD_PX * rng.normal(size=2)
    plain = ImageMotion(place, axis * rng.choice([-1.0, 1.0]), np.zeros(2), np.eye(6) * SD_PX**2)
    return ImageMotion(place, np.cos(off) * axis, np.sin(off) * axis, covariance, True, plain)


@pytest.mark.parametrize("kappa", [0.3, 3.0])
def test_the_amplitude_survives_and_the_deviations_are_true(look, kappa: float) -> None:
    rng = np.random.default_rng(5)
    cameras = [look(place, roll=0.1 * i) for i, place in enumerate(PLACES)]
    lengths, pulls = [], []
    for _ in range(80):
        mean, v = rng.uniform([-150, -80, 150], [150, 80, 600]), rng.normal(0, 0.3, 3)
        phase = rng.uniform(0, 2 * np.pi)
        motion = intersect_motion(cameras, [seen(camera, mean, v, phase, kappa, rng) for camera in cameras]).motion
        if motion.flags:
            continue
        lengths.append(np.hypot(np.linalg.norm(motion.a_mm), np.linalg.norm(motion.b_mm)) - np.linalg.norm(v))
        error = np.concatenate([motion.a_mm - v * np.cos(phase), motion.b_mm - v * np.sin(phase)])
        pulls.append(error / np.sqrt(np.diag(motion.covariance_mm2)[3:]))
    assert len(lengths) > 70
    assert np.percentile(np.abs(lengths), 95) < 0.02
    assert 0.8 < np.sqrt(np.mean(np.square(pulls))) < 1.25


def test_signs_settle_ends_that_the_rays_leave_open(look) -> None:
    """All in the epipolar plane: both matches fit equally well, but only one agrees with the phases."""
    rng = np.random.default_rng(3)
    cameras = [look((-500, -1000, 370)), look((500, -1000, 370))]
    for _ in range(10):
        mean, v = np.array([rng.uniform(-100, 100), rng.uniform(-60, 60), 370.0]), np.array([*rng.normal(0, 2, 2), 0.0])
        motions, evidence = [], []
        for camera in cameras:
            image = project_motion(camera.project_with_jacobians, np.stack([mean, v, 0 * v]))[0]
            turn = rng.choice([-1.0, 1.0])
            place, a = image[:2] + SD_PX * rng.normal(size=2), turn * (image[2:4] + SD_PX * rng.normal(size=2))
            motions.append(ImageMotion(place, a, np.zeros(2), np.eye(6) * SD_PX**2))
            evidence.append(-30.0 * turn)  # at the middle of the exposure it stood at −v
        joined = intersect_motion(cameras, motions, evidence=evidence)
        assert not joined.motion.flags
        assert min(np.linalg.norm(joined.motion.a_mm - s * v) for s in (1, -1)) < 0.05
        best = straight_candidates(cameras, np.zeros((12, 12)), motions, evidence)[0]
        assert best.sign_penalty == 0.0


def test_evidence_speaks_against_one_match_whichever_end_it_was() -> None:
    evidence = np.array([20.0, -12.0, 0.0])
    assert sign_penalty_of(evidence, (1.0, -1.0, 1.0)) == 0.0
    assert sign_penalty_of(evidence, (-1.0, 1.0, 1.0)) == 0.0
    assert sign_penalty_of(evidence, (1.0, 1.0, -1.0)) == 12.0


def test_a_minor_axis_counts_where_a_camera_sees_more_of_it_than_of_the_path(look) -> None:
    """One camera looks along the path, the other across it; the orbit's minor axis is a twentieth of the major one."""
    cameras = [look((-500, -1000, 370)), look((500, -1000, 370))]
    mean, ratio = np.array([0.0, 0.0, 370.0]), 0.05
    ray = mean - cameras[1].position_mm
    path = 2.0 * ray / np.linalg.norm(ray)
    motion = ObjectMotion(mean, path, np.zeros(3), np.eye(9) * 1e-6)
    axes = [ImageMotion(np.zeros(2), np.array([0.3, 0.0]), np.zeros(2), np.eye(6) * 1e-6) for _ in cameras]
    across, along = (one.covariance_px2[2:4, 2:4] for one in with_minor_axes(cameras, axes, motion, ratio))
    minor_px2 = (ratio * 2.0 * 3937.7 / np.linalg.norm(ray)) ** 2
    np.testing.assert_allclose(np.diag(along), minor_px2, rtol=0.1)
    assert np.trace(across) < 0.01 * minor_px2
    assert np.allclose(axes[0].covariance_px2, np.eye(6) * 1e-6)  # what was given stays
