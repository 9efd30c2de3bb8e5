"""Exterior orientation of one camera from surveyed control targets: robust, weighted, with its covariance.

Each control target counts by what is known of it: its pixel's standard deviation and its survey's, carried into the
image (for one camera this is the same as adjusting the surveyed coordinates as observations). A target that was
misread or mis-surveyed is found by its residual against its own standard deviation (Baarda's data snooping, both
coordinates together), left out and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.geometry.control import check_control, check_scale, check_volume
from labdaemon.geometry.data_snooping import RobustPointAdjustment, exclusion_reason
from labdaemon.geometry.initial_pose import initial_cameras
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import ORIENTATION, SNOOPING


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """A camera's exterior orientation and how it came about.

    Attributes
    ----------
    camera
        The oriented camera with the covariance of its exterior parameters.
    names
        (n,) control targets offered.
    residuals_px
        (n, 2) observed minus computed pixels, of the targets left out too.
    used
        (n,) bool.
    excluded
        Name of each target left out and the reason.
    sigma0
        Standard deviation of unit weight: 1 when pixels and survey are as good as stated; NaN without redundancy.
    degrees_of_freedom
        Observations less unknowns.
    """

    camera: OrientedCamera
    names: tuple[str, ...]
    residuals_px: FloatArray
    used: NDArray[np.bool_]
    excluded: dict[str, str]
    sigma0: float
    degrees_of_freedom: int


def orient(
    lens: Lens,
    image_px: FloatArray,
    object_mm: FloatArray,
    *,
    names: Sequence[str],
    sd_image_px: float | FloatArray = 0.1,
    sd_object_mm: float | FloatArray = 0.0,
    volume: bool = False,
    side_px: FloatArray | None = None,
    side_mm: float | None = None,
) -> Orientation:
    """Find where a camera stands from the control targets in its frame.

    Parameters
    ----------
    lens
        The camera's interior orientation.
    image_px, object_mm
        (n, 2) measured pixels and (n, 3) surveyed positions of the same targets.
    names
        Their n names, each once.
    sd_image_px, sd_object_mm
        Standard deviation of a pixel coordinate and of a surveyed coordinate, for all or each (n,). A survey of
        standard deviation 0 is held fixed.
    volume
        Refuse control that lies in one plane (for measuring in three dimensions with several cameras).
    side_px, side_mm
        (n,) apparent size of each control target in the frame and its true one; together they tell a survey in
        metres from one in millimetres, which residuals cannot.

    Returns
    -------
    Orientation

    Raises
    ------
    DataError
        Fewer than four targets, a name twice, all in a line (or in a plane when `volume`), a survey in the wrong
        unit, or residuals so large that frame, lens and survey cannot belong together.
    """
    image_px, object_mm = np.asarray(image_px, dtype=float), np.asarray(object_mm, dtype=float)
    count = len(object_mm)
    sd_image = np.broadcast_to(np.asarray(sd_image_px, dtype=float), (count,))
    sd_object = np.broadcast_to(np.asarray(sd_object_mm, dtype=float), (count,))
    check_control(names, image_px, object_mm)
    if volume:
        check_volume(object_mm, sd_object)

    def linearise(camera: OrientedCamera) -> tuple[FloatArray, FloatArray, FloatArray]:
        computed, by_point, by_exterior = camera.project_with_jacobians(object_mm)
        survey = (sd_object**2)[:, None, None] * by_point @ np.swapaxes(by_point, 1, 2)
        return image_px - computed, survey + (sd_image**2)[:, None, None] * np.eye(2), by_exterior

    problem = RobustPointAdjustment(linearise, OrientedCamera.apply_change)
    starts = sorted(initial_cameras(lens, image_px, object_mm), key=problem.cost)[:4]
    if not starts:
        raise DataError("no camera position sees the control targets like this: wrong lens, or names mixed up")
    every = np.ones(count)
    camera = min((problem.adjust(start, every, robust=True, steps=20) for start in starts), key=problem.cost)
    camera, used = problem.reject_outliers(camera, min_points=4)
    residuals = linearise(camera)[0]
    squares = problem.squares(camera)
    freedom = 2 * int(used.sum()) - 6
    sigma0 = float(np.sqrt(squares[used].sum() / freedom)) if freedom else float("nan")
    listing = ", ".join(f"{name} {np.hypot(*v):.1f} px" for name, v in zip(names, residuals, strict=True))
    if not used.sum() > count / 2 or sigma0 > ORIENTATION.max_sigma0:
        raise DataError(
            f"control targets do not fit together (residuals {listing}): check that the frame is from this camera, "
            "that the lens is this camera's, and the survey"
        )
    if side_px is not None and side_mm is not None:
        check_scale(camera, object_mm[used], np.asarray(side_px)[used], side_mm)
    covariance = problem.covariance(camera, used)
    if freedom and squares[used].sum() > chi2.isf(SNOOPING.inflation_probability, freedom):
        covariance = covariance * sigma0**2  # worse than stated: believe the residuals
    excluded = {names[i]: exclusion_reason(residuals[i], squares[i]) for i in np.flatnonzero(~used).tolist()}
    oriented = OrientedCamera(lens, camera.rotation, camera.position_mm, covariance)
    return Orientation(oriented, tuple(names), residuals, used, excluded, sigma0, freedom)
