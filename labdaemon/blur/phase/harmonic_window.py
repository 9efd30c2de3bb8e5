"""Motion with harmonics through known windows: the phase of the fundamental is found first, without them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.phase.harmonic_fit import HarmonicFit, fit_harmonic
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.half_turn import major_phase_rad, within_half_turn

PHASE_STEP_RAD = 0.05
"""Change of the stated phase by which a fit's response to it is taken. Numerics."""
MOST_CHANGE = 2.0
"""Change of the vectors over their size, for a radian of the stated phase, from which they are another solution."""
LEAST_REMAINING = 0.05
"""Least part of a change of the stated phase that the found one does not follow. Numerics."""
PHASE_ROUNDS, PHASE_TOLERANCE_RAD, MOST_STEP_RAD = 3, 2e-3, 0.2
"""Fits until the found phase is the stated one, what counts as the same, and the largest step. Numerics."""


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
    phase_rad = _phase(found)
    turns = (0.0, math.pi) if harmonics.has_even else (0.0,)
    fits = [_fit_tied(frame_set, harmonics, phase_rad + turn, orbit=orbit) for turn in turns]
    return min(fits, key=lambda one: one[1].solution.cost)


def _fit_tied(
    frame_set: FrameSet, harmonics: MotionHarmonics, phase_rad: float, *, orbit: bool
) -> tuple[FrameSet, HarmonicFit]:
    """A fit whose harmonics go with the phase that it finds.

    A fit takes the harmonics at a stated phase. Through part cycles the phase that it then finds follows the stated
    one, and only where both are the same is it the motion's: with the phase found F(φ) at a stated φ, φ = F(φ). By the
    implicit function theorem the error of the phase is that of the fit over 1 − dF/dφ.
    """

    def at(stated_rad: float) -> tuple[FrameSet, HarmonicFit]:
        own = harmonics.at_phase(stated_rad)
        through = replace(frame_set, windows=[replace(window, harmonics=own) for window in frame_set.windows])
        return through, fit_harmonic(through, orbit=orbit)

    first = at(phase_rad)
    if not frame_set.shows_phase or first[1].tables or first[1].at_rest:
        return first
    second = at(phase_rad + PHASE_STEP_RAD)[1]
    change = (second.value - first[1].value) / PHASE_STEP_RAD
    following = within_half_turn(_phase(second) - _phase(first[1])) / PHASE_STEP_RAD
    if np.abs(change[2:]).max() > MOST_CHANGE * first[1].size_px:
        return first  # another solution
    remaining = max(1 - following, LEAST_REMAINING)
    last, stated_rad = first, phase_rad
    for _ in range(PHASE_ROUNDS):
        away = within_half_turn(_phase(last[1]) - stated_rad) / remaining
        if abs(away) < PHASE_TOLERANCE_RAD:
            break
        stated_rad += float(np.clip(away, -MOST_STEP_RAD, MOST_STEP_RAD))
        last = at(stated_rad)
    found = last[1]
    a, b = found.value[2:4], found.value[4:]
    by_phase = np.concatenate((np.zeros(2), -b, a)) / float(a @ a + b @ b)
    tied = np.eye(6) + np.outer(change, by_phase) / remaining
    return last[0], replace(found, covariance=tied @ found.covariance @ tied.T)


def _phase(found: HarmonicFit) -> float:
    return major_phase_rad(found.value[2:4], found.value[4:])
