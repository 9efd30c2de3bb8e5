"""The camera moves too: mirror, shutter and floor shift each frame, and the control targets tell by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.geometry.data_snooping import RobustPointAdjustment, exclusion_reason
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import ORIENTATION, SNOOPING


@dataclass(frozen=True, slots=True, eq=False)
class CameraMotion:
    """How a camera moved between the sharp frame and another one.

    Attributes
    ----------
    camera
        The camera as it stood in the other frame; its covariance includes this estimate's.
    change, covariance
        (6,) change of the exterior parameters (rotation vector in camera axes, rad; position, mm) and its (6, 6)
        covariance.
    shift_px
        (2,) mean shift of the control targets.
    rms_px
        Root mean square length of their shifts, as the camera's motion explains them.
    moved
        True when `rms_px` is significant and above `ORIENTATION.min_shift_px`.
    excluded
        Control targets whose shift does not fit the others', with the reason.
    sigma0
        Standard deviation of unit weight.
    """

    camera: OrientedCamera
    change: FloatArray
    covariance: FloatArray
    shift_px: FloatArray
    rms_px: float
    moved: bool
    excluded: dict[str, str]
    sigma0: float


def estimate_camera_motion(
    camera: OrientedCamera,
    object_mm: FloatArray,
    sharp_px: FloatArray,
    blurred_px: FloatArray,
    *,
    names: Sequence[str],
    sd_px: float | FloatArray = 0.05,
) -> CameraMotion:
    """Motion of a camera from its control targets in a blurred frame relative to the sharp one.

    Parameters
    ----------
    camera
        The camera as oriented on the sharp frame.
    object_mm
        (n, 3) control targets.
    sharp_px, blurred_px
        (n, 2) their pixels in the two frames.
    names
        Their names.
    sd_px
        Standard deviation of a coordinate's shift between the frames, for all or each (n,).

    Returns
    -------
    CameraMotion
        With fewer than two control targets nothing can be said: the view is returned as it was.

    Raises
    ------
    DataError
        The targets shifted in ways that no motion of this camera explains (frames of two cameras swapped).
    """
    count = len(names)
    if count < 2:
        nothing = np.zeros(6)
        return CameraMotion(camera, nothing, np.zeros((6, 6)), np.zeros(2), 0.0, False, {}, float("nan"))
    shifts = np.asarray(blurred_px, dtype=float) - np.asarray(sharp_px, dtype=float)
    sd = np.broadcast_to(np.asarray(sd_px, dtype=float), (count,))
    noise = (sd**2)[:, None, None] * np.eye(2)
    still = camera.project(object_mm)

    def linearise(change: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        computed, _, by_exterior = camera.apply_change(change).project_with_jacobians(object_mm)
        return shifts - (computed - still), noise, by_exterior

    prior = np.array([0.0, 0.0, 0.0, *[ORIENTATION.position_prior_mm**-2.0] * 3])
    problem = RobustPointAdjustment(linearise, np.add, prior)
    # A shift common to all is nearly a pure rotation: start there, so that snooping sees what is left.
    start = problem.adjust(np.zeros(6), np.ones(count), robust=True)
    change, used = problem.reject_outliers(start, min_points=2)
    residuals, squares = linearise(change)[0], problem.squares(change)
    freedom = max(2 * int(used.sum()) - 3, 1)
    sigma0 = float(np.sqrt(squares[used].sum() / freedom))
    if not used.sum() > count / 2 or (
        sigma0 > ORIENTATION.max_sigma0 and np.abs(residuals[used]).max() > ORIENTATION.max_residual_px
    ):
        listing = ", ".join(f"{name} {np.hypot(*v):.1f} px" for name, v in zip(names, shifts, strict=True))
        raise DataError(
            f"the control targets shifted from the sharp frame as no motion of the camera explains ({listing}): "
            "is the frame from this camera?"
        )
    covariance = problem.covariance(change, used)
    if squares[used].sum() > chi2.isf(SNOOPING.inflation_probability, freedom):
        covariance = covariance * sigma0**2
    explained = (shifts - residuals)[used]
    rms = float(np.sqrt(np.mean(np.sum(explained**2, axis=1))))
    moved_view = camera.apply_change(change)
    return CameraMotion(
        replace(moved_view, covariance=camera.covariance + covariance),
        change,
        covariance,
        shifts[used].mean(axis=0),
        rms,
        _is_significant(rms, sd[used]),
        {names[i]: exclusion_reason(residuals[i], squares[i]) for i in np.flatnonzero(~used).tolist()},
        sigma0,
    )


def _is_significant(rms_px: float, sd_px: NDArray[np.float64]) -> bool:
    """Tell a shift that matters from noise."""
    return bool(rms_px > max(ORIENTATION.min_shift_px, 5.0 * float(np.sqrt(np.mean(sd_px**2)))))
