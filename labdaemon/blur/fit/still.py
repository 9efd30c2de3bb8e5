"""What does not move tells what the camera did: its shift and its change of focus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.blur.motion import ExtraBlur, Start, StillMeasurement
from labdaemon.blur.patch.light import solve_light
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import nuisance_prior, pixel_weights
from labdaemon.blur.smear.honesty import honest_covariance
from labdaemon.blur.smear.model import Setting, blurred_model, prepare
from labdaemon.blur.smear.template import without_template_noise
from labdaemon.blur.solver.normal import Solution
from labdaemon.blur.solver.solve import Model, solve
from labdaemon.flags import Flag

FREE_BLUR = ExtraBlur(0.0, 30.0)
SAME_PX = 0.05
NEAR_PX = 0.1  # a fit that moved further began with weights that are not its end's
POOR_CHI2 = 2.0  # a picture's own interpolation already makes some 1.5


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
    k = setting.shapes
    first = np.concatenate((setting.start_px, [0.0], np.zeros(k)))

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[2] = np.clip(p[2], -2.0, 60.0)
        return p

    model, weights, prior = (
        blurred_model(setting, None),
        pixel_weights(sharp, setting.planes),
        nuisance_prior(sharp, FREE_BLUR, 0),
    )

    def fit(begin: FloatArray, light: FloatArray | None = None) -> Solution:
        return solve(setting.planes, weights, model, begin, prior, bound=bound, light=light)

    best = _unmoved(sharp, setting, first, weights, model, fit)
    tries = [(0.0, 0.0)] if setting.blob is not None else [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2)]
    for dx, dy in tries:
        if best is not None and best.chi2 < POOR_CHI2:
            break
        begin = first.copy()
        begin[:2] += (dx, dy)
        found = fit(begin)
        again = best is not None and float(np.hypot(*(found.p - best.p)[:2])) < SAME_PX
        if best is None or found.cost < best.cost:
            best = found
        if again:  # two ways that end in one place found the right one
            break
    assert best is not None
    best = without_template_noise(sharp, setting, best, None)
    covariance = honest_covariance(sharp, best, setting.planes)[:3, :3]
    covariance[:2, :2] += sharp.covariance_px2
    flags = {Flag.POOR_FIT} if best.chi2 > POOR_CHI2 and sharp.noise_known else set()
    return StillMeasurement(
        sharp.name,
        sharp.centre_px,
        best.p[:2] - sharp.centre_px,
        float(best.p[2]),
        covariance,
        frozenset(flags),
        best.chi2,
    )


def _unmoved(
    sharp: SharpTarget,
    setting: Setting,
    first: FloatArray,
    weights: Callable[[FloatArray], FloatArray],
    model: Model,
    fit: Callable[[FloatArray, FloatArray], Solution],
) -> Solution | None:
    """The fit of a frame that did not shift, as most do not: what it begins with is nearly its end. None if it did."""
    if np.abs(setting.start_px - sharp.centre_px).max() > NEAR_PX:
        return None
    dark, _ = model(first)
    found = fit(first, solve_light(setting.planes, weights(np.maximum(setting.planes.values, 0)), dark))
    return found if np.abs(found.p[:2] - first[:2]).max() < NEAR_PX else None
