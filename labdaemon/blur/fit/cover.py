"""What stands in the way: something in front of a target, the paper's edge, a white that clips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.light import render_light, solve_light
from labdaemon.blur.patch.locate import find_blob
from labdaemon.blur.patch.mosaic import deal, interleave
from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import pixel_weights
from labdaemon.blur.smear.model import Setting, blurred_model
from labdaemon.blur.spectra import shapes
from labdaemon.flags import Flag

ODD_SIGMAS = 4.0
MOST_HIDDEN = 0.45  # part of the patch that may be covered and the rest still believed


def why_nothing(sharp: SharpTarget, patch: Patch, expected_px: FloatArray) -> set[Flag]:
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
        return {Flag.PAPER_EDGE if blob.cut else Flag.OCCLUDED, Flag.NOT_FOUND}
    return {Flag.NOT_FOUND}


def uncovered(
    sharp: SharpTarget, setting: Setting, found: Measurement, fit: Callable[[Setting], Measurement]
) -> Measurement:
    """Fit again without a compact part of the patch that does not look like the rest.

    Something in front of a target spoils one place wholly; a motion that is not what was assumed spoils the smear's
    whole outline a little. If the rest fits by itself the measurement is the rest's, flagged `occluded`; else it stays.
    """
    for _ in range(2):
        hidden = _odd_place(sharp, setting, found)
        if hidden is None:
            return found
        planes = setting.planes
        setting = replace(setting, planes=replace(planes, valid=planes.valid & ~deal(planes, hidden)))
        again = fit(setting)
        if Flag.POOR_FIT not in again.flags:
            return replace(again, flags=again.flags | {Flag.OCCLUDED})
        found = again
    return found


def _odd_place(sharp: SharpTarget, setting: Setting, found: Measurement) -> BoolArray | None:
    """The one connected place where residuals are far from noise; None if there is none, or too much of it."""
    planes = setting.planes
    if not np.all(np.isfinite([*found.centre_px, found.extra_blur_px2])):
        return None
    dark, weight, light = _lit(sharp, setting, found)
    residual = interleave(planes, (planes.values - render_light(planes, light, dark)) * np.sqrt(weight))
    smooth = ndimage.uniform_filter(residual, 3) * 3.0
    odd = np.abs(smooth) > max(ODD_SIGMAS, 2.5 * 1.48 * float(np.median(np.abs(smooth))))
    labels, count = ndimage.label(ndimage.binary_closing(odd, iterations=2))
    if count == 0:
        return None
    power = ndimage.sum_labels(residual**2, labels, np.arange(1, count + 1))
    place = labels == 1 + int(np.argmax(power))
    if _alike_across(place, residual, found.centre_px - np.asarray(planes.origin_px)):
        return None
    place = ndimage.binary_dilation(place, iterations=3)
    return None if place.mean() > MOST_HIDDEN else place


def contrast_left(sharp: SharpTarget, setting: Setting, found: Measurement) -> float:
    """Contrast of what moved as was found, in parts of the sharp picture's: about 1 for a texture that is there."""
    return float(np.median(_lit(sharp, setting, found)[2][:, 3]))


def _lit(sharp: SharpTarget, setting: Setting, found: Measurement) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Darkness by the motion that was found, weights, and the light fitted to it over everything."""
    planes = setting.planes
    at = np.concatenate((found.centre_px, [found.extra_blur_px2], np.zeros(setting.shapes)))
    dark, _ = blurred_model(setting, fixed(found))(at)
    weight = pixel_weights(sharp, planes)(np.maximum(planes.values, 0))
    return dark, weight, solve_light(planes, weight, dark)


def _alike_across(place: BoolArray, residual: FloatArray, centre: FloatArray) -> bool:
    """Whether residuals opposite a place are of its kind: to and fro a wrong motion errs alike, a cover does not."""
    ys, xs = np.nonzero(place)
    x, y = np.rint(2 * centre[0] - xs).astype(int), np.rint(2 * centre[1] - ys).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < residual.shape[1]) & (y < residual.shape[0])
    if np.count_nonzero(inside) < 0.5 * len(xs):
        return False
    here, there = residual[ys[inside], xs[inside]], residual[y[inside], x[inside]]
    return bool(float(here @ there) > 0.3 * float(here @ here))


def fixed(found: Measurement) -> Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """The motion that was found, as a model without parameters."""
    a, b = np.nan_to_num(found.a_px), np.nan_to_num(found.b_px)
    moment = np.array([a[0] ** 2 + b[0] ** 2, a[0] * a[1] + b[0] * b[1], a[1] ** 2 + b[1] ** 2])

    def motion(fx: FloatArray, fy: FloatArray, _: FloatArray) -> tuple[FloatArray, FloatArray]:
        return shapes.orbit(fx, fy, moment)[0], np.zeros((0, *fx.shape))

    return motion
