"""One frame through a known window of non-whole cycles."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.axes import phased_axes
from labdaemon.blur.honesty import REST_SIGMAS, honest_covariance, reach_flags
from labdaemon.blur.model import Setting
from labdaemon.blur.motion import ExtraBlur, Measurement, Window
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.windowed import solve_windowed, timing_covariance
from labdaemon.flags import Flag


def measure_known_window(
    sharp: SharpTarget, setting: Setting, blur: ExtraBlur, window: Window, *, orbit: bool
) -> Measurement:
    """One frame through a known window: the axes as over whole cycles, but without the bias of the part cycle.

    The phase of a single frame has a mirror image that fits as well, so it is not reported; see `measure_group`.
    """
    moment = setting.blob.moment_px2 if setting.blob is not None else np.eye(2)
    spread = 2 * (moment - sharp.form.moment_px2 - blur.mean_px2 * np.eye(2))
    best, _ = solve_windowed(sharp, [setting], [window], [blur], spread)
    covariance = honest_covariance(sharp, best, setting.planes) + timing_covariance(best, [setting], [window])
    pick = [0, 1, *range(len(best.p) - 4, len(best.p))]
    value, cov = best.p[pick], covariance[np.ix_(pick, pick)]
    centre, a, b, cov = phased_axes(value, cov)
    flags = reach_flags(sharp, best, a, b)
    size = float(np.hypot(*a))
    sd_a = float(np.sqrt(a @ cov[2:4, 2:4] @ a)) / max(size, 1e-12)
    if size < REST_SIGMAS * sd_a:
        flags.add(Flag.AT_REST)
    sd_b = float(np.sqrt(max(np.trace(cov[4:, 4:]), 0)))
    if not orbit or float(np.hypot(*b)) < REST_SIGMAS * sd_b:
        b = np.zeros(2)
    return Measurement(sharp.name, centre, a, b, cov, False, frozenset(flags), float(best.p[2]), best.chi2)
