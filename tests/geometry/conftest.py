"""A rig to look at: cameras around a volume of control targets, in exact numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from labdaemon.geometry.lens import Lens
from labdaemon.geometry.oriented_camera import OrientedCamera, rotation_from_vector

CONTROL_MM = np.array(
    [
        [-250.0, 40.0, 170.0],
        [-240.0, -60.0, 560.0],
        [250.0, 30.0, 180.0],
        [240.0, -50.0, 570.0],
        [-170.0, 90.0, 370.0],
        [180.0, 100.0, 380.0],
        [0.0, 0.0, 85.0],
        [10.0, 30.0, 665.0],
    ]
)


@pytest.fixture(scope="session")
def lens() -> Lens:
    return Lens((3872, 2592), (3937.7, 3937.7), (1942.8, 1283.7), (-0.09, 0.07, 3e-4, -2e-4, 0.0))


@pytest.fixture(scope="session")
def control_mm() -> np.ndarray:
    return CONTROL_MM


@pytest.fixture(scope="session")
def look(lens: Lens) -> Callable[..., OrientedCamera]:
    """A camera at a place, aimed at a point, rolled by an angle."""

    def aim(place: object, at: object = (0.0, 0.0, 370.0), roll: float = 0.0, lens: Lens = lens) -> OrientedCamera:
        position = np.array(place, dtype=float)
        forward = np.array(at, dtype=float) - position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(forward, right), forward])
        return OrientedCamera(lens, rotation_from_vector(np.array([0.0, 0.0, roll])) @ axes, position)

    return aim
