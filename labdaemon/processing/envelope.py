"""From every camera's measurements of a capture to its envelope in millimetres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from labdaemon.blur import AlternativeMotion, FloatArray, Measurement, decide_sign
from labdaemon.flags import Flag
from labdaemon.geometry import (
    ImageMotion,
    ObjectMotion,
    OrientedCamera,
    compensate_camera_motion,
    intersect_targets,
    map_motion_to_plane,
)
from labdaemon.processing.common_light import check_common_light
from labdaemon.processing.exposure import exposure_window
from labdaemon.processing.folder import DataFolder, check_frequencies, open_folder
from labdaemon.processing.frame import FrameResult, measure_frames
from labdaemon.processing.motion_laws import motion_laws
from labdaemon.processing.sharpset import SharpSet
from labdaemon.processing.tables import Row, envelope_row, measurement_row

SPOILING_FLAGS = frozenset(
    {
        Flag.NOT_FOUND,
        Flag.SATURATED,
        Flag.OCCLUDED,
        Flag.PAPER_EDGE,
        Flag.POOR_FIT,
        Flag.AMBIGUOUS,
        Flag.UNDETERMINED,
        Flag.MIXED_MOTION,
    }
)
"""Flags for which a camera is left out where two others see a target without them."""
ORBIT_AXIS_RATIO = 0.02
"""Ratio of the axes from which a path in space is an orbit, and has no sign."""

_Seen: TypeAlias = Mapping[str, Mapping[str, Measurement]]


@dataclass(frozen=True, slots=True)
class CaptureResult:
    """What one capture, or one group of captures, gave.

    Attributes
    ----------
    name
        The capture's or the group's.
    captures
        The captures in it.
    measurement_rows, envelope_rows
        Rows of the result files.
    notes
        What a person should know, one line each.
    frames
        Camera and file, relative to the folder, of the frames on which the result may be drawn (a group's
        last capture).
    """

    name: str
    captures: tuple[str, ...]
    measurement_rows: list[Row] = field(default_factory=list)
    envelope_rows: list[Row] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    frames: tuple[tuple[str, Path], ...] = ()


def measure_in_folder(folder: DataFolder, sharp: SharpSet, captures: Sequence[str], camera: str) -> FrameResult:
    """Measure one camera's frames of a capture or group; one task for a worker."""
    files = [folder.capture(name) for name in captures]
    prepared = next(one for one in sharp.cameras if one.name == camera)
    return measure_frames(
        prepared,
        [one.frames[camera] for one in files],
        [exposure_window(one.about, camera, one.frames[camera]) for one in files],
        control=sharp.control,
        method=sharp.method,
        laws=motion_laws(folder.rig.stands_for, [one.about.gauges for one in files]),
    )


def measure_capture(folder: Path, sharp: SharpSet, captures: tuple[str, ...], name: str) -> CaptureResult:
    """Measure a capture, or the captures of a group, of a data-set folder.

    Parameters
    ----------
    folder
        The data-set folder.
    sharp
        From `prepare_sharp`.
    captures
        Names of the captures, several for a group.
    name
        Under which to report: the capture's own, or the group's.

    Raises
    ------
    DataError, ConfigError
        One line naming the file at fault.
    """
    opened = open_folder(folder)
    check_frequencies(opened, captures, name)
    frames = [measure_in_folder(opened, sharp, captures, camera.name) for camera in sharp.cameras]
    return join_frames(opened, sharp, frames, captures, name)


def join_frames(
    folder: DataFolder, sharp: SharpSet, frames: Sequence[FrameResult], captures: Sequence[str], name: str
) -> CaptureResult:
    """Join the cameras' measurements.

    Parameters
    ----------
    folder
        Where the frames lie.
    sharp
        The sharp set they were measured against.
    frames
        One a camera, in the set's order.
    captures, name
        As in `measure_capture`.
    """
    frames = check_common_light(frames)
    by_target, evidence = _by_target(sharp, frames)
    rows = [
        measurement_row(name, frame.camera, measurement, decide_sign(frame.evidence_of(index)))
        for frame in frames
        for index, measurement in enumerate(frame.measurements)
    ]
    views = _views(sharp, frames)
    if sharp.plane is not None:
        joined = _map_to_plane(sharp, frames[0], by_target)
    else:
        joined = _intersect_in_space(sharp, views, by_target, evidence)
    envelope = []
    for target, sure in zip(sharp.targets, sharp.sure, strict=True):
        motion = joined.get(target)
        flags = _flags(by_target[target], motion, cameras=len(views), sure=bool(sure))
        sign = 0 if motion is None else _sign(views, motion, by_target[target], evidence[target])
        envelope.append(envelope_row(name, target, motion, flags, sign))
    files = folder.capture(captures[-1]).frames
    drawn = tuple((camera, file.relative_to(folder.root)) for camera, file in files.items())
    notes = [*_notes(frames, name), *_unknown_phases(folder, captures)]
    return CaptureResult(name, tuple(captures), rows, envelope, tuple(notes), drawn)


