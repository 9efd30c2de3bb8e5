"""One frame through a known window of non-whole cycles."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.axes import phased_axes
from labdaemon.blur.honesty import reach_flags
from labdaemon.blur.model import Setting
from labdaemon.blur.motion import ExtraBlur, Measurement, Window
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.steady import Steady, fit_steady
from labdaemon.blur.windowed import Exposures
from labdaemon.flags import Flag


def measure_known_window(
    sharp: SharpTarget, setting: Setting, blur: ExtraBlur, window: Window, *, orbit: bool
) -> Measurement:
    """One frame through a known window: the axes as over whole cycles, but without the bias of the part cycle.

    The phase of a single frame has a mirror image that fits as well, so it is not reported; see `measure_group`.
    """
    return measurement_of(sharp, blur, fit_steady(Exposures.of(sharp, [setting], [window], [blur]), orbit=orbit))


def measurement_of(sharp: SharpTarget, blur: ExtraBlur, found: Steady) -> Measurement:
    """Axes of what was found through one window."""
    centre, a, b, cov = phased_axes(found.value, found.covariance)
    best = found.solution
    if not found.is_orbit:
        b = np.zeros(2)
    flags = reach_flags(sharp, best, a, b)
    if found.at_rest:
        flags.add(Flag.AT_REST)
    return Measurement(sharp.name, centre, a, b, cov, False, frozenset(flags), float(best.p[2]), best.chi2)
