"""From spectra to darkness at each channel's pixels, with derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from labdaemon.blur.patch.colour_planes import ColourPlanes, FrequencyGrid, sample_plane
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray


def shift_factors(grid: FrequencyGrid, planes: ColourPlanes, centre_px: FloatArray) -> ComplexArray:
    """(n, rows, columns) factors that move a target's centre to `centre_px` of the frame, on each colour plane."""
    move = centre_px - np.asarray(planes.origin_px) - planes.offset_px
    along_x = np.exp(-2j * np.pi * move[:, 0, None, None] * grid.fx[:1])
    along_y = np.exp(-2j * np.pi * move[:, 1, None, None] * grid.fy[:, :1])
    result: ComplexArray = along_y * along_x
    return result


def shift_spectra(
    spectra: ComplexArray, grid: FrequencyGrid, planes: ColourPlanes, centre_px: FloatArray
) -> ComplexArray:
    """(..., n, rows, columns) spectra about the target's centre, moved to `centre_px` of the frame."""
    return spectra * shift_factors(grid, planes, centre_px)


def to_single(values: FloatArray | ComplexArray) -> Any:
    """The same in single precision."""
    return values.astype(np.complex64 if np.iscomplexobj(values) else np.float32, copy=False)


def render_darkness(spectra: Any, grid: FrequencyGrid, planes: ColourPlanes) -> FloatArray:
    """(..., n, h, w) darkness from (..., n, rows, columns) spectra of either precision."""
    _, height, width = planes.values.shape
    return sample_plane(spectra, grid, planes.period)[..., :height, :width]


def sample_planes(spectra: Any, grid: FrequencyGrid, planes: ColourPlanes) -> FloatArray:
    """(k, n, h, w) values on every colour plane of images that are the same for all: (k, rows, columns) spectra."""
    n, height, width = planes.values.shape
    images = sample_plane(spectra, grid, 1)
    result = np.empty((len(images), n, height, width), dtype=images.dtype)
    step = planes.period
    for index, (ox, oy) in enumerate(planes.offset_px.astype(int)):
        result[:, index] = images[:, oy : oy + step * height : step, ox : ox + step * width : step]
    return result
