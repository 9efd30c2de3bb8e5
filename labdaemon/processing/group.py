"""Captures of one group: whether their windows hold phase, and the mean of what they show if not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur import ExposureWindow, Measurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.flags import Flag

PART = 0.05
"""Cycles from whole below which an exposure holds no phase that could be measured."""
FLOOR_PX2 = 1e-6
"""Keeps a covariance that is singular (a straight path's) invertible."""


def is_part(window: ExposureWindow) -> bool:
    """Whether an exposure under constant light is no whole number of cycles."""
    return window.light is None and window.fraction > PART


def holds_phase(window: ExposureWindow) -> bool:
    """Whether an exposure shows which way a point moved: coded light, or part cycles from a known phase."""
    return window.is_coded or (window.phase_rad is not None and is_part(window))


def mean_of(measured: Sequence[Measurement]) -> Measurement:
    """Weighted mean of one target's unphased measurements in several frames.

    Parameters
    ----------
    measured
        One a frame; those without numbers are passed over.

    Returns
    -------
    Measurement
        Axes are turned to point the same way before they are averaged; flags are those of the frames used, `at_rest`
        only where it is at rest in all.
    """
    usable = [
        one
        for one in measured
        if np.isfinite([*one.centre_px, *one.a_px, *one.b_px]).all() and np.isfinite(one.covariance_px2).all()
    ]
    if not usable:
        return measured[0]
    first = usable[0]
    normal, right = np.zeros((6, 6)), np.zeros(6)
    for one in usable:
        a = one.a_px if one.a_px @ first.a_px >= 0 else -one.a_px
        b = one.b_px if one.b_px @ first.b_px >= 0 else -one.b_px
        weight = np.linalg.inv(one.covariance_px2 + FLOOR_PX2 * np.eye(6))
        normal += weight
        right += weight @ np.concatenate([one.centre_px, a, b])
    covariance: FloatArray = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    mean = covariance @ right
    flags = {flag for one in usable for flag in one.flags}
    if not all(Flag.AT_REST in one.flags for one in usable):
        flags.discard(Flag.AT_REST)
    return Measurement(
        first.target,
        mean[:2],
        mean[2:4],
        mean[4:],
        covariance,
        flags=frozenset(flags),
        defocus_px2=float(np.mean([one.defocus_px2 for one in usable])),
        chi2=float(np.mean([one.chi2 for one in usable])),
    )