def join_motions(sharp: SharpSet, frames: Sequence[FrameResult]) -> dict[str, tuple[ObjectMotion, set[Flag]]]:
    """Intersect the cameras' measurements of a capture: motions with their covariance, and flags, by target.

    Parameters
    ----------
    sharp, frames
        As in `join_frames`, of two cameras or more.
    """
    frames = check_common_light(frames)
    by_target, evidence = _by_target(sharp, frames)
    views = _views(sharp, frames)
    joined = _intersect_in_space(sharp, views, by_target, evidence)
    return {
        target: (motion, _flags(by_target[target], motion, cameras=len(views), sure=True))
        for target, motion in joined.items()
    }


def _by_target(
    sharp: SharpSet, frames: Sequence[FrameResult]
) -> tuple[dict[str, dict[str, Measurement]], dict[str, dict[str, float]]]:
    """Measurements, and evidence of signs, by target and camera."""
    measurements: dict[str, dict[str, Measurement]] = {target: {} for target in sharp.targets}
    evidence: dict[str, dict[str, float]] = {target: {} for target in sharp.targets}
    for frame in frames:
        for index, measurement in enumerate(frame.measurements):
            measurements[measurement.target][frame.camera] = measurement
            evidence[measurement.target][frame.camera] = frame.evidence_of(index)
    return measurements, evidence


def _map_to_plane(sharp: SharpSet, frame: FrameResult, by_target: _Seen) -> dict[str, ObjectMotion]:
    """One camera: motion in the plane, the frame's own shift and turn taken off."""
    plane, camera = sharp.plane, sharp.cameras[0]
    assert plane is not None
    result = {}
    for target, seen in by_target.items():
        measurement = seen.get(camera.name)
        if measurement is None or not _has_numbers(measurement):
            continue
        image_motion = _image_motion(measurement)
        if frame.motions:
            image_motion = compensate_camera_motion(plane, image_motion, camera.view, [m.camera for m in frame.motions])
        motion = map_motion_to_plane(plane, image_motion)
        if np.isfinite(motion.mean_mm).all():
            result[target] = motion
    return result


def _views(sharp: SharpSet, frames: Sequence[FrameResult]) -> dict[str, OrientedCamera]:
    """Each camera as it stood in this capture."""
    # The captures of a group lie apart by less than a camera moves; the first one's place is taken for all.
    return {
        camera.name: frame.motions[0].camera if frame.motions else camera.view
        for camera, frame in zip(sharp.cameras, frames, strict=True)
    }


def _intersect_in_space(
    sharp: SharpSet, views: Mapping[str, OrientedCamera], by_target: _Seen, evidence: Mapping[str, Mapping[str, float]]
) -> dict[str, ObjectMotion]:
    """Intersect the rays of several cameras."""
    image_motions = {
        target: {
            camera: _image_motion(one, sharp.sd_point_px.get(target, 0.0))
            for camera, one in _select_clean(seen).items()
        }
        for target, seen in by_target.items()
    }
    joined = intersect_targets(views, image_motions, covariance=sharp.covariance, evidence=evidence)
    return {
        target: motion
        for target, motion in joined.motions.items()
        if target not in joined.refused and np.isfinite(motion.mean_mm).all()
    }


