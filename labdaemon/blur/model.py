"""The modelled picture of a smeared target in a patch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labdaemon.blur import shapes
from labdaemon.blur.locate import Blob, find_blob, masked
from labdaemon.blur.mosaic import Grid, Planes, make_grid, split
from labdaemon.blur.pixels import ComplexArray, FloatArray, Patch
from labdaemon.blur.relief import trusted
from labdaemon.blur.render import darkness, phases, single
from labdaemon.blur.sharp import Ellipse, SharpTarget
from labdaemon.blur.solve import Model
from labdaemon.blur.texture import Texture

Motion = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray | ComplexArray, FloatArray | ComplexArray]]
"""From fx, fy and motion parameters to the transfer function and its derivatives (m, rows, columns)."""


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What a fit needs besides its parameters.

    Attributes
    ----------
    planes, grid
        The patch, cropped and masked, and its frequencies.
    spectra, by_shape
        The target's spectra there and their derivatives by its shape.
    start_px
        (2,) where to begin, frame coordinates.
    blob
        The smear as first seen; None for a texture.
    """

    planes: Planes
    grid: Grid
    spectra: ComplexArray
    by_shape: ComplexArray
    start_px: FloatArray
    blob: Blob | None


def prepare(
    sharp: SharpTarget,
    patch: Patch,
    expected_px: FloatArray,
    known: tuple[FloatArray, FloatArray, FloatArray] | None = None,
) -> Setting | None:
    """Find the smear in the patch, crop to it, and evaluate the target's spectra; None if there is none.

    Parameters
    ----------
    known
        Mean position, a and b where a first fit has found them: the mask of trusted paper depends on them.
    """
    if min(patch.shape) < 5:
        return None
    if isinstance(sharp.form, Texture):
        return _prepare_texture(sharp, sharp.form, patch, expected_px)
    half_w, half_h = sharp.form.half_size_px
    area = np.pi * half_w * half_h
    relief = sharp.form.relief if isinstance(sharp.form, Ellipse) else None
    rough = relief is not None and relief.strong
    blob = find_blob(patch, expected_px, area, sharp.contrast, threshold=0.45 if rough else None)
    if blob is None or blob.area_px2 > 2.5 * area:
        return None
    reach_px = 6 + int(0.15 * half_w) + (int(half_w) if rough else 0)
    left, top, right, bottom = blob.box_px
    shown = patch if rough else masked(patch, blob.others)
    cut = shown.crop(left - reach_px, top - reach_px, right - left + 1 + 2 * reach_px, bottom - top + 1 + 2 * reach_px)
    if relief is not None and relief.bounded:
        place, a, b = (blob.centre_px, *_rough_axes(blob, sharp)) if known is None else known
        cut = masked(cut, ~trusted(relief, cut, place, a, b, half_w))
    planes = split(cut)
    height, width = cut.shape
    margin = sharp.form.skirt_px
    grid = make_grid((height + margin, width + margin), sharp.form.oversampling)
    spectra, by_shape = sharp.form.spectra(grid, planes.channel)
    return Setting(planes, grid, spectra, by_shape, blob.centre_px, blob)


def _rough_axes(blob: Blob, sharp: SharpTarget) -> tuple[FloatArray, FloatArray]:
    """Axes of the motion by the smear's second moment."""
    values, vectors = np.linalg.eigh(2 * (blob.moment_px2 - sharp.form.moment_px2))
    sizes = np.sqrt(np.maximum(values, 0.25))
    return vectors[:, 1] * sizes[1], vectors[:, 0] * sizes[0]


def _prepare_texture(sharp: SharpTarget, form: Texture, patch: Patch, expected_px: FloatArray) -> Setting | None:
    width, height = form.box_size_px
    left, top = (int(np.rint(v)) for v in expected_px - (np.array([width, height]) - 1) / 2)
    cut = patch.crop(left, top, width, height)
    if cut.shape[0] < 0.5 * height or cut.shape[1] < 0.5 * width or np.count_nonzero(cut.valid) < 0.3 * width * height:
        return None
    planes = split(masked(cut, ~np.isin(cut.channel, form.channel)))
    grid = make_grid((form.dark.shape[1] + 4, form.dark.shape[2] + 4))
    spectra, by_shape = form.spectra(grid, planes.channel)
    return Setting(planes, grid, spectra, by_shape, np.asarray(expected_px, dtype=np.float64), None)


def blurred_model(setting: Setting, motion: Motion | None) -> Model:
    """Darkness of a moving target.

    Parameters are x, y, extra variance, the shape parameters' deviations, then the motion's own. `motion` None is rest.
    """
    grid, planes = setting.grid, setting.planes
    f2 = grid.fx**2 + grid.fy**2
    shape = setting.by_shape
    k = shape.shape[0]

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        whole: FloatArray | ComplexArray = shapes.gaussian(f2, p[2])
        by_motion: FloatArray | ComplexArray = np.zeros((0, *f2.shape))
        if motion is not None:
            transfer, slopes = motion(grid.fx, grid.fy, p[3 + k :])
            by_motion = slopes * whole
            whole = whole * transfer
        own = setting.spectra + np.tensordot(p[3 : 3 + k], shape, axes=1) if np.any(p[3 : 3 + k]) else setting.spectra
        phase = phases(grid, planes, p[:2])
        moved = (own * phase).astype(np.complex64)
        turned = moved * np.complex64(-2j * np.pi)
        spectra = np.empty((4 + k + len(by_motion), *moved.shape), dtype=np.complex64)
        # The factors of whole cycles are real: keeping them so halves the work. Single precision is a thousandth of the
        # noise; all sums over pixels are in double.
        np.multiply(moved, single(whole), out=spectra[0])
        np.multiply(turned, single(grid.fx * whole), out=spectra[1])
        np.multiply(turned, single(grid.fy * whole), out=spectra[2])
        np.multiply(moved, single(-2 * np.pi**2 * f2 * whole), out=spectra[3])
        if k:
            np.multiply(single(shape), single(phase * whole), out=spectra[4 : 4 + k])
        for index, factor in enumerate(by_motion):
            np.multiply(moved, single(factor), out=spectra[4 + k + index])
        images = darkness(spectra, grid, planes)
        return images[0], images[1:]

    return model
