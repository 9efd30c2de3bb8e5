"""The extra blur of a frame: assumed, from control targets, or from the moving targets themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.motion import ExtraBlur, Measurement, StillMeasurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.texture import Texture
from labdaemon.errors import DataError
from labdaemon.flags import Flag

FREE_SD_PX2 = 0.3
TEXTURE_SD_PX2 = 1e-3
SHARED_SD_PX2 = 0.002  # what all control targets of a frame have wrong in common (interpolation between its pixels)


def default_blur(sharp: SharpTarget) -> ExtraBlur:
    """What is assumed of defocus when nothing tells."""
    return ExtraBlur(0.0, TEXTURE_SD_PX2 if isinstance(sharp.form, Texture) else FREE_SD_PX2)


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
    mean, sd, _ = _robust_mean(value, np.array([s.covariance_px2[2, 2] for s in seen]) + 1e-6)
    return ExtraBlur(mean, float(np.hypot(sd, SHARED_SD_PX2)))


def blur_of_targets(measurements: Sequence[Measurement]) -> ExtraBlur | None:
    """A frame's extra blur from targets that were each fitted with their own; None if there are fewer than three.

    It is known no better than it scatters from target to target, and as far as it goes it may be one-sided.
    """
    lost = {Flag.NOT_FOUND, Flag.SATURATED, Flag.OCCLUDED}
    seen = [m.extra_blur_px2 for m in measurements if not (m.flags & lost) and np.isfinite(m.extra_blur_px2)]
    if len(seen) < 3:
        return None
    value = np.array(seen)
    mean, _, scatter = _robust_mean(value, np.full(len(value), max(float(np.var(value)), 1e-6)))
    scatter = max(scatter, 0.005)
    return ExtraBlur(mean, scatter, 2 * float(np.hypot(mean, scatter)))


def _robust_mean(value: FloatArray, variance: FloatArray) -> tuple[float, float, float]:
    """Weighted mean with far values pulled in (Huber), its standard deviation, and the scatter (1.48 MAD)."""
    mean = float(np.median(value))
    weight = 1 / variance
    for _ in range(10):
        pull = np.abs(value - mean) / np.sqrt(variance)
        spread = max(1.0, 1.48 * float(np.median(pull)))
        weight = np.minimum(1.0, 2.0 * spread / np.maximum(pull, 1e-12)) / variance
        mean = float(np.sum(weight * value) / np.sum(weight))
    formal = 1 / float(np.sum(1 / variance))
    scatter = float(np.sum(weight**2 * (value - mean) ** 2) / np.sum(weight) ** 2)
    if len(value) > 1:
        scatter *= len(value) / (len(value) - 1)
    mad = 1.48 * float(np.median(np.abs(value - np.median(value))))
    return mean, float(np.sqrt(max(formal, scatter))), mad
