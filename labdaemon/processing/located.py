"""The targets of a frame where they were found: their patches, and their measurement one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur import (
    ExposureWindow,
    InitialGuess,
    Measurement,
    Patch,
    SharedWaveform,
    SharpTarget,
    ThirdHarmonic,
    estimate_waveform,
    measure_frame,
)
from labdaemon.imaging import RawFrame
from labdaemon.processing.group import is_cycle_count_unknown, is_part_cycle
from labdaemon.processing.matched_filter import BlurredTarget
from labdaemon.processing.motion_laws import MotionLaws
from labdaemon.processing.prepare import PreparedCamera
from labdaemon.processing.shift import FrameShift


@dataclass(frozen=True, slots=True, eq=False)
class LocatedTargets:
    """A frame, its shift, and its blurred targets in the order of the camera's targets; None where not found."""

    frame: RawFrame
    shift: FrameShift
    smears: list[BlurredTarget | None]


def cut_patch(frame: RawFrame, target: SharpTarget, smear: BlurredTarget) -> Patch:
    """Cut a smear and some paper around it from a frame."""
    half_w, half_h = target.form.half_size_px
    path = np.hypot(smear.a_px, smear.b_px)
    # The search's lengths come in steps of a quarter; the fit wants paper on all sides.
    reach = 1.35 * path + np.array([half_w, half_h]) * 1.6 + 10
    x, y = (round(float(v)) for v in smear.centre_px)
    w, h = (int(np.ceil(v)) for v in reach)
    return frame.patch(x - w, y - h, 2 * w + 1, 2 * h + 1)


def fit_inputs(
    camera: PreparedCamera, located: LocatedTargets
) -> tuple[list[int], list[SharpTarget], list[Patch], list[InitialGuess]]:
    """Inputs of the fits: index of each target that was found, the target, its patch and its initial guess."""
    seen = [(index, smear) for index, smear in enumerate(located.smears) if smear is not None]
    targets = [camera.targets[index] for index, _ in seen]
    cuts = [cut_patch(located.frame, target, smear) for target, (_, smear) in zip(targets, seen, strict=True)]
    return [index for index, _ in seen], targets, cuts, [InitialGuess(s.centre_px, s.a_px, s.b_px) for _, s in seen]


def measure_first(
    camera: PreparedCamera, located: LocatedTargets, window: ExposureWindow | None, laws: MotionLaws
) -> tuple[dict[int, Measurement], SharedWaveform]:
    """Every target as over whole cycles, and what they show together; empty where that is not how to measure them."""
    unknown = is_cycle_count_unknown(window)
    if not unknown and window is not None and (is_part_cycle(window) or laws.rules):
        return {}, SharedWaveform()
    found, targets, cuts, _ = fit_inputs(camera, located)
    first = measure_smears(camera, located, None if unknown else window, laws)
    waveform = estimate_waveform(
        targets,
        cuts,
        [first[index] for index in found],
        defocus=located.shift.defocus,
        expected=None if window is None else (window.cycles, window.frequency_hz * window.sd_exposure_s),
        whole=not unknown,
    )
    is_last = waveform.harmonic is None and waveform.window is None and (window is None or not is_part_cycle(window))
    return first if is_last else {}, waveform


def measure_smears(
    camera: PreparedCamera,
    located: LocatedTargets,
    window: ExposureWindow | None,
    laws: MotionLaws,
    harmonic: ThirdHarmonic | None = None,
) -> dict[int, Measurement]:
    """Measure every target whose smear is known, by its index."""
    found, targets, cuts, starts = fit_inputs(camera, located)
    each = measure_frame(
        targets,
        cuts,
        window=window,
        defocus=located.shift.defocus,
        initial_guesses=starts,
        harmonics=[laws.of(one.name) or (None if harmonic is None else harmonic.of(one.name)) for one in targets],
    )
    return dict(zip(found, each, strict=True))
