"""Captures of one steady motion at several opening phases, measured together: signed vectors a and b."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.average import average_measurements
from labdaemon.blur.fit.label_edge import prepare_on_label
from labdaemon.blur.fit.texture_windows import measure_still_texture
from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.measure import measure
from labdaemon.blur.motion import Defocus, ExposureWindow, InitialGuess, Measurement, empty_measurement
from labdaemon.blur.patch.pixels import Patch
from labdaemon.blur.phase.harmonic_window import fit_with_harmonics
from labdaemon.blur.phase.known_window import phased_measurement
from labdaemon.blur.phase.window_evidence import BEST_PX, SIGN
from labdaemon.blur.phase.window_harmonic import (
    HarmonicEvidence,
    WindowHarmonic,
    harmonic_evidence,
    says_harmonic,
    window_harmonic,
)
from labdaemon.blur.settings import MEASURE
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_defocus
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.blur.smear.member_agreement import flag_contradiction
from labdaemon.blur.smear.mixed_motion import flag_mixed_motion
from labdaemon.blur.unsolvable import flag_unsolvable, solved
from labdaemon.errors import UsageError
from labdaemon.flags import Flag

HARMONIC_TARGETS, FIRST_HARMONIC_TARGETS = 8, 4
"""Targets of a group that are asked for a third harmonic, and of those the ones that are asked in any case."""


@flag_unsolvable
def measure_group(
    sharp: SharpTarget,
    patches: Sequence[Patch],
    windows: Sequence[ExposureWindow],
    *,
    defocus: Sequence[Defocus] | Defocus | None = None,
    initial_guesses: Sequence[InitialGuess] | None = None,
    harmonics: MotionHarmonics | None = None,
) -> Measurement:
    """Measure one steady motion from several frames opened at known phases.

    The mean position is free in each frame (a tenth of a pixel of drift would turn into tens of degrees); a, b and the
    target's shape are common. Timing uncertainty of each window enters the covariance.

    Parameters
    ----------
    sharp
        The target at rest.
    patches, windows
        One a frame; every window with its phase.
    defocus
        Of each frame, or one for all.
    initial_guesses
        Expected place in each frame.
    harmonics
        Of the motion, where a gauge shows them.

    Returns
    -------
    Measurement
        `phased` is True; the centre is the mean over frames. Whole cycles hold no phase: then it is False, and a and b
        are the orbit's axes. With a single frame, or several that see the same part of
        the cycle, time-reversed solutions fit equally well: then `Flag.AMBIGUOUS` is set.

    Raises
    ------
    UsageError
        Not one window a patch, or a window without phase.
    """
    count = len(patches)
    if count == 0 or len(windows) != count or (initial_guesses is not None and len(initial_guesses) != count):
        raise UsageError("a group needs one window (and one start, if any) for each frame")
    if any(window.phase_rad is None and not window.is_coded for window in windows):
        raise UsageError("every frame of a group needs its opening phase (phase_rad in capture.toml)")
    if not sharp.usable:
        return empty_measurement(sharp.name, {Flag.NOT_FOUND, *sharp.flags})
    if all(window.fraction < MEASURE.whole_cycle_tolerance and not window.is_coded for window in windows):
        return _average_whole_cycles(sharp, patches, windows, defocus, initial_guesses, harmonics)
    frame_set = _prepare_frames(TargetFrames(sharp, patches, windows, defocus, initial_guesses))
    if isinstance(frame_set, Measurement):
        return frame_set
    frame_set, fitted = fit_with_harmonics(frame_set, harmonics)
    found = flag_mixed_motion(phased_measurement(frame_set, fitted), frame_set, fitted.solution)
    return flag_contradiction(found, frame_set, fitted.solution)


@dataclass(frozen=True, slots=True, eq=False)
class TargetFrames:
    """A target in the frames of a group; as the parameters of `measure_group`."""

    sharp: SharpTarget
    patches: Sequence[Patch]
    windows: Sequence[ExposureWindow]
    defocus: Sequence[Defocus] | Defocus | None = None
    initial_guesses: Sequence[InitialGuess] | None = None


def estimate_group_harmonic(targets: Sequence[TargetFrames], measured: Sequence[Measurement]) -> WindowHarmonic | None:
    """The third harmonic that the targets of a group of frames under constant light show together.

    Parameters
    ----------
    targets, measured
        Each target in its frames, and its motion as a sinusoid.

    Returns
    -------
    WindowHarmonic or None
        None where they show none; else every target is to be measured again with its own.
    """
    pairs = [pair for pair in zip(targets, measured, strict=True) if says_harmonic(pair[1])]
    pairs = [pair for pair in pairs if not any(window.is_coded for window in pair[0].windows)]
    pairs.sort(key=lambda pair: abs(math.log(pair[1].amplitude_px / BEST_PX)))
    found: list[HarmonicEvidence] = []
    for place, (target, one) in enumerate(pairs[:HARMONIC_TARGETS]):
        if place == FIRST_HARMONIC_TARGETS and sum(seen.gain for seen in found) < 2 * len(found) + SIGN:
            break
        evidence = _harmonic_evidence(target, one)
        if evidence is not None:
            found.append(evidence)
    return window_harmonic(found)


@solved
def _harmonic_evidence(target: TargetFrames, found: Measurement) -> HarmonicEvidence | None:
    frame_set = _prepare_frames(target)
    return None if isinstance(frame_set, Measurement) else harmonic_evidence(frame_set, found)


def _prepare_frames(target: TargetFrames) -> FrameSet | Measurement:
    """A target's frames, ready to be fitted; what they show where they are not to be."""
    sharp, defocus, guesses, count = target.sharp, target.defocus, target.initial_guesses, len(target.patches)
    blurs = [defocus or default_defocus(sharp)] * count if not isinstance(defocus, Sequence) else list(defocus)
    problems: list[FitProblem] = []
    for index, (patch, window) in enumerate(zip(target.patches, target.windows, strict=True)):
        guess = guesses[index] if guesses is not None else InitialGuess(sharp.centre_px)
        problem = prepare_on_label(sharp, patch, guess, is_divided=window.is_coded)
        if problem is None:
            return empty_measurement(sharp.name, {Flag.NOT_FOUND})
        problems.append(problem)
    there = np.mean([problem.initial_centre_px for problem in problems], axis=0)
    return measure_still_texture(sharp.with_scale_uncertainty(there), problems, target.windows, blurs)


def _average_whole_cycles(
    sharp: SharpTarget,
    patches: Sequence[Patch],
    windows: Sequence[ExposureWindow],
    defocus: Sequence[Defocus] | Defocus | None,
    initial_guesses: Sequence[InitialGuess] | None,
    harmonics: MotionHarmonics | None,
) -> Measurement:
    """Mean over the frames, without phase: whole cycles give the same image whatever phase they begin at."""
    return average_measurements(
        [
            measure(
                sharp,
                patch,
                window=windows[index],
                defocus=defocus[index] if isinstance(defocus, Sequence) else defocus,
                initial_guess=None if initial_guesses is None else initial_guesses[index],
                harmonics=harmonics,
            )
            for index, patch in enumerate(patches)
        ]
    )
