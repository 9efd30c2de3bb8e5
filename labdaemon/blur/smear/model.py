"""The modelled picture of a smeared target in a patch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur.patch.locate import Blob, find_blob, masked
from labdaemon.blur.patch.mosaic import Grid, Planes, make_grid, split, to_lattice
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray, Patch
from labdaemon.blur.sharp.relief import trusted
from labdaemon.blur.sharp.target import Ellipse, Form, SharpTarget
from labdaemon.blur.sharp.texture import Texture
from labdaemon.blur.solver.solve import Model
from labdaemon.blur.spectra import shapes
from labdaemon.blur.spectra.render import on_lattices, single

Motion = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray | ComplexArray, FloatArray | ComplexArray]]
"""From fx, fy and motion parameters to the transfer function and its derivatives (m, rows, columns)."""

KEPT, LARGEST = 192, 6000
"""How many dots' spectra at rest are kept, and of how many frequencies: they stay the same for a campaign, and patches
come in few sizes. At most 80 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """Spectra of a target at rest on a grid, single precision.

    Attributes
    ----------
    spectra
        (n, rows, columns) as each lattice sees it, from its own first pixel.
    common
        (rows, columns) the mean of all channels, from the patch's first pixel.
    by_shape
        (k, rows, columns) its derivatives by the shape parameters.
    """

    spectra: NDArray[np.complex64]
    common: NDArray[np.complex64]
    by_shape: NDArray[np.complex64]

    @property
    def rigid(self) -> Standing:
        """The same with its shape taken for known."""
        return replace(self, by_shape=self.by_shape[:0])


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What a fit needs besides its parameters.

    Attributes
    ----------
    planes, grid
        The patch, cropped and masked, and its frequencies.
    target
        What the target looks like at rest there.
    start_px
        (2,) where to begin, frame coordinates.
    blob
        The smear as first seen; None for a texture.
    """

    planes: Planes
    grid: Grid
    target: Standing
    start_px: FloatArray
    blob: Blob | None

    @property
    def shapes(self) -> int:
        """Number of the shape parameters."""
        return len(self.target.by_shape)


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
    return Setting(planes, grid, standing(sharp.form, grid, planes), blob.centre_px, blob)


def standing(form: Form, grid: Grid, planes: Planes) -> Standing:
    """A target's spectra at rest on a patch's grid; kept for dots."""
    channel = tuple(planes.channel.tolist())
    if isinstance(form, Ellipse) and form.relief is None and grid.fx.size <= LARGEST:
        return _kept(_Dot.of(form), grid.size, grid.oversampling, channel, planes.period)
    return _stand(form, grid, channel, planes.period)


def _stand(form: Form, grid: Grid, channel: tuple[int, ...], period: int) -> Standing:
    spectra, by_shape = form.spectra(grid, np.array(channel))
    offsets = [(index % period, index // period) for index in range(len(channel))]
    first = [np.exp(2j * np.pi * (ox * grid.fx + oy * grid.fy)) for ox, oy in offsets]
    return Standing(single(spectra * first), single(spectra.mean(axis=0)), single(by_shape.mean(axis=1)))


@dataclass(frozen=True, slots=True)
class _Dot:
    """A dot that is known by its numbers, since every task of a worker brings its own copy of it."""

    numbers: tuple[bytes, ...]
    form: Ellipse = field(compare=False)

    @classmethod
    def of(cls, form: Ellipse) -> _Dot:
        lens = form.lens
        arrays = (form.q_px, lens.channel, lens.variance_px2, lens.width_px, lens.offset_px)
        return cls(tuple(array.tobytes() for array in arrays), form)


@lru_cache(maxsize=KEPT)
def _kept(dot: _Dot, size: tuple[int, int], oversampling: int, channel: tuple[int, ...], period: int) -> Standing:
    return _stand(dot.form, make_grid(size, oversampling), channel, period)


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
    return Setting(planes, grid, standing(form, grid, planes), np.asarray(expected_px, dtype=np.float64), None)


def blurred_model(setting: Setting, motion: Motion | None, *, exact: bool = False) -> Model:
    """Darkness of a moving target.

    Parameters are x, y, extra variance, the shape parameters' deviations, then the motion's own. `motion` None is rest.

    The darkness is each channel's own. Its derivatives are those of the channels' mean unless `exact`: that halves the
    work and biases nothing; a hundredth of the precision is lost, channels differing by parts of a pixel of blur.
    """
    grid, planes, target = setting.grid, setting.planes, setting.target
    k = setting.shapes
    _, height, width = planes.values.shape
    axes = _axes(grid)
    origin = np.asarray(planes.origin_px)

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = p[:2] - origin
        still = axes.placed(float(x), float(y), float(p[2]))
        transfer, slopes = motion(axes.fx, axes.fy, p[3 + k :]) if motion is not None else _at_rest(axes.fx)
        moving = still * single(transfer)
        dark = to_lattice(target.spectra * moving, grid, planes.period)[:, :height, :width]
        own = np.empty((3 + k + len(slopes), *still.shape), dtype=np.complex64)
        np.multiply(target.by_shape, moving, out=own[3 : 3 + k])
        if exact:
            np.multiply(axes.by_nuisance, moving, out=own[:3])
            np.multiply(single(slopes), still, out=own[3 + k :])
            each = np.concatenate((own[:3], own[3 + k :]))[:, None] * target.spectra
            by_own = to_lattice(each, grid, planes.period)[..., :height, :width]
            by_p = np.concatenate((by_own[:3], on_lattices(own[3 : 3 + k], grid, planes), by_own[3:]))
        else:
            np.multiply(axes.by_nuisance, target.common * moving, out=own[:3])
            np.multiply(single(slopes), target.common * still, out=own[3 + k :])
            by_p = on_lattices(own, grid, planes)
        if np.any(p[3 : 3 + k]):
            dark = dark + np.tensordot(single(p[3 : 3 + k]), by_p[3 : 3 + k], axes=1)
        return dark, by_p

    return model


@dataclass(frozen=True, slots=True, eq=False)
class _Axes:
    """A grid's frequencies in single precision, and what follows from them."""

    fx: FloatArray
    fy: FloatArray
    by_nuisance: NDArray[np.complex64]

    def placed(self, x: float, y: float, variance_px2: float) -> NDArray[np.complex64]:
        """(rows, columns) factors that move a target's centre to a place in the patch and blur it."""
        along_x, along_y = self.fx[:1].astype(np.float64), self.fy[:, :1].astype(np.float64)
        fade_x, fade_y = shapes.gaussian(along_x**2, variance_px2), shapes.gaussian(along_y**2, variance_px2)
        result: NDArray[np.complex64] = single(np.exp(-2j * np.pi * x * along_x) * fade_x) * single(
            np.exp(-2j * np.pi * y * along_y) * fade_y
        )
        return result


@lru_cache(maxsize=64)
def _axes(grid: Grid) -> _Axes:
    by_nuisance = np.stack((-2j * np.pi * grid.fx, -2j * np.pi * grid.fy, -2 * np.pi**2 * (grid.fx**2 + grid.fy**2)))
    return _Axes(single(grid.fx), single(grid.fy), single(by_nuisance))


def _at_rest(fx: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.ones_like(fx), np.zeros((0, *fx.shape), dtype=fx.dtype)
