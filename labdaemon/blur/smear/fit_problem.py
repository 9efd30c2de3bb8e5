"""What a fit of a blurred patch needs: the patch's colour planes, its frequencies, and the target's spectra at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur.motion import InitialGuess
from labdaemon.blur.patch.colour_planes import ColourPlanes, FrequencyGrid, make_grid, make_planes
from labdaemon.blur.patch.locate import Blob, find_blob, mask_pixels
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray, Patch
from labdaemon.blur.settings import CACHE
from labdaemon.blur.sharp.target import EllipseShape, SharpTarget, TargetShape
from labdaemon.blur.sharp.template_residual import trusted_pixels
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.spectra.render import to_single

TransferFunction = Callable[
    [FloatArray, FloatArray, FloatArray], tuple[FloatArray | ComplexArray, FloatArray | ComplexArray]
]
"""From fx, fy and motion parameters to the transfer function and its derivatives (m, rows, columns)."""


@dataclass(frozen=True, slots=True, eq=False)
class RestSpectra:
    """Spectra of a target at rest on a grid, single precision.

    Attributes
    ----------
    spectra
        (n, rows, columns) as each colour plane sees it, from its own first pixel.
    common
        (rows, columns) the mean of all channels, from the patch's first pixel.
    by_shape
        (k, rows, columns) its derivatives by the shape parameters.
    """

    spectra: NDArray[np.complex64]
    common: NDArray[np.complex64]
    by_shape: NDArray[np.complex64]

    @property
    def fixed_shape(self) -> RestSpectra:
        """The same with its shape taken for known."""
        return replace(self, by_shape=self.by_shape[:0])


@dataclass(frozen=True, slots=True, eq=False)
class FitProblem:
    """What a fit needs in addition to its parameters.

    Attributes
    ----------
    planes, grid
        The patch, cropped and masked, and its frequencies.
    rest_spectra
        Spectra of the target at rest on that grid.
    initial_centre_px
        (2,) where to begin, frame coordinates.
    blob
        The smear as first seen; None for a texture.
    """

    planes: ColourPlanes
    grid: FrequencyGrid
    rest_spectra: RestSpectra
    initial_centre_px: FloatArray
    blob: Blob | None

    @property
    def shape_count(self) -> int:
        """Number of the shape parameters."""
        return len(self.rest_spectra.by_shape)

    def starting_from(self, sharp: SharpTarget, guess: InitialGuess) -> FitProblem:
        """The same where the motion is roughly known: the part of a blur that a mask leaves has other moments."""
        if self.blob is None or guess.a_px is None:
            return self
        b = guess.b_px if guess.b_px is not None else np.zeros(2)
        moment = sharp.form.moment_px2 + (np.outer(guess.a_px, guess.a_px) + np.outer(b, b)) / 2
        place = np.asarray(guess.centre_px, dtype=np.float64)
        return replace(self, initial_centre_px=place, blob=replace(self.blob, moment_px2=moment, centre_px=place))


def prepare_fit(
    sharp: SharpTarget,
    patch: Patch,
    expected_px: FloatArray,
    known: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    path_px: FloatArray | None = None,
) -> FitProblem | None:
    """Find the smear in the patch, crop to it, and evaluate the target's spectra; None if there is none.

    Parameters
    ----------
    known
        Mean position, a and b where a first fit has found them: the mask of trusted paper depends on them.
    path_px
        As for `find_blob`.
    """
    if min(patch.shape) < 5:
        return None
    if isinstance(sharp.form, TexturedPatch):
        return _prepare_texture(sharp, sharp.form, patch, expected_px)
    half_w, half_h = sharp.form.half_size_px
    area = np.pi * half_w * half_h
    template_residual = sharp.form.template_residual if isinstance(sharp.form, EllipseShape) else None
    rough = template_residual is not None and template_residual.is_strong
    blob = find_blob(patch, expected_px, area, sharp.contrast, threshold=0.45 if rough else None, path_px=path_px)
    if blob is None or blob.area_px2 > 2.5 * area:
        return None
    reach_px = 6 + int(0.15 * half_w) + (int(half_w) if rough else 0)
    left, top, right, bottom = blob.box_px
    if path_px is not None:  # fainter ends of the path may not stand out of the noise
        away = np.abs(path_px) + np.array([half_w, half_h])
        (left, top), (right, bottom) = (
            np.minimum((left, top), np.floor(expected_px - away)).astype(int),
            np.maximum((right, bottom), np.ceil(expected_px + away)).astype(int),
        )
    shown = patch if rough else mask_pixels(patch, blob.other_blobs)
    cut = shown.crop(left - reach_px, top - reach_px, right - left + 1 + 2 * reach_px, bottom - top + 1 + 2 * reach_px)
    if template_residual is not None and template_residual.needs_mask:
        place, a, b = (blob.centre_px, *_rough_axes(blob, sharp)) if known is None else known
        cut = mask_pixels(cut, ~trusted_pixels(template_residual, cut, place, a, b, half_w))
    planes = make_planes(cut)
    height, width = cut.shape
    margin = sharp.form.psf_margin_px
    grid = make_grid((height + margin, width + margin), sharp.form.oversampling)
    return FitProblem(planes, grid, rest_spectra(sharp.form, grid, planes), blob.centre_px, blob)


def rest_spectra(form: TargetShape, grid: FrequencyGrid, planes: ColourPlanes) -> RestSpectra:
    """A target's spectra at rest on a patch's grid; kept for dots."""
    channel = tuple(planes.channel.tolist())
    if isinstance(form, EllipseShape) and form.template_residual is None and grid.fx.size <= CACHE.max_frequencies:
        return _cached_rest_spectra(_DotKey.from_shape(form), grid.size, grid.oversampling, channel, planes.period)
    return _compute_rest_spectra(form, grid, channel, planes.period)


def _compute_rest_spectra(form: TargetShape, grid: FrequencyGrid, channel: tuple[int, ...], period: int) -> RestSpectra:
    spectra, by_shape = form.spectra(grid, np.array(channel))
    offsets = [(index % period, index // period) for index in range(len(channel))]
    first = [np.exp(2j * np.pi * (ox * grid.fx + oy * grid.fy)) for ox, oy in offsets]
    return RestSpectra(to_single(spectra * first), to_single(spectra.mean(axis=0)), to_single(by_shape.mean(axis=1)))


@dataclass(frozen=True, slots=True)
class _DotKey:
    """A dot that is known by its numbers, since every task of a worker brings its own copy of it."""

    numbers: tuple[bytes, ...]
    form: EllipseShape = field(compare=False)

    @classmethod
    def from_shape(cls, form: EllipseShape) -> _DotKey:
        lens = form.lens
        arrays = (form.q_px, lens.channel, lens.variance_px2, lens.width_px, lens.offset_px)
        return cls(tuple(array.tobytes() for array in arrays), form)


@lru_cache(maxsize=CACHE.max_dots)
def _cached_rest_spectra(
    dot: _DotKey, size: tuple[int, int], oversampling: int, channel: tuple[int, ...], period: int
) -> RestSpectra:
    return _compute_rest_spectra(dot.form, make_grid(size, oversampling), channel, period)


def _rough_axes(blob: Blob, sharp: SharpTarget) -> tuple[FloatArray, FloatArray]:
    """Axes of the motion by the smear's second moment."""
    values, vectors = np.linalg.eigh(2 * (blob.moment_px2 - sharp.form.moment_px2))
    sizes = np.sqrt(np.maximum(values, 0.25))
    return vectors[:, 1] * sizes[1], vectors[:, 0] * sizes[0]


def _prepare_texture(
    sharp: SharpTarget, form: TexturedPatch, patch: Patch, expected_px: FloatArray
) -> FitProblem | None:
    width, height = form.box_size_px
    left, top = (int(np.rint(v)) for v in expected_px - (np.array([width, height]) - 1) / 2)
    cut = patch.crop(left, top, width, height)
    if cut.shape[0] < 0.5 * height or cut.shape[1] < 0.5 * width or np.count_nonzero(cut.valid) < 0.3 * width * height:
        return None
    planes = make_planes(mask_pixels(cut, ~np.isin(cut.channel, form.channel)))
    grid = make_grid((form.dark.shape[1] + 4, form.dark.shape[2] + 4))
    return FitProblem(planes, grid, rest_spectra(form, grid, planes), np.asarray(expected_px, dtype=np.float64), None)
