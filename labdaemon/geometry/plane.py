"""One camera: motion in a vertical plane through coplanar control targets, as the paper defines it.

Linear regression of Y on X of the control targets gives the plane's trace in plan. Plane x is the distance along that
line from its intercept's foot, plane y is Z; a projective transform maps undistorted image points to the plane
(McCarthy, Chandler and Palmeri 2016, "Measurement in 2D"). Where the trace runs closer to Y than to X the regression
is of X on Y, since Y on X is undefined for a plane of constant X.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.geometry.control import check_control
from labdaemon.geometry.data_snooping import RobustPointAdjustment, exclusion_reason
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import FloatArray, ImageMotion, ObjectMotion
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import ORIENTATION, SNOOPING
from labdaemon.orbit_axes import largest_sign, principal_axes


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A vertical plane and the projective transform between it and a camera's frame.

    Attributes
    ----------
    lens
        The camera's interior orientation.
    origin_mm
        (3,) foot of the regression's intercept: the zero of plane x and y.
    axes
        (3, 2) unit vectors of plane x (level, along the trace) and plane y (up).
    centre_mm, scale_mm
        Plane point and length that make the transform's numbers of order 1.
    transform
        (8,) with u, v = (plane − centre) / scale: ray slopes are (h0 u + h1 v + h2, h3 u + h4 v + h5) over
        (h6 u + h7 v + 1).
    covariance
        (8, 8) of `transform`, from pixels and survey.
    names, residuals_px, used
        Control targets, (n, 2) observed minus computed pixels and (n,) which of them were used.
    off_plane_mm
        (n,) distances of the control targets from the plane.
    excluded
        Name of each target left out and the reason.
    sigma0
        Standard deviation of unit weight; NaN without redundancy.
    """

    lens: Lens
    origin_mm: FloatArray
    axes: FloatArray
    centre_mm: FloatArray
    scale_mm: float
    transform: FloatArray
    covariance: FloatArray
    names: tuple[str, ...] = ()
    residuals_px: FloatArray | None = None
    used: NDArray[np.bool_] | None = None
    off_plane_mm: FloatArray | None = None
    excluded: dict[str, str] | None = None
    sigma0: float = float("nan")

    @property
    def normal(self) -> FloatArray:
        """(3,) unit vector across the plane."""
        return np.cross(self.axes[:, 0], self.axes[:, 1])

    def apply_change(self, change: FloatArray) -> Plane:
        """Plane with its transform changed by (8,)."""
        return replace(self, transform=self.transform + change)

    def project_with_jacobians(self, plane_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels of plane points, their derivative by the points and by the transform.

        Parameters
        ----------
        plane_mm
            (n, 2) plane coordinates.

        Returns
        -------
        tuple
            (n, 2) px, (n, 2, 2) px/mm, (n, 2, 8) px.
        """
        local = (plane_mm - self.centre_mm) / self.scale_mm
        h = self.transform
        below = local @ h[6:8] + 1.0
        below = np.where(below > 0, below, np.nan)
        slopes = np.stack([local @ h[0:2] + h[2], local @ h[3:5] + h[5]], axis=-1) / below[:, None]
        row = np.column_stack([local, np.ones(len(local))]) / below[:, None]
        by_transform = np.zeros((len(local), 2, 8))
        by_transform[:, 0, 0:3] = by_transform[:, 1, 3:6] = row
        by_transform[:, :, 6:8] = -slopes[:, :, None] * row[:, None, :2]
        linear = np.stack([h[0:2], h[3:5]])
        by_point = (linear - slopes[:, :, None] * h[6:8]) / below[:, None, None] / self.scale_mm
        sensor = self.lens.distort_jacobian(slopes)
        return self.lens.distort(slopes), sensor @ by_point, sensor @ by_transform

    def to_plane(self, image_px: FloatArray) -> FloatArray:
        """(n, 2) plane coordinates, mm, of (n, 2) pixels."""
        h = self.transform
        matrix = np.array([[h[0], h[1], h[2]], [h[3], h[4], h[5]], [h[6], h[7], 1.0]])
        slopes = self.lens.undistort(image_px)
        mapped = np.column_stack([slopes, np.ones(len(slopes))]) @ np.linalg.inv(matrix).T
        return cast(FloatArray, mapped[:, :2] / mapped[:, 2:] * self.scale_mm + self.centre_mm)

    def to_object(self, plane_mm: FloatArray) -> FloatArray:
        """(n, 3) object coordinates of (n, 2) plane coordinates, mm."""
        return self.origin_mm + plane_mm @ self.axes.T


def fit_plane(
    lens: Lens,
    image_px: FloatArray,
    object_mm: FloatArray,
    *,
    names: Sequence[str],
    sd_image_px: float | FloatArray = 0.1,
    sd_object_mm: float | FloatArray = 0.0,
) -> Plane:
    """Plane through surveyed control targets, and its projective transform from the frame.

    Parameters
    ----------
    lens
        The camera's interior orientation.
    image_px, object_mm
        (n, 2) measured pixels and (n, 3) surveyed positions, n >= 4.
    names
        Their n names.
    sd_image_px, sd_object_mm
        Standard deviation of a pixel coordinate and of a surveyed coordinate, for all or each (n,).

    Raises
    ------
    DataError
        Fewer than four targets, a name twice, all in a line, a survey in metres, control that is not coplanar within
        its survey's uncertainty (with each distance), or residuals that fit no projective transform.
    """
    image_px, object_mm = np.asarray(image_px, dtype=float), np.asarray(object_mm, dtype=float)
    count = len(object_mm)
    sd_image = np.broadcast_to(np.asarray(sd_image_px, dtype=float), (count,))
    sd_object = np.broadcast_to(np.asarray(sd_object_mm, dtype=float), (count,))
    check_control(names, image_px, object_mm)
    origin, along, off_plane = _fit_trace(object_mm, sd_object, names)
    axes = np.column_stack([along, [0.0, 0.0, 1.0]])
    plane_mm = (object_mm - origin) @ axes
    if np.linalg.svd(plane_mm - plane_mm.mean(axis=0), compute_uv=False)[1] < 0.02 * np.ptp(plane_mm, axis=0).max():
        raise DataError(f"control targets {', '.join(names)} all lie in a line: add some off that line")
    centre, scale = plane_mm.mean(axis=0), float(np.abs(plane_mm - plane_mm.mean(axis=0)).max())
    slopes = lens.undistort(image_px)
    if not np.isfinite(slopes).all():
        raise DataError("a control target lies where the lens model folds over: calibrate the camera again")
    start = Plane(lens, origin, axes, centre, scale, np.zeros(8), np.zeros((8, 8)))

    def linearise(plane: Plane) -> tuple[FloatArray, FloatArray, FloatArray]:
        computed, by_point, by_transform = plane.project_with_jacobians(plane_mm)
        survey = (sd_object**2)[:, None, None] * by_point @ np.swapaxes(by_point, 1, 2)
        return image_px - computed, survey + (sd_image**2)[:, None, None] * np.eye(2), by_transform

    problem = RobustPointAdjustment(linearise, Plane.apply_change)
    every = np.ones(count)
    starts = sorted(_initial_planes(start, (plane_mm - centre) / scale, slopes), key=problem.cost)[:4]
    if not starts:
        raise DataError("no projective transform fits the control targets: frame and survey do not belong together")
    plane = min((problem.adjust(s, every, robust=True, steps=20) for s in starts), key=problem.cost)
    plane, used = problem.reject_outliers(plane, min_points=4)
    residuals, squares = linearise(plane)[0], problem.squares(plane)
    freedom = 2 * int(used.sum()) - 8
    sigma0 = float(np.sqrt(squares[used].sum() / freedom)) if freedom else float("nan")
    if not used.sum() > count / 2 or sigma0 > ORIENTATION.max_sigma0:
        listing = ", ".join(f"{name} {np.hypot(*v):.1f} px" for name, v in zip(names, residuals, strict=True))
        raise DataError(
            f"control targets do not fit together (residuals {listing}): check that the frame is from this camera, "
            "that the lens is this camera's, and the survey"
        )
    covariance = problem.covariance(plane, used)
    if freedom and squares[used].sum() > chi2.isf(SNOOPING.inflation_probability, freedom):
        covariance = covariance * sigma0**2
    return replace(
        plane,
        covariance=covariance,
        names=tuple(names),
        residuals_px=residuals,
        used=used,
        off_plane_mm=off_plane,
        excluded={names[i]: exclusion_reason(residuals[i], squares[i]) for i in np.flatnonzero(~used).tolist()},
        sigma0=sigma0,
    )


def compensate_camera_motion(
    plane: Plane, motion: ImageMotion, sharp: OrientedCamera, displaced: Sequence[OrientedCamera]
) -> ImageMotion:
    """Image that a motion would have had, had the camera not moved since the sharp frame.

    Parameters
    ----------
    plane
        From `fit_plane`, on the sharp frame.
    motion
        What was seen.
    sharp, displaced
        The camera as it stood in the sharp frame, and in each frame that `motion` was measured in (means are taken).

    Returns
    -------
    ImageMotion
        The mean shifted, a and b turned with the image.
    """
    back = motion.mean_px
    turn = np.eye(2)
    # The first round finds the place, the second how the image moved there.
    for _ in range(2):
        place = plane.to_object(plane.to_plane(back[None]))
        pixels, by_point, _ = sharp.project_with_jacobians(place)
        then = [camera.project_with_jacobians(place)[:2] for camera in displaced]
        back = motion.mean_px - np.mean([other[0] - pixels[0] for other, _ in then], axis=0)
        if not np.isfinite(back).all():
            return replace(motion, mean_px=back)
        turn = np.mean([by_point[0] @ plane.axes @ np.linalg.inv(by[0] @ plane.axes) for _, by in then], axis=0)
    return _transform_motion(motion, turn, back - motion.mean_px)


def _transform_motion(motion: ImageMotion, turn: FloatArray, shift: FloatArray) -> ImageMotion:
    every = np.kron(np.eye(3), turn)
    return replace(
        motion,
        mean_px=motion.mean_px + shift,
        a_px=turn @ motion.a_px,
        b_px=turn @ motion.b_px,
        covariance_px2=every @ motion.covariance_px2 @ every.T,
        axes=None if motion.axes is None else _transform_motion(motion.axes, turn, shift),
    )


def map_motion_to_plane(plane: Plane, motion: ImageMotion) -> ObjectMotion:
    """Motion in object space of a target that stays in the plane.

    Parameters
    ----------
    plane
        From `fit_plane`.
    motion
        The target's image.

    Returns
    -------
    ObjectMotion
        All three components of mean, a and b lie in the plane. What one camera cannot see is the component across it;
        the covariance of the axis nearest to the plane's normal is NaN.
    """
    image = np.concatenate([motion.mean_px, motion.a_px, motion.b_px])
    nothing = np.full(3, np.nan)
    if not np.isfinite(image).all():
        return ObjectMotion(nothing, nothing, nothing, np.full((9, 9), np.nan))
    state = np.zeros((3, 2))
    state[0] = plane.to_plane(motion.mean_px[None])[0]
    if not np.isfinite(state).all():
        return ObjectMotion(nothing, nothing, nothing, np.full((9, 9), np.nan))
    for _ in range(20):
        computed, by_motion, _ = project_motion(plane.project_with_jacobians, state)
        step = np.linalg.solve(by_motion, image - computed)
        state = state + step.reshape(3, 2)
        if np.abs(step).max() < 1e-10 * plane.scale_mm:
            break
    _, by_motion, by_transform = project_motion(plane.project_with_jacobians, state)
    inverse = np.linalg.inv(by_motion)
    noise = motion.covariance_px2 + by_transform @ plane.covariance @ by_transform.T
    covariance = inverse @ noise @ inverse.T
    a, b = state[1], state[2]
    if not motion.phased:
        a, b, covariance = principal_axes(a, b, covariance)
    mean_mm, a_mm, b_mm = plane.to_object(state[:1])[0], plane.axes @ a, plane.axes @ b
    lift = np.kron(np.eye(3), plane.axes)
    full = lift @ covariance @ lift.T
    if not motion.phased:
        sign_a, sign_b = largest_sign(a_mm), largest_sign(b_mm)
        signs = np.repeat([1.0, sign_a, sign_b], 3)
        a_mm, b_mm, full = sign_a * a_mm, sign_b * b_mm, full * np.outer(signs, signs)
    unseen = int(np.argmax(np.abs(plane.normal))) + np.array([0, 3, 6])
    full[unseen, :] = full[:, unseen] = np.nan
    return ObjectMotion(mean_mm, a_mm, b_mm, full)


def _fit_trace(
    object_mm: FloatArray, sd_mm: FloatArray, names: Sequence[str]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Foot of the intercept (3,), level unit vector along the trace (3,), and distances from the plane (n,)."""
    plan = object_mm[:, :2]
    sd = np.maximum(sd_mm, ORIENTATION.min_survey_sd_mm)
    _, _, main = np.linalg.svd((plan - plan.mean(axis=0)) / sd[:, None])
    steep = abs(main[0, 1]) > abs(main[0, 0])
    given, wanted = (plan[:, 1], plan[:, 0]) if steep else (plan[:, 0], plan[:, 1])
    centre = np.average(given, weights=sd**-2.0)
    design = np.column_stack([given - centre, np.ones(len(given))]) / sd[:, None]
    gradient, level = np.linalg.lstsq(design, wanted / sd, rcond=None)[0]
    intercept = level - gradient * centre
    direction = np.array([1.0, gradient]) / np.hypot(1.0, gradient)
    origin = np.array([0.0, intercept])
    if steep:
        direction, origin = direction[::-1], origin[::-1]
    across = np.array([-direction[1], direction[0]])
    distances = (plan - origin) @ across
    # A point pulls the line towards itself: judge each by its own residual's standard deviation.
    inverse = np.linalg.pinv(design.T @ design)
    pull = np.einsum("ni,ij,nj->n", design, inverse, design)
    spread = sd * np.sqrt(np.maximum(1.0 - pull, 1e-6))
    tests = (distances / spread) ** 2
    freedom = len(distances) - 2
    worst = tests.max() > chi2.isf(ORIENTATION.coplanar_significance / len(tests), 1)
    if worst or np.sum((distances / sd) ** 2) > chi2.isf(ORIENTATION.coplanar_significance, freedom):
        listing = ", ".join(f"{name} {value:+.2f}" for name, value in zip(names, distances, strict=True))
        raise DataError(
            "the control targets do not lie in one vertical plane within their survey's uncertainty "
            f"({sd.min():.2g} mm); distances in mm: {listing}. One camera needs coplanar control: correct the survey, "
            "or leave out the targets that stand off"
        )
    return np.append(origin, 0.0), np.append(direction, 0.0), distances


def _initial_planes(plane: Plane, local: FloatArray, slopes: FloatArray) -> list[Plane]:
    """Linear solutions of the transform from all points and from sets of four, in front of the camera."""
    count = len(local)
    sets = [np.arange(count)]
    if count > 4:
        generator = np.random.default_rng(count)
        sets += [generator.choice(count, 4, replace=False) for _ in range(30)]
    result = []
    for index in sets:
        u, v = local[index].T
        x, y = slopes[index].T
        zero, one = np.zeros_like(u), np.ones_like(u)
        system = np.concatenate(
            [
                np.column_stack([u, v, one, zero, zero, zero, -x * u, -x * v]),
                np.column_stack([zero, zero, zero, u, v, one, -y * u, -y * v]),
            ]
        )
        solution, _, rank, _ = np.linalg.lstsq(system, np.concatenate([x, y]), rcond=1e-10)
        if rank == 8 and np.median(local @ solution[6:8] + 1.0) > 0:
            result.append(replace(plane, transform=solution))
    return result
