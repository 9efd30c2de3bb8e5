"""What does not move tells what the camera did: its shift and its change of focus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.model import blurred_model, prepare
from labdaemon.blur.motion import ExtraBlur, Start, StillMeasurement
from labdaemon.blur.pixels import FloatArray, Patch
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import solve
from labdaemon.blur.weights import nuisance_prior, pixel_weights, variance_scale
from labdaemon.errors import DataError
from labdaemon.flags import Flag

FREE_BLUR = ExtraBlur(0.0, 30.0)


def measure_still(sharp: SharpTarget, patch: Patch, *, start: Start | None = None) -> StillMeasurement:
    """Shift and isotropic extra blur of a target that does not move.

    Parameters
    ----------
    sharp
        From `fit_sharp` or `sharp_texture`.
    patch
        Part of the later frame that holds the target.
    start
        Where to look; None for its place in the sharp frame. Good to about 3 px.

    Returns
    -------
    StillMeasurement
        NaN, with a flag, where it cannot be seen.
    """
    nan = np.full(2, np.nan)
    lost = StillMeasurement(
        sharp.name,
        sharp.centre_px,
        nan,
        float("nan"),
        np.full((3, 3), np.nan),
        frozenset({Flag.NOT_FOUND}),
        float("nan"),
    )
    expected = np.asarray(start.centre_px if start is not None else sharp.centre_px, dtype=np.float64)
    if not sharp.usable:
        return lost
    setting = prepare(sharp, patch, expected)
    if setting is None:
        return lost
    k = len(setting.by_shape)
    first = np.concatenate((setting.start_px, [0.0], np.zeros(k)))

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[2] = np.clip(p[2], -2.0, 60.0)
        return p

    best = None
    tries = [(0.0, 0.0)] if setting.blob is not None else [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2)]
    for dx, dy in tries:
        begin = first.copy()
        begin[:2] += (dx, dy)
        found = solve(
            setting.planes,
            pixel_weights(sharp, setting.planes),
            blurred_model(setting, None),
            begin,
            nuisance_prior(sharp, FREE_BLUR, 0),
            bound=bound,
        )
        if best is None or found.cost < best.cost:
            best = found
        if best.chi2 < 1.5:
            break
    assert best is not None
    covariance = best.covariance[:3, :3] * variance_scale(sharp, best)
    covariance[:2, :2] += sharp.covariance_px2
    flags = {Flag.POOR_FIT} if best.chi2 > 2.0 and sharp.noise_known else set()
    return StillMeasurement(
        sharp.name,
        sharp.centre_px,
        best.p[:2] - sharp.centre_px,
        float(best.p[2]),
        covariance,
        frozenset(flags),
        best.chi2,
    )


def frame_blur(stills: Sequence[StillMeasurement]) -> ExtraBlur:
    """A frame's extra blur against the sharp frame: a robust weighted mean over its control targets.

    Parameters
    ----------
    stills
        One for each control target; those without numbers are left out.

    Returns
    -------
    ExtraBlur
        Its standard deviation is the larger of the formal one and the scatter's.

    Raises
    ------
    DataError
        None of them could be measured.
    """
    seen = [s for s in stills if np.isfinite(s.extra_blur_px2) and s.covariance_px2[2, 2] > 0]
    if not seen:
        raise DataError("no control target could be measured in this frame; check that they are in view and lit")
    value = np.array([s.extra_blur_px2 for s in seen])
    variance = np.array([s.covariance_px2[2, 2] for s in seen]) + 1e-6
    return robust_blur(value, variance)


def robust_blur(value: FloatArray, variance: FloatArray) -> ExtraBlur:
    """Weighted mean of extra variances with outliers (beyond 3 robust standard deviations) pulled in (Huber)."""
    mean = float(np.median(value))
    for _ in range(10):
        pull = np.abs(value - mean) / np.sqrt(variance)
        spread = max(1.0, 1.48 * float(np.median(pull)))
        weight = np.minimum(1.0, 2.0 * spread / np.maximum(pull, 1e-12)) / variance
        mean = float(np.sum(weight * value) / np.sum(weight))
    formal = 1 / float(np.sum(1 / variance))
    scatter = float(np.sum(weight**2 * (value - mean) ** 2) / np.sum(weight) ** 2)
    if len(value) > 1:
        scatter *= len(value) / (len(value) - 1)
    return ExtraBlur(mean, float(np.sqrt(max(formal, scatter))))
