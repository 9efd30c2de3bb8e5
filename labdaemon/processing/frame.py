"""One camera's frame (or the frames of a group): every target located and measured, in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labdaemon.blur import (
    ExposureWindow,
    FloatArray,
    InitialGuess,
    Measurement,
    MotionHarmonics,
    SharpTarget,
    TargetFrames,
    average_measurements,
    estimate_group_harmonic,
    failure_flags,
    find_relative_signs,
    measure_group,
    measure_mccarthy2016,
    share_rest,
    solved,
    with_relative_sd,
)
from labdaemon.errors import DataError, UsageError
from labdaemon.flags import Flag
from labdaemon.geometry import CameraMotion, estimate_camera_motion
from labdaemon.imaging import LazyImage, RawFrame, read_frame
from labdaemon.processing.group import holds_phase, is_part_cycle
from labdaemon.processing.lamp_light import (
    UNEVEN_LIGHT,
    describe_ambient,
    describe_light,
    flag_light_mismatch,
    measure_under_code,
)
from labdaemon.processing.located import LocatedTargets, cut_patch, fit_inputs, measure_first, measure_smears
from labdaemon.processing.missing_targets import predict_missing
from labdaemon.processing.motion_laws import MotionLaws
from labdaemon.processing.prepare import PreparedCamera
from labdaemon.processing.shift import FrameShift, frame_shift
from labdaemon.processing.survey import SurveyedPoint
from labdaemon.processing.target_search import locate_targets
from labdaemon.processing.thumbnails import locate_patches

MOVED_PX = 1.0
"""Shift of a frame's control targets from which its measurements are flagged. Less is corrected and harms nothing."""


def not_found(target: SharpTarget) -> Measurement:
    """Make a measurement without numbers, of a target that is not in the frame."""
    lost = np.full(2, np.nan)
    return Measurement(target.name, lost, lost, lost, np.full((6, 6), np.nan), flags=frozenset({Flag.NOT_FOUND}))


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """A camera's part in a capture.

    Attributes
    ----------
    camera
        Its name.
    measurements
        One a target, in the order of the prepared camera's.
    shifts
        The control targets' measurement of each frame's shift.
    motions
        The camera's motion since the sharp frame, for each frame; empty without a survey.
    evidence
        For each target, twice the logarithm of the odds that it stood on the side of +a and not of −a at the middle of
        the exposure, by the phase that it shares with the others (`find_relative_signs`); empty for whole cycles and
        groups.
    notes
        What a person should know of the files, one line each.
    """

    camera: str
    measurements: tuple[Measurement, ...]
    shifts: tuple[FrameShift, ...]
    motions: tuple[CameraMotion, ...] = ()
    evidence: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def evidence_of(self, index: int) -> float:
        """Evidence for one target's sign."""
        return self.evidence[index] if self.evidence else 0.0


def measure_frames(
    camera: PreparedCamera,
    files: Sequence[Path],
    windows: Sequence[ExposureWindow | None],
    *,
    control: Sequence[SurveyedPoint] = (),
    method: str = "fit",
    laws: MotionLaws | None = None,
) -> FrameResult:
    """Measure every target of one camera in a capture, or in the captures of a group together.

    Parameters
    ----------
    camera
        Its sharp frames' content.
    files
        One frame, or a frame for each capture of the group.
    windows
        What is known of each exposure.
    control
        The survey, which resolves the camera's own motion in space.
    method
        "fit", or "paper" for the published method.
    laws
        Harmonics of the targets' motion, as gauges show them.

    Raises
    ------
    DataError
        A frame cannot be read, has another size, or cannot be from this camera.
    """
    frames = [read_frame(file, expect_size=camera.image_size) for file in files]
    return measure_raw(camera, frames, windows, control=control, method=method, laws=laws)


