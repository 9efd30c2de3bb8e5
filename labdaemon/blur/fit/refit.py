"""Failed fits: their reason as flags, and a second fit without the largest region of outliers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.colour_planes import merge_planes, split_planes
from labdaemon.blur.patch.illumination import render_illumination, solve_illumination
from labdaemon.blur.patch.locate import find_blob
from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch
from labdaemon.blur.settings import REFIT
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.sharp.weights import pixel_weights
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.spectra import closed_form
from labdaemon.flags import Flag
from labdaemon.orbit_axes import second_moment


def failure_flags(sharp: SharpTarget, patch: Patch, expected_px: FloatArray) -> set[Flag]:
    """Flags for a target that was not measured."""
    if patch.values.size == 0:
        return {Flag.NOT_FOUND}
    bright = np.count_nonzero(~patch.valid & np.isfinite(patch.values) & (patch.values > 0))
    if bright > 0.7 * patch.values.size:
        return {Flag.SATURATED, Flag.NOT_FOUND}
    half_w, half_h = sharp.form.half_size_px
    area = np.pi * half_w * half_h
    blob = find_blob(patch, expected_px, area, sharp.contrast) if min(patch.shape) >= 5 else None
    if blob is not None and blob.area_px2 > 2 * area:
        return {Flag.PAPER_EDGE if blob.clipped else Flag.OCCLUDED, Flag.NOT_FOUND}
    return {Flag.NOT_FOUND}


def refit_without_occluder(
    sharp: SharpTarget, problem: FitProblem, found: Measurement, fit: Callable[[FitProblem], Measurement]
) -> Measurement:
    """Fit again without the largest connected region of outliers.

    An occluder spoils one region completely. A motion other than the assumed one spoils the whole outline of the smear
    a little. If the rest fits, the measurement of the rest is returned with the flag `occluded`; else the first one.
    """
    for _ in range(2):
        hidden = _largest_outlier_region(sharp, problem, found)
        if hidden is None:
            return found
        planes = problem.planes
        problem = replace(problem, planes=replace(planes, valid=planes.valid & ~split_planes(planes, hidden)))
        again = fit(problem)
        if Flag.POOR_FIT not in again.flags:
            return replace(again, flags=again.flags | {Flag.OCCLUDED})
        found = again
    return found


def _largest_outlier_region(sharp: SharpTarget, problem: FitProblem, found: Measurement) -> BoolArray | None:
    """(H, W) largest connected region of outliers; None without outliers, and where the region is too large."""
    planes = problem.planes
    if not np.all(np.isfinite([*found.centre_px, found.defocus_px2])):
        return None
    dark, weight, light = _modelled_image(sharp, problem, found)
    residual = merge_planes(planes, (planes.values - render_illumination(planes, light, dark)) * np.sqrt(weight))
    smooth = ndimage.uniform_filter(residual, 3) * 3.0
    outliers = np.abs(smooth) > max(REFIT.outlier_limit, 2.5 * 1.48 * float(np.median(np.abs(smooth))))
    labels, count = ndimage.label(ndimage.binary_closing(outliers, iterations=2))
    if count == 0:
        return None
    power = ndimage.sum_labels(residual**2, labels, np.arange(1, count + 1))
    region = labels == 1 + int(np.argmax(power))
    if _is_point_symmetric(region, residual, found.centre_px - np.asarray(planes.origin_px)):
        return None
    region = ndimage.binary_dilation(region, iterations=3)
    return None if region.mean() > REFIT.max_hidden_fraction else region


def contrast_ratio(sharp: SharpTarget, problem: FitProblem, found: Measurement) -> float:
    """Fitted contrast over the sharp image's: about 1 where the textured patch is in the frame."""
    form = sharp.form
    own = form.contrast if isinstance(form, TexturedPatch) else 1.0
    return float(np.median(_modelled_image(sharp, problem, found)[2][:, 3])) / max(own, 1e-9)


def _modelled_image(
    sharp: SharpTarget, problem: FitProblem, found: Measurement
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Modelled darkness under the motion that was found, weights, and the illumination fitted to the whole patch."""
    planes = problem.planes
    parameters = np.concatenate((found.centre_px, [found.defocus_px2], np.zeros(problem.shape_count)))
    dark, _ = fast_forward_model(problem, fixed_transfer(found))(parameters)
    weight = pixel_weights(sharp, planes)(np.maximum(planes.values, 0))
    return dark, weight, solve_illumination(planes, weight, dark)


def _is_point_symmetric(region: BoolArray, residual: FloatArray, centre: FloatArray) -> bool:
    """Whether the residuals are symmetric about the centre: a wrong motion errs symmetrically, an occluder does not."""
    ys, xs = np.nonzero(region)
    x, y = np.rint(2 * centre[0] - xs).astype(int), np.rint(2 * centre[1] - ys).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < residual.shape[1]) & (y < residual.shape[0])
    if np.count_nonzero(inside) < 0.5 * len(xs):
        return False
    here, there = residual[ys[inside], xs[inside]], residual[y[inside], x[inside]]
    return bool(float(here @ there) > 0.3 * float(here @ here))


def fixed_transfer(found: Measurement) -> Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Transfer function of the motion that was found, without parameters."""
    a, b = np.nan_to_num(found.a_px), np.nan_to_num(found.b_px)
    moment = second_moment(a, b)

    def motion(fx: FloatArray, fy: FloatArray, _: FloatArray) -> tuple[FloatArray, FloatArray]:
        return closed_form.orbit_transfer(fx, fy, moment)[0], np.zeros((0, *fx.shape))

    return motion
