"""Space intersection: one target's motion from its images in several cameras, by generalised least squares.

The observations' covariance is that of the images plus what the uncertainty of the cameras' orientation makes of
them, so that cameras whose errors hang together (oriented on the same survey) are weighed as they should be, and the
result's covariance is complete.

The iteration is not `labdaemon.least_squares.minimise`: the weights follow the motion (a nearer target shows more of a
camera's uncertainty), so the sums of squares of two steps do not compare, and there is nothing that damping could go
by. From a start by rays that meet, undamped steps converge in three or four.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One solution of an intersection.

    Attributes
    ----------
    motion_mm
        (3, 3): mean, a and b.
    covariance_mm2
        (9, 9).
    cost
        Sum of squared normalised residuals.
    freedom
        Its degrees of freedom.
    worst_px
        Largest residual of an observation (px, or px² for second moments).
    sign_penalty
        What is known otherwise of the ends' signs and contradicts it, as a sum of squares.
    """

    motion_mm: FloatArray
    covariance_mm2: FloatArray
    cost: float
    freedom: int
    worst_px: float
    sign_penalty: float = 0.0

    @property
    def total_cost(self) -> float:
        """Residuals and all else that speaks against it, as a sum of squares."""
        return self.cost + self.sign_penalty


def nearest_point(cameras: Sequence[OrientedCamera], mean_px: Sequence[FloatArray]) -> FloatArray:
    """(3,) point nearest to all rays, mm; a start for the adjustment.

    Raises
    ------
    DataError
        Fewer than two cameras, a pixel that the lens cannot undistort, or rays that are nearly parallel.
    """
    if len(cameras) < 2:
        raise DataError("seen by one camera only: its depth is unknown")
    directions = np.concatenate([camera.rays(px[None]) for camera, px in zip(cameras, mean_px, strict=True)])
    if not np.isfinite(directions).all():
        raise DataError("a target lies where a lens model folds over")
    centres = np.stack([camera.position_mm for camera in cameras])
    cosines = np.abs(directions @ directions.T)
    if np.arccos(np.clip(cosines.min(), 0.0, 1.0)) < INTERSECTION.min_ray_angle_rad:
        raise DataError("its rays are nearly parallel: move the cameras apart")
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    return np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centres))


ObservationModel = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""Image (6,) of one camera, its derivatives by motion (6, 9) and exterior (6, 6) -> what is observed of it."""


def adjust_motion(
    cameras: Sequence[OrientedCamera],
    exterior: FloatArray,
    observed: Sequence[FloatArray],
    noise: Sequence[FloatArray],
    model: ObservationModel,
    free: Sequence[int],
    start: FloatArray,
    *,
    phase_free: bool = False,
) -> Candidate:
    """Gauss–Newton over a target's motion.

    Parameters
    ----------
    cameras
        The n cameras.
    exterior
        (6 n, 6 n) joint covariance of their exterior parameters.
    observed, noise
        For each camera (k,) observations and their (k, k) covariance.
    model
        Takes a camera's image to its observations.
    free
        Which of the nine parameters (mean, a, b) are solved for; the others keep their start.
    start
        (3, 3).
    phase_free
        The observations do not tell where on its orbit the target starts: hold a's and b's common phase.

    Returns
    -------
    Candidate
    """
    motion, columns = start.copy(), list(free)
    target = np.concatenate(list(observed))
    rows = len(observed[0])
    image_noise = np.zeros((len(target), len(target)))
    for index, block in enumerate(noise):
        place = slice(index * rows, (index + 1) * rows)
        image_noise[place, place] = block + INTERSECTION.floor_px2 * np.eye(rows)
    for _ in range(12):
        computed, by_motion, by_exterior = _linearise(cameras, motion, model)
        weight = np.linalg.inv(image_noise + by_exterior @ exterior @ by_exterior.T)
        design = by_motion[:, columns]
        normal = design.T @ weight @ design
        inverse = _invert(normal, motion if phase_free else None)
        step = inverse @ (design.T @ weight @ (target - computed))
        flat = motion.reshape(9).copy()
        flat[columns] += step
        motion = flat.reshape(3, 3)
        if float(step @ normal @ step) < 1e-8:
            break
    computed, by_motion, by_exterior = _linearise(cameras, motion, model)
    weight = np.linalg.inv(image_noise + by_exterior @ exterior @ by_exterior.T)
    design, miss = by_motion[:, columns], target - computed
    covariance = np.zeros((9, 9))
    covariance[np.ix_(columns, columns)] = _invert(design.T @ weight @ design, motion if phase_free else None)
    freedom = len(target) - len(columns) + (1 if phase_free else 0)
    return Candidate(motion, covariance, float(miss @ weight @ miss), freedom, float(np.abs(miss).max(initial=0.0)))


def _invert(normal: FloatArray, motion: FloatArray | None) -> FloatArray:
    """Inverse of a normal matrix; of one that leaves the phase of `motion` free, with that phase held."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * np.outer(scale, scale)
    if motion is not None:
        turn = np.concatenate([np.zeros(3), motion[2], -motion[1]]) / scale
        turn /= np.linalg.norm(turn)
        scaled = scaled + np.outer(turn, turn)
    return np.linalg.pinv(scaled, rcond=1e-15, hermitian=True) * np.outer(scale, scale)


def _linearise(
    cameras: Sequence[OrientedCamera], motion: FloatArray, model: ObservationModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Observations of all cameras one below the other, (m,), (m, 9), and (m, 6 n) with one block a camera."""
    parts = [model(*project_motion(camera.project_with_jacobians, motion)) for camera in cameras]
    if not all(np.isfinite(part[0]).all() for part in parts):
        raise DataError("its rays do not meet in front of the cameras")
    rows = len(parts[0][0])
    by_exterior = np.zeros((rows * len(parts), 6 * len(parts)))
    for index, part in enumerate(parts):
        by_exterior[index * rows : (index + 1) * rows, 6 * index : 6 * index + 6] = part[2]
    return (
        cast(FloatArray, np.concatenate([part[0] for part in parts])),
        cast(FloatArray, np.concatenate([part[1] for part in parts])),
        by_exterior,
    )