def measure_raw(
    camera: PreparedCamera,
    frames: Sequence[RawFrame],
    windows: Sequence[ExposureWindow | None],
    *,
    control: Sequence[SurveyedPoint] = (),
    method: str = "fit",
    laws: MotionLaws | None = None,
) -> FrameResult:
    """Measure frames that are already read; otherwise as `measure_frames`."""
    laws = laws or MotionLaws()
    greys = [frame.lazy_grey() for frame in frames]
    shifts = [frame_shift(frame, grey, camera.control) for frame, grey in zip(frames, greys, strict=True)]
    # First of all: a frame of another camera would only be searched in vain.
    motions = tuple(_camera_motion(camera, shift, control, f.path) for shift, f in zip(shifts, frames, strict=True))
    located_frames = [_locate_in(camera, *each) for each in zip(frames, greys, shifts, strict=True)]
    evidence: tuple[float, ...] = ()
    light_notes: list[str] = []
    if method == "paper":
        found = _measure_mccarthy2016(camera, located_frames)
    elif len(frames) == 1 and not (windows[0] is not None and windows[0].is_coded):
        found, light_notes = _measure_one(camera, located_frames[0], windows[0], laws)
        evidence = _evidence(camera, located_frames[0], windows[0], found)
    else:
        found, light_notes = _measure_together(camera, located_frames, windows, laws)
    found = [laws.with_unknown(one) for one in found]
    found = [_with_white(one, camera.targets[index], located_frames, index) for index, one in enumerate(found)]
    if any(_has_moved(located.shift) for located in located_frames) or any(
        motion is not None and motion.moved for motion in motions
    ):
        found = [replace(one, flags=one.flags | {Flag.CAMERA_MOVED}) for one in found]
    return FrameResult(
        camera.name,
        tuple(found),
        tuple(located.shift for located in located_frames),
        tuple(motion for motion in motions if motion is not None),
        evidence,
        (*(note for frame in frames for note in frame.notes), *light_notes),
    )


def _locate_in(camera: PreparedCamera, frame: RawFrame, grey: LazyImage, shift: FrameShift) -> LocatedTargets:
    dots = len(camera.expected)
    moved = shift.at(camera.centres_px[:dots])
    expected_targets = [
        replace(one, centre_px=one.centre_px + d) for one, d in zip(camera.expected, moved, strict=True)
    ]
    patches = locate_patches(grey, camera.centres_px[dots:], camera.thumbnails)
    return LocatedTargets(frame, shift, [*locate_targets(grey, expected_targets), *patches])


def _camera_motion(
    camera: PreparedCamera, shifted: FrameShift, control: Sequence[SurveyedPoint], file: Path
) -> CameraMotion | None:
    """The camera's motion between the sharp frame and this one; None without a survey."""
    if camera.orientation is None:
        return None
    places = {point.name: (point.x_mm, point.y_mm, point.z_mm) for point in control}
    used = {name for name, ok in zip(camera.orientation.names, camera.orientation.used, strict=True) if ok}
    stills = [still for still in shifted.stills if still.target in places and still.target in used]
    centres = dict(zip(camera.control.names, camera.control.centres_px, strict=True))
    sharp = np.array([centres[still.target] for still in stills]).reshape(-1, 2)
    shift = np.array([still.shift_px for still in stills]).reshape(-1, 2)
    sd = [np.hypot(np.sqrt(np.trace(still.covariance_px2[:2, :2]) / 2), 0.01) for still in stills]
    try:
        return estimate_camera_motion(
            camera.orientation.camera,
            np.array([places[still.target] for still in stills]).reshape(-1, 3),
            sharp,
            sharp + shift,
            names=[still.target for still in stills],
            sd_px=np.array(sd),
        )
    except DataError as exc:
        raise DataError(str(exc), file=file) from None


def _has_moved(shift: FrameShift) -> bool:
    return bool(shift.stills) and float(np.hypot(*shift.shift_px)) > MOVED_PX


