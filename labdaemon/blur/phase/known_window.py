"""One frame through a known window of non-whole cycles."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.axes import axes_from_vectors, orient_positive
from labdaemon.blur.motion import Defocus, ExposureWindow, Measurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.harmonic_fit import HarmonicFit, fit_harmonic
from labdaemon.blur.phase.orbits import perpendicular
from labdaemon.blur.phase.posterior import InPhaseMotion
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.forward_model import FitProblem
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.blur.smear.uncertainty import quality_flags
from labdaemon.flags import Flag


def measure_known_window(
    sharp: SharpTarget, problem: FitProblem, blur: Defocus, window: ExposureWindow, *, orbit: bool
) -> Measurement:
    """One frame through a known window: the axes as over whole cycles, but without the bias of the part cycle.

    The phase of a single frame has a mirror image that fits as well, so it is not reported; see `measure_group`.
    """
    found = fit_harmonic(FrameSet.from_problems(sharp, [problem], [window], [blur]), orbit=orbit)
    return drop_phase(sharp, found)


def drop_phase(sharp: SharpTarget, found: HarmonicFit) -> Measurement:
    """What was found, by its axes, without its phase."""
    best, in_phase = found.solution, found.in_phase
    if in_phase is None:
        centre, a, b, cov = axes_from_vectors(found.value, found.fixed_phase_covariance)
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
