"""How much each pixel counts, and what is known before the fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.blur.motion import Defocus
from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.pixels import FloatArray, NoiseModel
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.solver.reduced_equations import Prior, Solution


def nuisance_prior(sharp: SharpTarget, blur: Defocus, motion_count: int) -> Prior:
    """Prior on (x, y, extra variance, shape…, motion…): defocus from the controls, shape from the sharp frame."""
    k = len(sharp.form.prior_covariance)
    precision = np.zeros((3 + k + motion_count, 3 + k + motion_count))
    precision[2, 2] = 1 / max(blur.sd_px2, 1e-4) ** 2
    precision[3 : 3 + k, 3 : 3 + k] = shape_precision(sharp)
    mean = np.zeros(len(precision))
    mean[2] = blur.mean_px2
    return Prior(mean, precision)


def shape_precision(sharp: SharpTarget) -> FloatArray:
    """(k, k) inverse covariance of the target's shape parameters before the frame is seen."""
    covariance = sharp.form.prior_covariance
    k = len(covariance)
    if k == 0:
        return np.zeros((0, 0))
    result: FloatArray = np.linalg.inv(covariance + 1e-10 * np.eye(k)).astype(np.float64)
    return result


def pixel_weights(sharp: SharpTarget, planes: ColourPlanes, scale: float = 1.0) -> Callable[[FloatArray], FloatArray]:
    """Inverse variances by the target's noise model, `scale` times its variance."""
    return noise_weights(sharp.noise, planes, scale)


def noise_weights(noise: NoiseModel, planes: ColourPlanes, scale: float = 1.0) -> Callable[[FloatArray], FloatArray]:
    """From modelled values to inverse variances; 0 for pixels that are masked or may be saturated."""
    ceiling = saturation_ceiling_dn(planes)

    def weights(signal: FloatArray) -> FloatArray:
        variance = np.maximum((noise.variance(signal) + (noise.texture * signal) ** 2) * scale, 1e-12)
        # Of pixels that noise lifts over the ceiling only the darker ones would be left: leave out all that might be.
        below = signal < ceiling - 3 * np.sqrt(variance)
        return np.where(planes.valid & below, 1 / variance, 0.0)

    return weights


def saturation_ceiling_dn(planes: ColourPlanes) -> float:
    """The value from which pixels of these planes are declared saturated; inf where none is."""
    if planes.valid.all() or not planes.valid.any():
        return float("inf")
    hidden = planes.values[~planes.valid]
    bright = hidden[hidden >= 0.98 * float(np.max(planes.values[planes.valid]))]
    return float(np.min(bright)) if bright.size > 0.02 * planes.values.size else float("inf")


def noise_scale(sharp: SharpTarget, solution: Solution) -> float:
    """Factor from the assumed to the found noise variance, where the noise was not given; else 1."""
    return 1.0 if sharp.noise_known else max(solution.chi2, 1e-9)
