"""Where a camera stands and how its lens maps object space to the sensor (OpenCV's five-parameter model)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A camera body with its lens, somewhere in the lab.

    Attributes
    ----------
    image_size
        (width, height) of the visible RAW area, pixels.
    focal_px, principal_point_px
        (x, y) each; pixel centres at integers.
    distortion
        k1 k2 p1 p2 k3.
    position_mm
        Projection centre in object space.
    rotation
        (3, 3) rows: the camera's x (right), y (down) and z (viewing direction) axes in object space.
    """

    image_size: tuple[int, int]
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[tuple[float, float, float], ...] = field(
        default=((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    )

    @classmethod
    def looking_at(
        cls,
        target_mm: Sequence[float],
        position_mm: Sequence[float],
        *,
        image_size: tuple[int, int],
        focal_px: tuple[float, float],
        principal_point_px: tuple[float, float],
        distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0),
        roll_rad: float = 0.0,
    ) -> CameraModel:
        """A camera at `position_mm` that aims at `target_mm`, level with the horizon but for `roll_rad`."""
        position, aim = np.asarray(position_mm, float), np.asarray(target_mm, float)
        forward = (aim - position) / np.linalg.norm(aim - position)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
        axes = np.array([cosine * right + sine * down, cosine * down - sine * right, forward])
        return cls(
            image_size=image_size,
            focal_px=focal_px,
            principal_point_px=principal_point_px,
            distortion=distortion,
            position_mm=(float(position[0]), float(position[1]), float(position[2])),
            rotation=tuple((float(row[0]), float(row[1]), float(row[2])) for row in axes),
        )

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Image points (n, 2) of object points (n, 3), pixels."""
        local = (np.asarray(points_mm, float) - np.asarray(self.position_mm)) @ np.asarray(self.rotation).T
        x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack(
            [
                self.focal_px[0] * xd + self.principal_point_px[0],
                self.focal_px[1] * yd + self.principal_point_px[1],
            ],
            axis=1,
        )


@dataclass(frozen=True, slots=True)
class SensorShift:
    """How a frame sits on the sensor against where the camera was surveyed: mirror slap, a knocked tripod.

    Attributes
    ----------
    x_px, y_px
        Translation in the image.
    roll_rad
        Rotation about the image's centre.
    """

    x_px: float = 0.0
    y_px: float = 0.0
    roll_rad: float = 0.0

    def apply(self, points_px: FloatArray, image_size: tuple[int, int]) -> FloatArray:
        """Move image points (n, 2)."""
        centre = (np.asarray(image_size, float) - 1.0) / 2.0
        cosine, sine = np.cos(self.roll_rad), np.sin(self.roll_rad)
        turned = (points_px - centre) @ np.array([[cosine, sine], [-sine, cosine]])
        return np.asarray(turned + centre + (self.x_px, self.y_px))
