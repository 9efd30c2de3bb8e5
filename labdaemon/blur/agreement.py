"""Whether the members of a group show one motion: a χ² test of their differences.

Members of a group repeat one steady motion. Whole cycles show it without its phase, as the second moment aaᵀ + bbᵀ,
which is all that the image of a whole cycle depends on. It does not matter how the axes were named or signed,
and near rest it has an sd where a has none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import MEASURE
from labdaemon.orbit_axes import second_moment, second_moment_covariance


def members_contradict(measured: Sequence[Measurement]) -> bool:
    """Whether measurements of one motion differ beyond their standard deviations.

    Parameters
    ----------
    measured
        One a member, with numbers. Mean positions are not compared: a camera may drift between captures.
    """
    if len(measured) < 2:
        return False
    moments = [second_moment(one.a_px, one.b_px) for one in measured]
    weights = [np.linalg.inv(moment_covariance(one)) for one in measured]
    mean = np.linalg.solve(sum(weights), sum(w @ m for w, m in zip(weights, moments, strict=True)))
    squared = sum(float((m - mean) @ w @ (m - mean)) for w, m in zip(weights, moments, strict=True))
    return is_contradiction(squared, 3 * (len(measured) - 1))


def is_contradiction(squared: float, dof: int) -> bool:
    """Whether a χ² of `dof` degrees of freedom is too large for members of one motion."""
    return bool(squared > chi2.isf(MEASURE.contradiction_probability, dof))


def moment_covariance(one: Measurement) -> FloatArray:
    """(3, 3) covariance of aaᵀ + bbᵀ, as m0, m1, m2, px⁴."""
    covariance = one.covariance_px2[2:, 2:] + MEASURE.member_floor_px**2 * np.eye(4)
    return second_moment_covariance(one.a_px, one.b_px, covariance)
