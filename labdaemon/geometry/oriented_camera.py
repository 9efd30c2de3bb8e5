"""Exterior orientation: where a camera stands, where it looks, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import FloatArray


def skew(vectors: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices [v]× with ``[v]× w = v × w`` of (n, 3) vectors."""
    result = np.zeros((*vectors.shape[:-1], 3, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result


def rotation_from_vector(vector: FloatArray) -> FloatArray:
    """(3, 3) rotation by |vector| radians about (3,) `vector` (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    cross = skew(np.asarray(vector, dtype=float))
    if angle < 1e-8:
        return np.eye(3) + cross + 0.5 * cross @ cross
    return cast(
        FloatArray, np.eye(3) + np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle**2 * cross @ cross
    )


@dataclass(frozen=True, slots=True, eq=False)
class OrientedCamera:
    """A camera in the room: ``x_camera = rotation @ (x_object - position_mm)``.

    Attributes
    ----------
    lens
        Its interior orientation.
    rotation
        (3, 3), object axes to camera axes (x right, y down, z forward).
    position_mm
        (3,) projection centre.
    covariance
        (6, 6) of the exterior parameters: a small rotation vector in camera axes (rad, applied after `rotation`)
        and the position (mm).
    """

    lens: Lens
    rotation: FloatArray
    position_mm: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))

    def apply_change(self, change: FloatArray) -> OrientedCamera:
        """View after a change (6,) of its exterior parameters; the covariance is kept."""
        rotation = rotation_from_vector(change[:3]) @ self.rotation
        return replace(self, rotation=rotation, position_mm=self.position_mm + change[3:])

    def to_camera_axes(self, points_mm: FloatArray) -> FloatArray:
        """(n, 3) object points in camera axes, mm."""
        return (points_mm - self.position_mm) @ self.rotation.T

    def project(self, points_mm: FloatArray) -> FloatArray:
        """(n, 2) pixels of (n, 3) object points; NaN behind the camera or beyond the lens's fold."""
        local = self.to_camera_axes(np.asarray(points_mm, dtype=float))
        depth = np.where(local[..., 2:] > 0, local[..., 2:], np.nan)
        return self.lens.distort(local[..., :2] / depth)

    def project_with_jacobians(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels of points and how they depend on point and camera.

        Returns
        -------
        tuple
            (n, 2) pixels, (n, 2, 3) derivative by the points (px/mm), and (n, 2, 6) by the exterior parameters
            (px/rad, px/mm) in the order of `covariance`.
        """
        local = self.to_camera_axes(np.asarray(points_mm, dtype=float))
        depth = np.where(local[..., 2:] > 0, local[..., 2:], np.nan)
        slopes = local[..., :2] / depth
        by_local = np.zeros((*slopes.shape, 3))
        by_local[..., 0, 0] = by_local[..., 1, 1] = 1.0 / depth[..., 0]
        by_local[..., :, 2] = -slopes / depth
        by_local = self.lens.distort_jacobian(slopes) @ by_local
        by_point = by_local @ self.rotation
        by_exterior = np.concatenate([-by_local @ skew(local), -by_point], axis=-1)
        return self.lens.distort(slopes), by_point, by_exterior

    def rays(self, image_px: FloatArray) -> FloatArray:
        """(n, 3) unit directions in object axes of the rays that end in (n, 2) pixels."""
        slopes = self.lens.undistort(image_px)
        local = np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return cast(FloatArray, local @ self.rotation)
