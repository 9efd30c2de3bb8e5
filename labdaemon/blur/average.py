"""The mean of a target's measurements in several frames: one rule for groups, folders and notebooks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.agreement import members_contradict
from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import MEASURE
from labdaemon.flags import Flag


def average_measurements(measured: Sequence[Measurement]) -> Measurement:
    """Weighted mean of one target's measurements without phase, by their complete covariances.

    Whole cycles give the same image whatever phase they begin at, so that frames of one motion differ by noise only.

    Parameters
    ----------
    measured
        One a frame; those without numbers are left out.

    Returns
    -------
    Measurement
        Axes point the same way before they are averaged. The flags are those of the frames used; `at_rest` stays only
        where the target is at rest in all of them. `contradicts_group` where they differ beyond their sd: the
        covariance then contains the scatter of the members.
    """
    usable = [
        one
        for one in measured
        if np.isfinite([*one.centre_px, *one.a_px, *one.b_px]).all() and np.isfinite(one.covariance_px2).all()
    ]
    if not usable:
        return measured[0]
    first = usable[0]
    normal, right, values = np.zeros((6, 6)), np.zeros(6), []
    for one in usable:
        a = one.a_px if one.a_px @ first.a_px >= 0 else -one.a_px
        b = one.b_px if one.b_px @ first.b_px >= 0 else -one.b_px
        # A straight path's covariance is singular.
        weight = np.linalg.inv(one.covariance_px2 + MEASURE.mean_floor_px2 * np.eye(6))
        normal += weight
        values.append(np.concatenate([one.centre_px, a, b]))
        right += weight @ values[-1]
    covariance: FloatArray = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    mean = covariance @ right
    flags = {flag for one in usable for flag in one.flags}
    if not all(Flag.AT_REST in one.flags for one in usable):
        flags.discard(Flag.AT_REST)
    if members_contradict(usable):
        flags.add(Flag.CONTRADICTS_GROUP)
        away = np.array(values) - mean
        covariance = covariance + away.T @ away / (len(values) - 1)
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
