"""One frame through a known window of non-whole cycles."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.motion import ExposureWindow, Measurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.harmonic_fit import HarmonicFit
from labdaemon.blur.phase.harmonic_window import fit_with_harmonics
from labdaemon.blur.phase.orbits import perpendicular
from labdaemon.blur.phase.posterior import InPhaseMotion
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.frame_set import FRAME_PARAMETERS, FrameSet
from labdaemon.blur.smear.mixed_motion import flag_mixed_motion
from labdaemon.blur.smear.uncertainty import quality_flags
from labdaemon.flags import Flag
from labdaemon.orbit_axes import orient_positive, principal_axes


def measure_known_window(
    frame_set: FrameSet, window: ExposureWindow, *, orbit: bool, harmonics: MotionHarmonics | None = None
) -> Measurement:
    """One frame through a known window: the axes as over whole cycles, but without the bias of the part cycle.

    Under constant light the phase of a single frame has a mirror image that fits as well, so it is not reported; see
    `measure_group`. Under coded light it is.
    """
    frame_set, found = fit_with_harmonics(frame_set, harmonics, orbit=orbit)
    seen = phased_measurement(frame_set, found) if window.is_coded else drop_phase(frame_set.sharp, found)
    return flag_mixed_motion(seen, frame_set, found.solution)


def phased_measurement(frame_set: FrameSet, found: HarmonicFit) -> Measurement:
    """What was found, by its signed vectors a and b."""
    sharp, best, value, cov = frame_set.sharp, found.solution, found.value, found.covariance
    if any(window.light is not None and not window.light.is_phase_known for window in frame_set.windows):
        return drop_phase(sharp, found)
    flags = set(quality_flags(sharp, best, value[2:4], value[4:6]))
    if found.at_rest:
        flags.add(Flag.AT_REST)
    elif found.ambiguous:
        flags.add(Flag.AMBIGUOUS)
    blur = float(np.mean(best.p[2 : FRAME_PARAMETERS * len(frame_set.problems) : FRAME_PARAMETERS]))
    arc = found.arc
    axes = drop_phase(sharp, found) if arc else None
    return Measurement(
        sharp.name,
        value[:2],
        value[2:4],
        value[4:6],
        cov,
        True,
        frozenset(flags),
        blur,
        best.chi2,
        axes,
        found.alternatives,
        arc,
        found.light_scores,
        found.ambient,
    )


def drop_phase(sharp: SharpTarget, found: HarmonicFit) -> Measurement:
    """What was found, by its axes, without its phase."""
    best, in_phase = found.solution, found.in_phase
    if in_phase is None:
        centre = found.value[:2]
        a, b, cov = principal_axes(found.value[2:4], found.value[4:], found.fixed_phase_covariance)
    else:
        centre, a, b, cov = _straight_axes(in_phase, found.minor_axis_variance_px2)
    flags = quality_flags(sharp, best, a, b)
    if found.at_rest:
        flags.add(Flag.AT_REST)
    return Measurement(sharp.name, centre, a, b, cov, False, frozenset(flags), float(best.p[2]), best.chi2)


def _straight_axes(
    in_phase: InPhaseMotion, minor_axis_variance_px2: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Centre, a, b and covariance of a straight motion."""
    a = orient_positive(in_phase.axis[2:])
    side = 1.0 if np.array_equal(a, in_phase.axis[2:]) else -1.0
    turn = np.diag([1.0, 1.0, side, side])
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = turn @ in_phase.axis_covariance @ turn
    covariance[4:, 4:] = minor_axis_variance_px2 * np.outer(perpendicular(a), perpendicular(a))
    return in_phase.axis[:2], a, np.zeros(2), covariance
