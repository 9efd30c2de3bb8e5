"""Uncertainty of a measurement: every correction of the covariance, in the order of application, with its reason.

The covariance starts as the inverse normal matrix of the fit. With the weights 1/variance of the noise model it is the
Cramér–Rao bound, and no unbiased estimate has a smaller one. The normal matrix already contains the priors of the
nuisance parameters: the defocus of the frame by its control targets, and the target's shape by the sharp frame and by
the change of scale with depth (`SharpTarget.with_scale_uncertainty`). Then, in this order:

1. *Paper texture* is noise that neighbouring pixels share, and it moves with the target. `gls.gls_refine` puts it into
   the weights and takes the covariance of that fit. Reason: weights for independent noise understate
   the sd of a long path.
2. *Residuals* larger than the noise model, or correlated, mean that the model or the noise model is incomplete.
   `robust_covariance` propagates them (White 1980, doi:10.2307/1912934).
3. *Timing and waveform*: a window is known within the sd of its opening and of its length, harmonics of the motion
   within that of the gauge's fit. `timing_covariance` adds their effect. Reason: they are errors of the model, which no
   residual shows.
4. *Phase*: where the image hardly shows the phase, the covariance is that of all phases (`phase.posterior`,
   `phase.orbit_phase`). Reason: a linear covariance does not describe an arc.
5. *The minor axis* of a path that was fitted as a straight one is unknown within the sd of its square.
   `straight_path_covariance` reports it. Reason: a fit without a parameter does not show that parameter's error.
6. *Rest*: near rest the image depends on a² alone. `covariance_at_rest` turns the sd of a² into that of a, in every
   direction. Reason: the derivative of the image by a vanishes at a = 0, so that step 2 would give any sd.
7. *An occluder's edge*: the result with two margins differs, and the difference counts as an error
   (`fit.occlusion`). Reason: an occluder's soft edge has no model.

8. *Noise of a textured patch's sharp frame* is in the image's derivatives as well as in the residuals. For whole cycles
   `smear.errors_in_variables` replaces steps 1 and 2: the noise's share is subtracted from the information, and the
   products of both noises are added to the variance of the score; through windows and under coded light
   `smear.texture_frames` does the same. Along a direction without texture the sd is half the
   box (flag `undetermined`).

9. *The extra blur's anisotropy*: without control targets nothing shows whether a frame lost more sharpness along the
   motion than across it. 0.05 px² more across reads as 0.02 px less of 1.5 px. `anisotropy_covariance` adds it for
   whole cycles.

A group of whole-cycle frames is a weighted mean with the covariance of its members (`group`). Orientation and survey
enter later, in ``geometry``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from labdaemon.blur.harmonics import MIN_HARMONIC_SD
from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes
from labdaemon.blur.patch.illumination import paper_level
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.sharp.weights import saturation_ceiling_dn
from labdaemon.blur.smear.frame_set import FrameSet, TransferFactory
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.flags import Flag
from labdaemon.orbit_axes import orient_positive


def windowed_covariance(solution: Solution, frame_set: FrameSet, transfer_factory: TransferFactory) -> FloatArray:
    """(k, k) covariance of a fit through known windows: corrections 2 and 3."""
    robust = robust_covariance(frame_set.sharp, solution, frame_set.planes)
    return robust + timing_covariance(solution, frame_set, transfer_factory)


def robust_covariance(sharp: SharpTarget, solution: Solution, planes: ColourPlanes) -> FloatArray:
    """(k, k) covariance that holds for residuals larger than the noise, and for correlated ones (correction 2).

    Residuals as white and as small as the noise model give the inverse normal matrix. Otherwise the power spectrum of
    the residuals, averaged in bands of spatial frequency, is propagated through the fit's influence function: the
    sandwich covariance of White (1980), for noise that is stationary instead of independent.
    """
    if solution.template_noise:
        return solution.covariance
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


def timing_covariance(best: Solution, frame_set: FrameSet, transfer_factory: TransferFactory) -> FloatArray:
    """(k, k) covariance by the sd of each window's opening, length and harmonics (correction 3), by differences."""
    size = len(best.p)
    total = np.zeros((size, size))
    windows = frame_set.windows
    if not any(_variations(window) for window in windows):
        return total
    reach = frame_set.max_amplitude_px(best.p)
    base, _ = frame_set.forward_model(transfer_factory, reach)(best.p)
    level = paper_level(frame_set.planes, best.light) * best.light[:, 3, None, None]
    for index, window in enumerate(windows):
        for other in _variations(window):
            changed = replace(frame_set, windows=[*windows[:index], other, *windows[index + 1 :]])
            moved, _ = changed.forward_model(transfer_factory, reach)(best.p)
            shift = np.einsum("knhw,nhw->k", best.influence, -level * (moved - base))
            total += np.outer(shift, shift)
    return total