def _sign(
    views: Mapping[str, OrientedCamera],
    motion: ObjectMotion,
    seen: Mapping[str, Measurement],
    evidence: Mapping[str, float],
) -> int:
    """Sign of a target's a in space by its cameras' evidence; 0 where they have none, or contradict each other."""
    if Flag.AMBIGUOUS in motion.flags or np.linalg.norm(motion.b_mm) > ORBIT_AXIS_RATIO * np.linalg.norm(motion.a_mm):
        return 0
    turned = []
    for camera, one in _select_clean(seen).items():
        a_px = views[camera].project_with_jacobians(motion.mean_mm[None])[1][0] @ motion.a_mm
        turned.append(evidence.get(camera, 0.0) * float(np.sign(a_px @ one.a_px)))
    signs = {decide_sign(one) for one in turned} - {0}
    return 0 if len(signs) > 1 else decide_sign(sum(turned))


def _image_motion(measurement: Measurement, sd_point_px: float = 0.0) -> ImageMotion:
    """A camera's measurement; `sd_point_px` is how well its place shows the same point as the other cameras'."""
    point = np.diag([sd_point_px**2] * 2 + [0.0] * 4)
    return ImageMotion(
        measurement.centre_px,
        measurement.a_px,
        measurement.b_px,
        measurement.covariance_px2 + point,
        measurement.phased,
        None if measurement.axes is None else _image_motion(measurement.axes, sd_point_px),
        _candidates(measurement.alternatives, point),
        _candidates(measurement.arc, point),
        measurement.rest,
    )


def _candidates(motions: Sequence[AlternativeMotion], point_px2: FloatArray) -> tuple[ImageMotion, ...]:
    return tuple(
        ImageMotion(one.centre_px, one.a_px, one.b_px, one.covariance_px2 + point_px2, True, excess=one.excess)
        for one in motions
    )


def _leaves_twins(measurement: Measurement) -> bool:
    """Whether a camera's candidates are known, and were combined with the other cameras'."""
    return bool(measurement.alternatives)


def _is_spoilt(measurement: Measurement) -> bool:
    """Whether a camera is left out where two others see a target well."""
    spoiling = measurement.flags & SPOILING_FLAGS
    return bool(spoiling - {Flag.AMBIGUOUS} if _leaves_twins(measurement) else spoiling)


def _has_numbers(measurement: Measurement) -> bool:
    return bool(np.isfinite([*measurement.centre_px, *measurement.a_px, *measurement.b_px]).all())


def _select_clean(seen: Mapping[str, Measurement]) -> dict[str, Measurement]:
    """Select the cameras for a target's motion: those without a spoiling flag where two or more are, else all."""
    measured = {camera: one for camera, one in seen.items() if _has_numbers(one)}
    clean = {camera: one for camera, one in measured.items() if not _is_spoilt(one)}
    return clean if len(clean) >= 2 else measured


def _flags(seen: Mapping[str, Measurement], motion: ObjectMotion | None, *, cameras: int, sure: bool) -> set[Flag]:
    """What is said of a target, by those cameras that its motion rests on."""
    used = _select_clean(seen) if cameras > 1 and motion is not None else dict(seen)
    flags = {flag for one in used.values() for flag in one.flags}
    if motion is None:
        return (flags - {Flag.AT_REST}) | {Flag.NOT_FOUND}
    ambiguous = [one for one in used.values() if Flag.AMBIGUOUS in one.flags]
    # A camera that hardly shows the phase takes it from one that does.
    phase_shows = any(one.phased and one.axes is None for one in used.values())
    if len(used) > 1 and all(_leaves_twins(one) or (one.axes is not None and phase_shows) for one in ambiguous):
        # The cameras together decide between what each one leaves open.
        flags.discard(Flag.AMBIGUOUS)
    flags |= motion.flags
    if not all(Flag.AT_REST in one.flags for one in used.values()):
        flags.discard(Flag.AT_REST)
    if not sure:
        flags.add(Flag.AMBIGUOUS)
    return flags


def _notes(frames: Sequence[FrameResult], name: str) -> list[str]:
    left_out = [
        f"{name}: {frame.camera}: control target {target} left out, {reason}"
        for frame in frames
        for motion in frame.motions
        for target, reason in motion.excluded.items()
    ]
    return [*(note for frame in frames for note in frame.notes), *left_out]


def _unknown_phases(folder: DataFolder, captures: Sequence[str]) -> list[str]:
    """Captures under coded light whose motions could be signed, if the phase of the code were known."""
    abouts = [(name, folder.capture(name).about) for name in captures]
    return [
        f"{name}: capture.toml has light, but no light_phase_rad: motions are measured without phase and sign"
        for name, about in abouts
        if about.light is not None and about.light_phase_rad is None
    ]
