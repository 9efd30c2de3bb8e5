"""What a camera saw of a motion: where it stood for a frame, and where something was at many moments of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labdrivers.sim.lens import CameraModel, FloatArray, SensorShift

STEP_PX = 0.05
"""Moments of the exposure lie no farther apart than this along the path."""

MIN_MOMENTS, MAX_MOMENTS = 512, 60_000

CODED_MOMENTS, MOMENT_PARTS = 6_000, 16
"""Moments under a light that changes, and parts of each in which the light is looked at."""


@dataclass(frozen=True, slots=True)
class CameraView:
    """A camera as it stood for one frame."""

    camera: CameraModel
    shift: SensorShift

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Image points (n, 2) of object points (n, 3)."""
        return self.shift.apply(self.camera.project(points_mm), self.camera.image_size)


@dataclass(frozen=True, slots=True, eq=False)
class MotionPath:
    """Where something was at many equally long moments of the exposure.

    Attributes
    ----------
    times_s
        (n,) middles of the moments.
    displacement_mm
        (n, 3) from rest.
    weight
        (n,) part of all light that falls in each moment; the sum is 1. Equal parts under constant light.
    """

    times_s: FloatArray
    displacement_mm: FloatArray
    weight: FloatArray

    @classmethod
    def at_rest(cls, time_s: float) -> MotionPath:
        """Something that does not move."""
        return cls(np.array([time_s]), np.zeros((1, 3)), np.ones(1))


def moments(opened_s: float, exposure_s: float, count: int) -> FloatArray:
    """Middles of `count` equal parts of the exposure."""
    return opened_s + (np.arange(count) + 0.5) / count * exposure_s


def follow(
    view: CameraView,
    rest_mm: FloatArray,
    motion: Callable[[FloatArray], FloatArray],
    window_s: tuple[float, float],
    brightness: Callable[[FloatArray], FloatArray] | None = None,
) -> MotionPath:
    """Sample a motion so finely that its image moves less than `STEP_PX` from one moment to the next.

    Parameters
    ----------
    brightness
        Light (n,) at times (n,); None for constant light. Its edges are met to a hundredth of a thousandth of the
        exposure.
    """
    times = moments(*window_s, MIN_MOMENTS)
    displacement = np.asarray(motion(times), float)
    image = view.project(rest_mm + displacement)
    length = float(np.linalg.norm(np.diff(image, axis=0), axis=1).sum())
    # the first, coarse sampling may cut corners: hence the margin
    count = int(np.clip(1.5 * length / STEP_PX, MIN_MOMENTS if brightness is None else CODED_MOMENTS, MAX_MOMENTS))
    if count > MIN_MOMENTS:
        times = moments(*window_s, count)
        displacement = np.asarray(motion(times), float)
    weight = np.ones(times.size) if brightness is None else _mean_brightness(brightness, times, window_s[1] / count)
    if not weight.any():  # no light at all: the frame is black whatever the path
        weight = np.ones(times.size)
    lit = weight > 0
    return MotionPath(times[lit], displacement[lit], weight[lit] / weight.sum())


def _mean_brightness(
    brightness: Callable[[FloatArray], FloatArray], times_s: FloatArray, length_s: float
) -> FloatArray:
    """Light of each moment, as the mean over its own parts: an edge inside a moment counts in proportion."""
    offsets = ((np.arange(MOMENT_PARTS) + 0.5) / MOMENT_PARTS - 0.5) * length_s
    return np.asarray(brightness((times_s[:, None] + offsets).ravel()).reshape(times_s.size, -1).mean(axis=1))
