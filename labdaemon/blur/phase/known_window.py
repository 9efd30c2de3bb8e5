"""One frame through a known window of non-whole cycles."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.axes import phased_axes, positive
from labdaemon.blur.motion import ExtraBlur, Measurement, Window
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.chances import Standing
from labdaemon.blur.phase.orbits import across
from labdaemon.blur.phase.steady import Steady, fit_steady
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.honesty import reach_flags
from labdaemon.blur.smear.model import Setting
from labdaemon.blur.smear.windowed import Exposures
from labdaemon.flags import Flag


def measure_known_window(
    sharp: SharpTarget, setting: Setting, blur: ExtraBlur, window: Window, *, orbit: bool
) -> Measurement:
    """One frame through a known window: the axes as over whole cycles, but without the bias of the part cycle.

    The phase of a single frame has a mirror image that fits as well, so it is not reported; see `measure_group`.
    """
    found = fit_steady(Exposures.of(sharp, [setting], [window], [blur]), orbit=orbit)
    return unphased(sharp, found)


def unphased(sharp: SharpTarget, found: Steady) -> Measurement:
    """What was found, by its axes, without its phase."""
    best, standing = found.solution, found.standing
    if standing is None:
        centre, a, b, cov = phased_axes(found.value, found.held_covariance)
    else:
        centre, a, b, cov = _straight_axes(standing, found.beside_px2)
    flags = reach_flags(sharp, best, a, b)
    if found.at_rest:
        flags.add(Flag.AT_REST)
    return Measurement(sharp.name, centre, a, b, cov, False, frozenset(flags), float(best.p[2]), best.chi2)


def _straight_axes(standing: Standing, beside_px2: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Centre, a, b and covariance of a straight motion."""
    a = positive(standing.axis[2:])
    side = 1.0 if np.array_equal(a, standing.axis[2:]) else -1.0
    turn = np.diag([1.0, 1.0, side, side])
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = turn @ standing.axis_covariance @ turn
    covariance[4:, 4:] = beside_px2 * np.outer(across(a), across(a))
    return standing.axis[:2], a, np.zeros(2), covariance
