"""The sensor's channels as separate colour planes, and the frequencies at which a patch is modelled.

A Bayer patch is four colour planes of period two; a grey one a single colour plane of period one. A model spectrum
known in closed form is sampled on the patch's frequencies (up to and beyond the Nyquist frequency) and folded on to
each colour plane, so that one small inverse FFT a colour plane gives the model exactly at that channel's own pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch
from labdaemon.errors import DataError


@dataclass(frozen=True, slots=True, eq=False)
class ColourPlanes:
    """A patch split into its channels' colour planes.

    Attributes
    ----------
    values, valid
        (n, h, w), n colour planes; padded with invalid pixels where a colour plane is one short.
    channel
        (n,) the channel of each colour plane.
    offset_px
        (n, 2) x and y of each colour plane's first pixel in the patch.
    period
        Distance of neighbours on a colour plane, px.
    origin_px
        (x, y) of the patch in its frame.
    """

    values: FloatArray
    valid: BoolArray
    channel: NDArray[np.int64]
    offset_px: FloatArray
    period: int
    origin_px: tuple[int, int]

    @property
    def first(self) -> ColourPlanes:
        """The first colour plane alone."""
        return replace(
            self,
            values=self.values[:1],
            valid=self.valid[:1],
            channel=self.channel[:1],
            offset_px=self.offset_px[:1],
        )


def make_planes(patch: Patch) -> ColourPlanes:
    """Split a patch into its channels' colour planes.

    Raises
    ------
    DataError
        The channels do not repeat with period one or two (X-Trans), or the patch is empty.
    """
    height, width = patch.shape
    if height == 0 or width == 0:
        raise DataError("a patch lies off the frame; move it inside")
    finite = np.isfinite(patch.values)
    values = np.where(finite, patch.values, 0.0)
    valid = patch.valid & finite
    first = patch.channel[0, 0]
    if np.all(patch.channel == first):
        one = np.array([int(first)])
        return ColourPlanes(values[None], valid[None], one, np.zeros((1, 2)), 1, patch.origin_px)
    h, w = (height + 1) // 2, (width + 1) // 2
    all_values, all_valid = np.zeros((4, h, w)), np.zeros((4, h, w), dtype=bool)
    channels, offsets = np.zeros(4, dtype=np.int64), np.zeros((4, 2))
    for index, (oy, ox) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        part = (slice(oy, None, 2), slice(ox, None, 2))
        ids = patch.channel[part]
        if ids.size == 0 or np.any(ids != ids.flat[0]):
            raise DataError(
                "the colour filter does not repeat every two pixels; use a camera with a Bayer or no filter"
            )
        all_values[index, : ids.shape[0], : ids.shape[1]] = values[part]
        all_valid[index, : ids.shape[0], : ids.shape[1]] = valid[part]
        channels[index], offsets[index] = int(ids.flat[0]), (ox, oy)
    return ColourPlanes(all_values, all_valid, channels, offsets, 2, patch.origin_px)


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyGrid:
    """Half-plane of frequencies at which a patch's model is evaluated.

    Attributes
    ----------
    fx, fy
        (rows, columns) cycles a pixel; the columns hold the non-negative half.
    size
        (height, width) in pixels of the periodic patch; even multiples of the colour plane period.
    oversampling
        1: up to the Nyquist frequency; 2: twice that, for lenses sharper than the pixels.
    """

    fx: FloatArray
    fy: FloatArray
    size: tuple[int, int]
    oversampling: int


def make_grid(shape: tuple[int, int], oversampling: int = 1) -> FrequencyGrid:
    """Frequencies for patches of at least `shape` (height, width) pixels."""
    height, width = (4 * int(fft.next_fast_len(-(-length // 4), real=True)) for length in shape)
    return _grid((height, width), oversampling)


@lru_cache(maxsize=64)
def _grid(size: tuple[int, int], oversampling: int) -> FrequencyGrid:
    height, width = size
    rows, columns = oversampling * height, oversampling * width
    fy = np.fft.fftfreq(rows) * oversampling
    fx = np.fft.rfftfreq(columns) * oversampling
    full_y, full_x = np.broadcast_arrays(fy[:, None], fx[None, :])
    return FrequencyGrid(np.ascontiguousarray(full_x), np.ascontiguousarray(full_y), (height, width), oversampling)


def sample_plane(spectrum: Any, grid: FrequencyGrid, period: int) -> FloatArray:
    """Model values on a colour plane from spectra on the grid.

    Parameters
    ----------
    spectrum
        (..., rows, columns) continuous Fourier transforms (px²), already shifted to the colour plane's first pixel.
    period
        Colour plane period, px.

    Returns
    -------
    (..., size[0] / period, size[1] / period), in the spectrum's own precision
    """
    factor = period * grid.oversampling
    height, width = grid.size[0] // period, grid.size[1] // period
    if factor > 1:
        rows = spectrum.shape[-2]
        folded = spectrum.reshape(*spectrum.shape[:-2], factor, rows // factor, spectrum.shape[-1]).sum(axis=-3)
        half = width // 2
        base = folded[..., : half + 1].copy()
        for segment in range(1, factor):
            part = folded[..., segment * half : (segment + 1) * half + 1]
            if segment % 2:
                # frequency −f of row r stands in row −r
                base[..., 0, :] += np.conj(part[..., 0, ::-1])
                base[..., 1:, :] += np.conj(part[..., :0:-1, ::-1])
            else:
                base += part
    else:
        base = spectrum
    result: FloatArray = fft.irfft2(base, s=(height, width), axes=(-2, -1))
    if period > 1:
        result /= period**2
    return result


def split_planes(planes: ColourPlanes, images: NDArray[Any]) -> NDArray[Any]:
    """(..., n, h, w) colour planes of (..., H, W) images of one frame: the inverse of `merge_planes`."""
    step = planes.period
    return np.stack([images[..., int(oy) :: step, int(ox) :: step] for ox, oy in planes.offset_px], axis=-3)


def merge_planes(planes: ColourPlanes, values: FloatArray) -> FloatArray:
    """(..., H, W) images of (..., n, h, w) colour planes; frames stacked in one `ColourPlanes` lie side by side."""
    step = planes.period
    count = step * step
    *lead, n, height, width = values.shape
    frames = n // count
    result = np.zeros((*lead, step * height, step * width * frames), dtype=values.dtype)
    for index in range(n):
        ox, oy = (planes.offset_px[index] - planes.offset_px[index - index % count]).astype(int)
        left = step * width * (index // count)
        result[..., oy::step, left + ox : left + step * width : step] = values[..., index, :, :]
    return result