def _with_white(
    one: Measurement, target: SharpTarget, located_frames: Sequence[LocatedTargets], index: int
) -> Measurement:
    """A measurement, flagged `saturated` where the paper is at white level in all channels, at rest or moving.

    The fit then takes the paper's brightness from the blurred edge alone, and its error exceeds its standard deviation.
    """
    if not np.isfinite(one.a_px).all():
        return one
    smears = [(located.frame, located.smears[index]) for located in located_frames]
    white = any(smear is not None and frame.is_white(cut_patch(frame, target, smear)) for frame, smear in smears)
    if white or Flag.SATURATED in target.flags:
        return replace(one, flags=one.flags | {Flag.SATURATED})
    return one


def _measure_one(
    camera: PreparedCamera, located: LocatedTargets, window: ExposureWindow | None, laws: MotionLaws
) -> tuple[list[Measurement], list[str]]:
    first, waveform = measure_first(camera, located, window, laws)
    if waveform.window is not None:
        window = waveform.window
    unknown = window is not None and window.phase_rad is None and is_part_cycle(window)
    if unknown and window is not None:
        # Axes do not depend on the opening phase: where it is unknown, any will do.
        window = replace(window, phase_rad=0.0)
    result = [
        _missing_target(located, target) if smear is None else not_found(target)
        for target, smear in zip(camera.targets, located.smears, strict=True)
    ]
    for index, one in (first or measure_smears(camera, located, window, laws, waveform.harmonic)).items():
        seen = unknown and bool(np.isfinite(one.a_px).all())
        result[index] = replace(one, flags=one.flags | {Flag.PART_CYCLES}) if seen else one
    # What was not found may be where its neighbours say, behind something, or with the end of its label in its blur.
    # Anything else there is not this target.
    dots = len(camera.expected)
    rest_px = camera.centres_px[:dots] + located.shift.at(camera.centres_px[:dots])
    expected = predict_missing(rest_px, located.smears[:dots])
    missing = replace(located, smears=[expected.get(index) for index in range(len(camera.targets))])
    for index, one in measure_smears(camera, missing, window, laws, waveform.harmonic).items():
        on_label = camera.targets[index].outline is not None and bool(np.isfinite(one.a_px).all())
        if one.flags & {Flag.OCCLUDED, Flag.PAPER_EDGE} or (on_label and Flag.POOR_FIT not in one.flags):
            result[index] = one
    result = [with_relative_sd(one, waveform.relative_sd) for one in result]
    if waveform.is_light_uneven:
        return flag_light_mismatch(result), [f"{located.frame.path}: {UNEVEN_LIGHT}"]
    return result, []


def _missing_target(located: LocatedTargets, target: SharpTarget) -> Measurement:
    """A measurement without numbers, of a target that was not found: perhaps because all is at white level there."""
    lost = not_found(target)
    at = target.centre_px + located.shift.at(target.centre_px[None])[0]
    (x, y), (w, h) = (round(float(v)) for v in at), (round(v) for v in target.form.half_size_px)
    white = failure_flags(target, located.frame.patch(x - w, y - h, 2 * w + 1, 2 * h + 1), at) & {Flag.SATURATED}
    return replace(lost, flags=lost.flags | white)


def _evidence(
    camera: PreparedCamera, located: LocatedTargets, window: ExposureWindow | None, measured: Sequence[Measurement]
) -> tuple[float, ...]:
    """Evidence for the sign of each target's a; 0 where there is none."""
    if window is None or not is_part_cycle(window):
        return ()
    found, targets, cuts, starts = fit_inputs(camera, located)
    signs = find_relative_signs(targets, cuts, window, defocus=located.shift.defocus, initial_guesses=starts)
    evidence = np.zeros(len(camera.targets))
    for index, vector, one, sign in zip(found, signs.vector_px, signs.evidence, signs.sign, strict=True):
        a = measured[index].a_px
        if np.isfinite([*a, *vector]).all() and not measured[index].b_px.any():
            evidence[index] = one * np.sign(a @ vector) * (-1.0 if sign < 0 else 1.0)
    return tuple(float(one) for one in evidence)


