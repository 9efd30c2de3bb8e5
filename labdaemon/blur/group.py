"""Captures of one steady motion at several opening phases, measured together: signed vectors a and b."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.measure import measure
from labdaemon.blur.motion import Defocus, ExposureWindow, InitialGuess, Measurement, empty_measurement
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.phase.harmonic_fit import fit_harmonic
from labdaemon.blur.phase.known_window import phased_measurement
from labdaemon.blur.settings import MEASURE
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_defocus
from labdaemon.blur.smear.forward_model import FitProblem, prepare_fit
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.blur.unsolvable import flag_unsolvable
from labdaemon.errors import UsageError
from labdaemon.flags import Flag


@flag_unsolvable
def measure_group(
    sharp: SharpTarget,
    patches: Sequence[Patch],
    windows: Sequence[ExposureWindow],
    *,
    defocus: Sequence[Defocus] | Defocus | None = None,
    initial_guesses: Sequence[InitialGuess] | None = None,
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
        return empty_measurement(sharp.name, {Flag.NOT_FOUND})
    if all(window.fraction < MEASURE.whole_cycle_tolerance and not window.is_coded for window in windows):
        return _average_whole_cycles(sharp, patches, windows, defocus, initial_guesses)
    blurs = [defocus or default_defocus(sharp)] * count if not isinstance(defocus, Sequence) else list(defocus)
    problems: list[FitProblem] = []
    for index, patch in enumerate(patches):
        expected = initial_guesses[index].centre_px if initial_guesses is not None else sharp.centre_px
        problem = prepare_fit(sharp, patch, np.asarray(expected, dtype=np.float64))
        if problem is None:
            return empty_measurement(sharp.name, {Flag.NOT_FOUND})
        problems.append(problem)
    there = np.mean([problem.initial_centre_px for problem in problems], axis=0)
    frame_set = FrameSet.from_problems(sharp.with_scale_uncertainty(there), problems, windows, blurs)
    return phased_measurement(frame_set, fit_harmonic(frame_set))


def _average_whole_cycles(
    sharp: SharpTarget,
    patches: Sequence[Patch],
    windows: Sequence[ExposureWindow],
    defocus: Sequence[Defocus] | Defocus | None,
    initial_guesses: Sequence[InitialGuess] | None,
) -> Measurement:
    """Whole cycles look the same from whatever phase they are opened at: the frames' mean, drop_phase."""
    single = [
        measure(
            sharp,
            patch,
            window=windows[index],
            defocus=defocus[index] if isinstance(defocus, Sequence) else defocus,
            initial_guess=None if initial_guesses is None else initial_guesses[index],
        )
        for index, patch in enumerate(patches)
    ]
    seen = [one for one in single if np.all(np.isfinite(one.a_px))]
    if not seen:
        return single[0]
    reference = max(seen, key=lambda one: float(np.hypot(*one.a_px)))

    def vector(one: Measurement) -> FloatArray:
        a = one.a_px if float(one.a_px @ reference.a_px) >= 0 else -one.a_px
        b = one.b_px if float(one.b_px @ reference.b_px) >= 0 else -one.b_px
        return np.concatenate((one.centre_px, a, b))

    weight = np.array([1 / max(float(np.trace(one.covariance_px2[2:4, 2:4])), 1e-12) for one in seen])
    weight /= weight.sum()
    value = np.sum([w * vector(one) for w, one in zip(weight, seen, strict=True)], axis=0)
    covariance = np.sum([w**2 * one.covariance_px2 for w, one in zip(weight, seen, strict=True)], axis=0)
    flags = {flag for one in single for flag in one.flags}
    if not all(Flag.AT_REST in one.flags for one in single):
        flags.discard(Flag.AT_REST)
    blur = float(weight @ np.array([one.defocus_px2 for one in seen]))
    chi2 = float(weight @ np.array([one.chi2 for one in seen]))
    return Measurement(sharp.name, value[:2], value[2:4], value[4:], covariance, False, frozenset(flags), blur, chi2)
