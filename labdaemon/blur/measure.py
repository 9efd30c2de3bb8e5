"""A target's motion from its blurred patch: the fit that all others are variations of."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.fit.beside import is_plain_dot, measure_beside
from labdaemon.blur.fit.cover import contrast_left, uncovered, why_nothing
from labdaemon.blur.fit.declared import measure_declared
from labdaemon.blur.fit.whole_cycles import measure_whole_cycles
from labdaemon.blur.law import DisplacementLaw
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, Window, nothing
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.phase.known_window import measure_known_window
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_blur
from labdaemon.blur.smear.model import Setting, prepare
from labdaemon.flags import Flag

COVERED_CHI2 = 2.5  # residuals from which something in front is looked for; a motion's own harmonics make less
WHOLE = 0.01  # cycles from whole below which the window's phase does not show
LEAST_CONTRAST = 0.2  # of a texture, in parts of the sharp picture's, below which it is not there
PART = 0.05  # cycles from whole above which a model of whole cycles is biased


def measure(
    sharp: SharpTarget,
    patch: Patch,
    *,
    window: Window | None = None,
    extra_blur: ExtraBlur | None = None,
    start: Start | None = None,
    orbit: bool = True,
    law: DisplacementLaw | None = None,
    camera_shift_px: FloatArray | None = None,
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
    extra_blur
        What the frame's control targets say of defocus. None lets a dot's vary by 0.3 px² and takes a texture, whose
        own details cannot be told from defocus, for as sharp as before.
    start
        Where the target is expected; None takes its place in the sharp frame.
    orbit
        False forces straight motion.
    law
        A declared course of the displacement instead of a sinusoid: a is then the vector that multiplies it, b is none.
    camera_shift_px
        (2,) shift of the frame against the sharp one, added to the start when that comes from the sharp frame.

    Returns
    -------
    Measurement
        Numbers are NaN where the target could not be measured; the flags say why.
    """
    if not sharp.usable:
        return nothing(sharp.name, {Flag.NOT_FOUND})
    expected = np.asarray(start.centre_px if start is not None else sharp.centre_px, dtype=np.float64)
    if start is None and camera_shift_px is not None:
        expected = expected + camera_shift_px
    lit = patch.values[patch.valid & np.isfinite(patch.values)]
    if not np.any(lit > 0):
        return nothing(sharp.name, why_nothing(sharp, patch, expected))
    setting = prepare(sharp, patch, expected)
    if setting is not None:
        sharp = sharp.elsewhere(setting.start_px)
    blur = extra_blur if extra_blur is not None else default_blur(sharp)
    part = 0.0 if window is None else abs(window.cycles - round(window.cycles))

    def fit(setting: Setting) -> Measurement:
        if law is not None:
            return measure_declared(sharp, setting, blur, law)
        if window is not None and window.phase_rad is not None and part > WHOLE:
            return measure_known_window(sharp, setting, blur, window, orbit=orbit)
        flags = {Flag.PART_CYCLES} if part > PART else set()
        return measure_whole_cycles(sharp, patch, setting, blur, orbit=orbit, flags=flags)

    found = fit(setting) if setting is not None else nothing(sharp.name, why_nothing(sharp, patch, expected))
    if setting is not None and setting.blob is None and _astray(sharp, setting, expected, found):
        return nothing(sharp.name, {Flag.NOT_FOUND})
    if setting is not None and not (found.chi2 > COVERED_CHI2 and Flag.POOR_FIT in found.flags):
        return found
    if Flag.POOR_FIT in sharp.flags:
        return found
    if is_plain_dot(sharp):
        places = [place for place in (found.centre_px, expected, sharp.centre_px) if np.isfinite(place).all()]
        beside = measure_beside(sharp, patch, places, blur, found, fit)
        if beside is not None:
            return beside
    return uncovered(sharp, setting, found, fit) if setting is not None else found


def _astray(sharp: SharpTarget, setting: Setting, expected: FloatArray, found: Measurement) -> bool:
    """Whether a texture's fit left the box that it was to be seen in, or is of nothing: it is not there."""
    moved = np.concatenate((found.centre_px - expected, found.a_px))
    within = bool(np.all(np.abs(moved) <= np.tile(sharp.form.half_size_px, 2)))
    return not within or contrast_left(sharp, setting, found) < LEAST_CONTRAST
