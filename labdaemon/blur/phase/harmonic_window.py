"""Motion with harmonics through known windows: the phase of the fundamental is found first, without them."""

from __future__ import annotations

import math
from dataclasses import replace

from labdaemon.blur.harmonics import MotionHarmonics, major_phase_rad
from labdaemon.blur.phase.harmonic_fit import HarmonicFit, fit_harmonic
from labdaemon.blur.smear.frame_set import FrameSet


def fit_with_harmonics(
    frame_set: FrameSet, harmonics: MotionHarmonics | None, *, orbit: bool = True
) -> tuple[FrameSet, HarmonicFit]:
    """Fit a motion through known windows, and once more with the harmonics that a gauge shows.

    The harmonics go with the fundamental, whose phase the first fit finds; even ones show which of two opposite
    vectors it is.

    Returns
    -------
    FrameSet, HarmonicFit
        The frames as they were fitted last, and the fit.
    """
    found = fit_harmonic(frame_set, orbit=orbit)
    if harmonics is None or found.at_rest:
        return frame_set, found
    phase_rad = major_phase_rad(found.value[2:4], found.value[4:])
    fits = []
    for turn in (0.0, math.pi) if harmonics.has_even else (0.0,):
        own = harmonics.at_phase(phase_rad + turn)
        through = replace(frame_set, windows=[replace(window, harmonics=own) for window in frame_set.windows])
        fits.append((through, fit_harmonic(through, orbit=orbit)))
    return min(fits, key=lambda one: one[1].solution.cost)
