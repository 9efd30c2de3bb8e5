"""How far a result can be trusted: covariance from the residuals as they are, and the flags."""

from __future__ import annotations

import numpy as np
from scipy import fft

from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import saturation_ceiling_dn
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.flags import Flag


def robust_covariance(sharp: SharpTarget, solution: Solution, planes: ColourPlanes) -> FloatArray:
    """(k, k) covariance that holds when residuals are larger than noise, or correlated.

    Where the residuals are as white and as small as the noise model says, it is the inverse normal matrix. Otherwise
    their power spectrum, by bands of spatial frequency, is linear_update through the fit.
    """
    if sharp.noise_known and (
        solution.chi2 < UNCERTAINTY.white_chi2 or (solution.correlated_noise and solution.chi2 < UNCERTAINTY.poor_chi2)
    ):
        return solution.covariance * max(solution.chi2, 1.0)
    root = np.sqrt(solution.weight)
    gain = merge_planes(planes, np.where(root > 0, solution.influence / np.maximum(root, 1e-300), 0.0))
    residual = merge_planes(planes, solution.residual)
    height, width = residual.shape
    power = np.abs(fft.rfft2(residual)) ** 2 / max(solution.dof, 1)
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    band = np.minimum((np.hypot(fx, fy) * 2 * UNCERTAINTY.bands).astype(int), UNCERTAINTY.bands - 1)
    count = np.bincount(band.ravel(), minlength=UNCERTAINTY.bands)
    mean = np.bincount(band.ravel(), power.ravel(), minlength=UNCERTAINTY.bands) / np.maximum(count, 1)
    if sharp.noise_known:
        mean = np.maximum(mean, 1.0)
    double = np.where((fx > 0) & (fx < 0.5), 2.0, 1.0)
    transform = fft.rfft2(gain)
    weighted = transform * (mean[band] * double)
    cov = np.real(np.einsum("ihw,jhw->ij", weighted, np.conj(transform))) / (height * width)
    result: FloatArray = cov + solution.prior_covariance
    return result


def quality_flags(sharp: SharpTarget, best: Solution, a: FloatArray, b: FloatArray) -> set[Flag]:
    """What the residuals, the smear's reach and the sharp frame say."""
    flags = set(sharp.flags & {Flag.POOR_FIT})
    if best.chi2 > UNCERTAINTY.poor_chi2 and sharp.noise_known:
        flags.add(Flag.POOR_FIT)
    reach = float(np.hypot(np.hypot(*a), np.hypot(*b))) + max(sharp.form.half_size_px)
    if reach > sharp.paper_px:
        flags.add(Flag.PAPER_EDGE)
    return flags


def saturation_flags(planes: ColourPlanes, sd_px: float, size_px: float) -> set[Flag]:
    """`saturated` where so much is at white level that what is left does not determine the motion."""
    clipped = float(np.mean(planes.values >= saturation_ceiling_dn(planes)))
    if clipped > UNCERTAINTY.saturated_fraction and sd_px > max(
        UNCERTAINTY.undetermined_sd_px, UNCERTAINTY.undetermined_sd_fraction * size_px
    ):
        return {Flag.SATURATED}
    return set()