def _measure_together(
    camera: PreparedCamera,
    located_frames: Sequence[LocatedTargets],
    windows: Sequence[ExposureWindow | None],
    laws: MotionLaws,
) -> tuple[list[Measurement], list[str]]:
    """Every target in all frames of a group: signed vectors where the windows hold phase, else the frames' mean.

    With notes on frames whose light was not the stated code.
    """
    phased = [window for window in windows if window is not None and holds_phase(window)]
    if len(phased) == len(windows):

        def measure(windows: Sequence[ExposureWindow]) -> list[Measurement]:
            targets = [_in_frames(one, located_frames, windows, k) for k, one in enumerate(camera.targets)]
            found = [_measure_phased(one, laws.of(one.sharp.name)) for one in targets]
            harmonic = None if laws.rules else estimate_group_harmonic(targets, found)
            if harmonic is None:
                return found
            return [_measure_phased(one, harmonic.of(one.sharp.name)) for one in targets]

        seen = measure_under_code(measure, phased)
        coded = [each for each in zip(located_frames, phased, strict=True) if each[1].is_coded]
        said = [
            (one.frame.path, describe_light(fault)) for (one, _), fault in zip(coded, seen.faults, strict=True) if fault
        ]
        if seen.ambient is not None:
            said += [(one.frame.path, describe_ambient(window, seen.ambient)) for one, window in coded]
        rest_px = _rest_px(camera, located_frames)
        found = seen.measured if rest_px is None else share_rest(seen.measured, rest_px)
        return found, [f"{path}: {what}" for path, what in said]
    each = [
        _measure_one(camera, located, window, laws) for located, window in zip(located_frames, windows, strict=True)
    ]
    together = [average_measurements(measured) for measured in zip(*(found for found, _ in each), strict=True)]
    return together, [note for _, notes in each for note in notes]


def _rest_px(camera: PreparedCamera, located_frames: Sequence[LocatedTargets]) -> FloatArray | None:
    """(n, 2) where the targets would be at rest, mean over the frames; None where no sharp frame shows it."""
    if not camera.at_rest:
        return None
    shift_px = np.mean([located.shift.at(camera.centres_px) for located in located_frames], axis=0)
    return np.asarray(camera.centres_px + shift_px)


def _in_frames(
    target: SharpTarget, located_frames: Sequence[LocatedTargets], windows: Sequence[ExposureWindow], index: int
) -> TargetFrames:
    """A target in the frames of a group in which it was found."""
    cuts, starts, blurs, seen = [], [], [], []
    for located, window in zip(located_frames, windows, strict=True):
        smear = located.smears[index]
        if smear is not None:
            cuts.append(cut_patch(located.frame, target, smear))
            starts.append(InitialGuess(smear.centre_px, smear.a_px, smear.b_px))
            blurs.append(located.shift.defocus)
            seen.append(window)
    known = [blur for blur in blurs if blur is not None]
    return TargetFrames(target, cuts, seen, known if len(known) == len(blurs) else None, starts)


def _measure_phased(target: TargetFrames, harmonics: MotionHarmonics | None) -> Measurement:
    if not target.patches:
        return not_found(target.sharp)
    return measure_group(
        target.sharp,
        target.patches,
        target.windows,
        defocus=target.defocus,
        initial_guesses=target.initial_guesses,
        harmonics=harmonics,
    )


def _measure_mccarthy2016(camera: PreparedCamera, located_frames: Sequence[LocatedTargets]) -> list[Measurement]:
    """The published method on every dot of a frame."""
    if len(located_frames) > 1:
        raise UsageError("the published method knows no phase; take the group out of capture.toml, or method fit")
    if len(camera.dots) < len(camera.targets):
        raise UsageError("the published method measures dots; leave the patches out, or take method fit")
    found = []
    for target, (dot, sharp), smear in zip(camera.targets, camera.dots, located_frames[0].smears, strict=True):
        if smear is None:
            found.append(not_found(target))
            continue
        blurred = cut_patch(located_frames[0].frame, target, smear)
        named = replace(dot, name=target.name)
        one = solved(measure_mccarthy2016)(sharp, named, blurred, start_px=smear.centre_px)
        found.append(one if one is not None else replace(not_found(target), flags=frozenset({Flag.POOR_FIT})))
    return found
