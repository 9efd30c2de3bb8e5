"""What stands in the way: something in front of a target, the paper's edge, a white that clips."""

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
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import pixel_weights
from labdaemon.blur.smear.forward_model import FitProblem, forward_model
from labdaemon.blur.spectra import closed_form
from labdaemon.flags import Flag

OUTLIER_LIMIT = 4.0
MAX_HIDDEN_FRACTION = 0.45  # part of the patch that may be covered and the rest still believed


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
    """Fit again without a compact part of the patch that does not look like the rest.

    Something in front of a target spoils one place wholly; a motion that is not what was assumed spoils the smear's
    whole outline a little. If the rest fits by itself the measurement is the rest's, flagged `occluded`; else it stays.
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
    """The one connected place where residuals are far from noise; None if there is none, or too much of it."""
    planes = problem.planes
    if not np.all(np.isfinite([*found.centre_px, found.defocus_px2])):
        return None
    dark, weight, light = _modelled_image(sharp, problem, found)
    residual = merge_planes(planes, (planes.values - render_illumination(planes, light, dark)) * np.sqrt(weight))
    smooth = ndimage.uniform_filter(residual, 3) * 3.0
    outliers = np.abs(smooth) > max(OUTLIER_LIMIT, 2.5 * 1.48 * float(np.median(np.abs(smooth))))
    labels, count = ndimage.label(ndimage.binary_closing(outliers, iterations=2))
    if count == 0:
        return None
    power = ndimage.sum_labels(residual**2, labels, np.arange(1, count + 1))
    region = labels == 1 + int(np.argmax(power))
    if _is_point_symmetric(region, residual, found.centre_px - np.asarray(planes.origin_px)):
        return None
    region = ndimage.binary_dilation(region, iterations=3)
    return None if region.mean() > MAX_HIDDEN_FRACTION else region


def contrast_ratio(sharp: SharpTarget, problem: FitProblem, found: Measurement) -> float:
    """Contrast of what moved as was found, in parts of the sharp picture's: about 1 for a texture that is there."""
    return float(np.median(_modelled_image(sharp, problem, found)[2][:, 3]))


def _modelled_image(
    sharp: SharpTarget, problem: FitProblem, found: Measurement
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Darkness by the motion that was found, weights, and the light fitted to it over everything."""
    planes = problem.planes
    parameters = np.concatenate((found.centre_px, [found.defocus_px2], np.zeros(problem.shape_count)))
    dark, _ = forward_model(problem, fixed_transfer(found))(parameters)
    weight = pixel_weights(sharp, planes)(np.maximum(planes.values, 0))
    return dark, weight, solve_illumination(planes, weight, dark)


def _is_point_symmetric(region: BoolArray, residual: FloatArray, centre: FloatArray) -> bool:
    """Whether residuals opposite a place are of its kind: to and fro a wrong motion errs alike, a cover does not."""
    ys, xs = np.nonzero(region)
    x, y = np.rint(2 * centre[0] - xs).astype(int), np.rint(2 * centre[1] - ys).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < residual.shape[1]) & (y < residual.shape[0])
    if np.count_nonzero(inside) < 0.5 * len(xs):
        return False
    here, there = residual[ys[inside], xs[inside]], residual[y[inside], x[inside]]
    return bool(float(here @ there) > 0.3 * float(here @ here))


def fixed_transfer(found: Measurement) -> Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """The motion that was found, as a model without parameters."""
    a, b = np.nan_to_num(found.a_px), np.nan_to_num(found.b_px)
    moment = np.array([a[0] ** 2 + b[0] ** 2, a[0] * a[1] + b[0] * b[1], a[1] ** 2 + b[1] ** 2])

    def motion(fx: FloatArray, fy: FloatArray, _: FloatArray) -> tuple[FloatArray, FloatArray]:
        return closed_form.orbit_transfer(fx, fy, moment)[0], np.zeros((0, *fx.shape))

    return motion
