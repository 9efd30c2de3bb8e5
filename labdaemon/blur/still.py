"""What does not move tells what the camera did: its shift and its change of focus."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.honesty import honest_covariance
from labdaemon.blur.model import blurred_model, prepare
from labdaemon.blur.motion import ExtraBlur, Start, StillMeasurement
from labdaemon.blur.pixels import FloatArray, Patch
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import solve
from labdaemon.blur.template import without_template_noise
from labdaemon.blur.weights import nuisance_prior, pixel_weights
from labdaemon.flags import Flag

FREE_BLUR = ExtraBlur(0.0, 30.0)
SAME_PX = 0.05


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
        again = best is not None and float(np.hypot(*(found.p - best.p)[:2])) < SAME_PX
        if best is None or found.cost < best.cost:
            best = found
        if again or best.chi2 < 1.5:  # two ways that end in one place found the right one
            break
    assert best is not None
    best = without_template_noise(sharp, setting, best, None)
    covariance = honest_covariance(sharp, best, setting.planes)[:3, :3]
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
