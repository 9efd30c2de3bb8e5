"""Exterior orientation of all cameras at once: one survey, one adjustment, one covariance.

Cameras oriented one by one on the same survey each inherit its errors in their own way, so that their rays miss each
other by the survey's uncertainty. Adjusted together, with the control targets' coordinates as observations and the
monitoring targets (at rest) as ties, they agree to the pixel's uncertainty; the remaining errors of the survey move
all cameras together and are in the joint covariance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.geometry.control import check_names
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.motion_adjustment import nearest_point
from labdaemon.geometry.network import Network, Pose
from labdaemon.geometry.orientation import Orientation, orient
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.reliability import GrossError, adjust_without_gross_errors
from labdaemon.geometry.settings import SNOOPING


@dataclass(frozen=True, slots=True)
class ImageObservation:
    """Where a target stands in a frame, with the standard deviation of a coordinate and its apparent size if known."""

    name: str
    x_px: float
    y_px: float
    sd_px: float = 0.05
    side_px: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoint:
    """A surveyed target: (3,) mm, and the standard deviation of a coordinate (0 holds it fixed)."""

    name: str
    position_mm: FloatArray
    sd_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class JointOrientation:
    """All cameras as oriented together.

    Attributes
    ----------
    cameras
        By camera; each with its own block of `covariance`.
    covariance
        (6 n, 6 n) joint covariance of the exteriors, cameras in the order of `cameras`.
    orientations
        Each camera on its own, before the joint adjustment: residuals and what was left out.
    points
        (3,) adjusted coordinates of control targets and ties, by name.
    excluded
        What was left out and why, by name.
    sigma0, degrees_of_freedom
        Of the joint adjustment.
    """

    cameras: dict[str, OrientedCamera]
    covariance: FloatArray
    orientations: dict[str, Orientation]
    points: dict[str, FloatArray]
    excluded: dict[str, str]
    sigma0: float
    degrees_of_freedom: int


def orient_jointly(
    lenses: Mapping[str, Lens],
    observations: Mapping[str, Sequence[ImageObservation]],
    control: Sequence[ControlPoint],
    *,
    side_mm: float | None = None,
    volume: bool | None = None,
) -> JointOrientation:
    """Orient all cameras of a rig from their sharp frames.

    Parameters
    ----------
    lenses
        Interior orientation by camera.
    observations
        Targets found in each camera's sharp frame. Names that `control` does not know are ties: they help when two
        cameras or more see them.
    control
        The survey.
    side_mm
        True size of the control targets; with the observations' `side_px` it uncovers a survey in the wrong unit.
    volume
        Refuse control in one plane; by default when there are several cameras.

    Returns
    -------
    Together

    Raises
    ------
    DataError
        What `orient` refuses, with the camera's name in front; control listed or seen twice.
    """
    check_names([point.name for point in control])
    volume = len(lenses) > 1 if volume is None else volume
    surveyed = {point.name: point for point in control}
    orientations: dict[str, Orientation] = {}
    excluded: dict[str, str] = {}
    for camera, lens in lenses.items():
        orientations[camera] = _orient_camera(camera, lens, observations[camera], surveyed, side_mm, volume)
        for name, reason in orientations[camera].excluded.items():
            excluded[name] = f"{excluded[name]}; {camera}: {reason}" if name in excluded else f"{camera}: {reason}"
    network, network_names = _build_network(lenses, observations, surveyed, orientations)
    adjustment, names, gross = adjust_without_gross_errors(network, network_names)
    camera_names = list(lenses)
    for name in set(names) & set(excluded) & set(surveyed):
        # Left out by every camera on its own, yet they agree where it is: then the survey is wrong, not the reading.
        off = adjustment.network.points[names.index(name)] - surveyed[name].position_mm
        if not np.isfinite(network.survey_sd[network_names.index(name)]).any():
            place = ", ".join(f"{value:+.1f}" for value in off)
            excluded[name] = f"mis-surveyed: the cameras see it ({place}) mm from its surveyed place"
    for error in gross:
        excluded[error.point] = _describe_error(error, camera_names)
    square = adjustment.sigma0**2 * adjustment.degrees_of_freedom
    worse = adjustment.degrees_of_freedom > 0 and square > chi2.isf(
        SNOOPING.inflation_probability, adjustment.degrees_of_freedom
    )
    covariance = adjustment.exterior_covariance(scaled=bool(worse))
    cameras = {
        camera: OrientedCamera(
            lenses[camera], pose.rotation, pose.position, covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        )
        for i, (camera, pose) in enumerate(zip(camera_names, adjustment.network.poses, strict=True))
    }
    return JointOrientation(
        cameras,
        covariance,
        orientations,
        dict(zip(names, adjustment.network.points, strict=True)),
        excluded,
        adjustment.sigma0,
        adjustment.degrees_of_freedom,
    )


def _orient_camera(
    camera: str,
    lens: Lens,
    seen: Sequence[ImageObservation],
    surveyed: Mapping[str, ControlPoint],
    side_mm: float | None,
    volume: bool,
) -> Orientation:
    """One camera on its own."""
    used = [observation for observation in seen if observation.name in surveyed]
    sides = [observation.side_px for observation in used]
    known_sides = np.array([side for side in sides if side is not None])
    try:
        return orient(
            lens,
            np.array([[s.x_px, s.y_px] for s in used]).reshape(-1, 2),
            np.array([surveyed[s.name].position_mm for s in used], dtype=float).reshape(-1, 3),
            names=[s.name for s in used],
            sd_image_px=np.array([s.sd_px for s in used]),
            sd_object_mm=np.array([surveyed[s.name].sd_mm for s in used]),
            volume=volume,
            side_px=known_sides if len(known_sides) == len(used) else None,
            side_mm=side_mm,
        )
    except DataError as exc:
        raise DataError(f"camera {camera}: {exc}") from exc


def _build_network(
    lenses: Mapping[str, Lens],
    observations: Mapping[str, Sequence[ImageObservation]],
    surveyed: Mapping[str, ControlPoint],
    orientations: Mapping[str, Orientation],
) -> tuple[Network, tuple[str, ...]]:
    """Network of all cameras, control that was used, and ties."""
    camera_names = list(lenses)
    rays: dict[str, list[tuple[int, ImageObservation]]] = {}
    seen_by: dict[str, list[str]] = {}
    for index, camera in enumerate(camera_names):
        for observation in observations[camera]:
            rays.setdefault(observation.name, []).append((index, observation))
            seen_by.setdefault(observation.name, []).append(camera)
    wrong = {name for name, by in seen_by.items() if all(name in orientations[camera].excluded for camera in by)}
    names: list[str] = []
    points: list[FloatArray] = []
    sds: list[FloatArray] = []
    entries: list[tuple[int, int, ImageObservation]] = []
    for name, every in rays.items():
        seen = every
        if name in surveyed and name not in wrong:
            seen = [(index, s) for index, s in every if name not in orientations[camera_names[index]].excluded]
            place, sd = np.asarray(surveyed[name].position_mm, dtype=float), surveyed[name].sd_mm
        else:
            if len({index for index, _ in seen}) < 2:
                continue
            try:
                cameras = [orientations[camera_names[index]].camera for index, _ in seen]
                place = nearest_point(cameras, [np.array([s.x_px, s.y_px]) for _, s in seen])
            except DataError:  # its rays do not meet: a mismatch, which may not tie the cameras together
                continue
            if not all(np.isfinite(camera.project(place[None])).all() for camera in cameras):
                continue
            sd = np.inf
        entries += [(index, len(names), observation) for index, observation in seen]
        names.append(name)
        points.append(place)
        sds.append(np.full(3, sd))
    network = Network(
        tuple(lenses.values()),
        tuple(Pose(orientations[c].camera.rotation, orientations[c].camera.position_mm) for c in camera_names),
        np.arange(len(camera_names)),
        np.array(points),
        np.array([entry[0] for entry in entries], dtype=np.intp),
        np.array([entry[1] for entry in entries], dtype=np.intp),
        np.array([[entry[2].x_px, entry[2].y_px] for entry in entries]),
        np.array([entry[2].sd_px for entry in entries]),
        np.array(sds),
    )
    return network, tuple(names)


def _describe_error(error: GrossError, camera_names: Sequence[str]) -> str:
    """Say why an observation was left out."""
    if error.kind == "survey":
        return f"its survey is off by about {error.size:.2f} mm ({error.test:.0f} times its standard deviation)"
    return (
        f"its place in {camera_names[error.image]} is off by about {error.size:.2f} px "
        f"({error.test:.0f} times its standard deviation): misread or misidentified"
    )
