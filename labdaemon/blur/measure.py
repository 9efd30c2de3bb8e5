"""A target's motion from its blurred patch: the fit that all others are variations of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur.fit.harmonic_refit import refit_with_harmonics
from labdaemon.blur.fit.label_edge import measure_on_label, reaches_patch
from labdaemon.blur.fit.occlusion import fit_occluded, is_plain_dot
from labdaemon.blur.fit.refit import contrast_ratio, failure_flags, refit_without_occluder
from labdaemon.blur.fit.texture_windows import measure_still_texture
from labdaemon.blur.fit.waveform_fit import measure_waveform
from labdaemon.blur.fit.whole_cycles import measure_whole_cycles
from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.motion import Defocus, ExposureWindow, InitialGuess, Measurement, empty_measurement
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.phase.known_window import measure_known_window
from labdaemon.blur.settings import MEASURE
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_defocus
from labdaemon.blur.smear.fit_problem import FitProblem, prepare_fit
from labdaemon.blur.unsolvable import flag_unsolvable
from labdaemon.blur.waveform import MotionWaveform
from labdaemon.flags import Flag


@flag_unsolvable
def measure(
    sharp: SharpTarget,
    patch: Patch,
    *,
    window: ExposureWindow | None = None,
    defocus: Defocus | None = None,
    initial_guess: InitialGuess | None = None,
    orbit: bool = True,
    waveform: MotionWaveform | None = None,
    camera_shift_px: FloatArray | None = None,
    harmonics: MotionHarmonics | None = None,
) -> Measurement:
    """Measure a target's motion.

    Parameters
    ----------
    sharp
        The target at rest.
    patch
        Part of the blurred frame that holds the whole smear and some paper around it.
    window
        When the shutter was open; without it, or without its phase, whole cycles are assumed.
    defocus
        What the frame's control targets say of defocus. None lets a dot's vary by 0.3 px²; a textured patch, whose
        own details do not differ from defocus, counts as sharp as before.
    initial_guess
        Where the target is expected; None takes its place in the sharp frame.
    orbit
        False forces straight motion.
    waveform
        A declared course of the displacement instead of a sinusoid: a is then the vector that multiplies it, b is none.
    camera_shift_px
        (2,) shift of the frame against the sharp one, added to the start when that comes from the sharp frame.
    harmonics
        Of the motion, where a gauge that moves with the target shows them: a and b are then the fundamental's.

    Returns
    -------
    Measurement
        Numbers are NaN where the target could not be measured; the flags say why.
    """
    if not sharp.usable:
        return empty_measurement(sharp.name, {Flag.NOT_FOUND, *sharp.flags})
    expected = np.asarray(initial_guess.centre_px if initial_guess is not None else sharp.centre_px, dtype=np.float64)
    if initial_guess is None and camera_shift_px is not None:
        expected = expected + camera_shift_px
    lit = patch.values[patch.valid & np.isfinite(patch.values)]
    if not np.any(lit > 0):
        return empty_measurement(sharp.name, failure_flags(sharp, patch, expected))
    guess = initial_guess if initial_guess is not None else InitialGuess(expected)
    blur = defocus if defocus is not None else default_defocus(sharp)
    options = _Options(window, blur, orbit, waveform, harmonics)

    def attempt(part: Patch, start: InitialGuess, search_occluder: bool) -> Measurement:
        return _measure_patch(sharp, part, start, options, search_occluder=search_occluder)

    if sharp.outline is not None and reaches_patch(sharp.outline, patch, guess):
        return measure_on_label(sharp, sharp.outline, patch, guess, attempt)
    return attempt(patch, InitialGuess(expected), True)


@dataclass(frozen=True, slots=True)
class _Options:
    """What a fit is to assume: see `measure`."""

    window: ExposureWindow | None
    blur: Defocus
    orbit: bool
    waveform: MotionWaveform | None
    harmonics: MotionHarmonics | None


def _measure_patch(
    sharp: SharpTarget, patch: Patch, guess: InitialGuess, options: _Options, *, search_occluder: bool
) -> Measurement:
    """Fit one patch; where that fails, perhaps again without what hides a part of the target."""
    expected = np.asarray(guess.centre_px, dtype=np.float64)
    problem = prepare_fit(sharp, patch, expected)
    if problem is not None:
        problem = problem.starting_from(sharp, guess)
        sharp = sharp.with_scale_uncertainty(problem.initial_centre_px)
    window, blur, orbit = options.window, options.blur, options.orbit
    waveform, harmonics = options.waveform, options.harmonics
    fraction = 0.0 if window is None else window.fraction

    def fit(problem: FitProblem) -> Measurement:
        if waveform is not None:
            return measure_waveform(sharp, problem, blur, waveform)
        phased = window is not None and window.phase_rad is not None and fraction > MEASURE.whole_cycle_tolerance
        if window is not None and (phased or window.is_coded):
            seen = measure_still_texture(sharp, [problem], [window], [blur])
            if isinstance(seen, Measurement):
                return seen
            return measure_known_window(seen, window, orbit=orbit, harmonics=harmonics)
        flags = {Flag.PART_CYCLES} if fraction > MEASURE.part_cycle_limit else set()
        sine = measure_whole_cycles(sharp, patch, problem, blur, orbit=orbit, flags=flags)
        return sine if harmonics is None else refit_with_harmonics(sharp, problem, blur, sine, harmonics)

    found = (
        fit(problem) if problem is not None else empty_measurement(sharp.name, failure_flags(sharp, patch, expected))
    )
    is_texture = problem is not None and problem.blob is None and bool(np.isfinite(found.a_px).all())
    if problem is not None and is_texture and _is_lost(sharp, problem, expected, found):
        return empty_measurement(sharp.name, {Flag.NOT_FOUND})
    if problem is not None and not (found.chi2 > MEASURE.occlusion_chi2 and Flag.POOR_FIT in found.flags):
        return found
    if Flag.POOR_FIT in sharp.flags or not search_occluder:
        return found
    if is_plain_dot(sharp):
        places = [place for place in (found.centre_px, expected, sharp.centre_px) if np.isfinite(place).all()]
        occluded = fit_occluded(sharp, patch, places, blur, found, fit)
        if occluded is not None:
            return occluded
    return refit_without_occluder(sharp, problem, found, fit) if problem is not None else found


def _is_lost(sharp: SharpTarget, problem: FitProblem, expected: FloatArray, found: Measurement) -> bool:
    """Whether a texture's fit left the box that it was to be seen in, or is of nothing: it is not there."""
    moved = np.concatenate((found.centre_px - expected, found.a_px))
    within = bool(np.all(np.abs(moved) <= np.tile(sharp.form.half_size_px, 2)))
    return not within or contrast_ratio(sharp, problem, found) < MEASURE.min_contrast_ratio