def _variations(window: ExposureWindow) -> list[ExposureWindow]:
    """The window with each uncertain quantity changed by its standard deviation, one at a time."""
    varied = []
    if window.sd_phase_rad > 0:
        varied.append(replace(window, phase_rad=(window.phase_rad or 0.0) + window.sd_phase_rad))
    if window.sd_exposure_s > 0:
        varied.append(replace(window, exposure_s=window.exposure_s + window.sd_exposure_s))
    light = window.light
    if light is not None and light.sd_phase_rad > 0:
        varied.append(replace(window, light=replace(light, phase_rad=light.phase_rad + light.sd_phase_rad)))
    harmonics = window.harmonics
    for place, (cosine, sine) in enumerate(harmonics.sds if harmonics is not None else ()):
        if harmonics is not None and max(cosine, sine) > MIN_HARMONIC_SD:
            steps = ((cosine, 0.0), (0.0, sine))
            varied += [replace(window, harmonics=harmonics.shifted(place, *step)) for step in steps]
    return varied


def straight_path_covariance(
    p: FloatArray, covariance: FloatArray, k: int, sd_minor_px2: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vectors a and b of a straight path, and the (6, 6) covariance of x, y, a, b (correction 5).

    Parameters
    ----------
    p, covariance
        (5 + k,) x, y, defocus, k shape parameters, ax, ay, and their covariance.
    sd_minor_px2
        Standard deviation of the squared minor axis in the orbit's fit.
    """
    pick = [0, 1, 3 + k, 4 + k]
    result = np.zeros((6, 6))
    result[:4, :4] = covariance[np.ix_(pick, pick)]
    a = p[3 + k :]
    if not np.array_equal(orient_positive(a), a):
        result[:2, 2:4] *= -1
        result[2:4, :2] *= -1
        a = -a
    across = np.array([-a[1], a[0]]) / max(float(np.hypot(*a)), 1e-12)
    result[4:, 4:] = sd_minor_px2 * np.outer(across, across)
    return a, np.zeros(2), result


def anisotropy_covariance(a: FloatArray, sd_square_px2: float) -> FloatArray:
    """(2, 2) what the anisotropy of an extra blur adds to the covariance of a (correction 9), px².

    Parameters
    ----------
    a
        (2,) major semi-axis, px.
    sd_square_px2
        What it adds to the sd of the squared amplitude, `Defocus.sd_anisotropy_px2`.
    """
    size = max(float(np.hypot(*a)), 1e-12)
    sd = np.sqrt(size**2 + sd_square_px2) - size
    result: FloatArray = sd**2 * np.outer(a, a) / size**2
    return result


def covariance_at_rest(covariance: FloatArray, amplitude_px: float, sd_square_px2: float) -> FloatArray:
    """(6, 6) covariance with the block of a replaced by that of its square, in every direction (correction 6)."""
    result = covariance.copy()
    sd = np.sqrt(amplitude_px**2 + sd_square_px2) - amplitude_px
    result[2:4, :] = result[:, 2:4] = 0.0
    result[2:4, 2:4] = sd**2 * np.eye(2)
    return result


def quality_flags(sharp: SharpTarget, best: Solution, a: FloatArray, b: FloatArray) -> set[Flag]:
    """Flags by the residuals, by the extent of the blurred target on its paper, and by the sharp frame."""
    spoilt = {Flag.POOR_FIT, Flag.SATURATED} if isinstance(sharp.form, TexturedPatch) else {Flag.POOR_FIT}
    flags = set(sharp.flags & spoilt)
    if best.chi2 > UNCERTAINTY.poor_chi2 and sharp.noise_known:
        flags.add(Flag.POOR_FIT)
    reach = float(np.hypot(np.hypot(*a), np.hypot(*b))) + max(sharp.form.half_size_px)
    if reach > sharp.paper_px:
        flags.add(Flag.PAPER_EDGE)
    return flags


def saturation_flags(planes: ColourPlanes, sd_px: float, size_px: float) -> set[Flag]:
    """Flag `saturated` where the pixels below white level do not determine the motion."""
    clipped = float(np.mean(planes.values >= saturation_ceiling_dn(planes)))
    if clipped > UNCERTAINTY.saturated_fraction and sd_px > max(
        UNCERTAINTY.undetermined_sd_px, UNCERTAINTY.undetermined_sd_fraction * size_px
    ):
        return {Flag.SATURATED}
    return set()
