"""From spectra to darkness at each channel's pixels, with derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from labdaemon.blur.patch.mosaic import Grid, Planes, to_lattice
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray


def phases(grid: Grid, planes: Planes, centre_px: FloatArray) -> ComplexArray:
    """(n, rows, columns) factors that move a target's centre to `centre_px` of the frame, on each lattice."""
    move = centre_px - np.asarray(planes.origin_px) - planes.offset_px
    along_x = np.exp(-2j * np.pi * move[:, 0, None, None] * grid.fx[:1])
    along_y = np.exp(-2j * np.pi * move[:, 1, None, None] * grid.fy[:, :1])
    result: ComplexArray = along_y * along_x
    return result


def shifted(spectra: ComplexArray, grid: Grid, planes: Planes, centre_px: FloatArray) -> ComplexArray:
    """(..., n, rows, columns) spectra about the target's centre, moved to `centre_px` of the frame."""
    return spectra * phases(grid, planes, centre_px)


def single(values: FloatArray | ComplexArray) -> Any:
    """The same in single precision."""
    return values.astype(np.complex64 if np.iscomplexobj(values) else np.float32, copy=False)


def darkness(spectra: Any, grid: Grid, planes: Planes) -> FloatArray:
    """(..., n, h, w) darkness from (..., n, rows, columns) spectra of either precision."""
    _, height, width = planes.values.shape
    return to_lattice(spectra, grid, planes.period)[..., :height, :width]


def on_lattices(spectra: Any, grid: Grid, planes: Planes) -> FloatArray:
    """(k, n, h, w) values on every lattice of pictures that are the same for all: (k, rows, columns) spectra."""
    n, height, width = planes.values.shape
    pictures = to_lattice(spectra, grid, 1)
    result = np.empty((len(pictures), n, height, width), dtype=pictures.dtype)
    step = planes.period
    for index, (ox, oy) in enumerate(planes.offset_px.astype(int)):
        result[:, index] = pictures[:, oy : oy + step * height : step, ox : ox + step * width : step]
    return result
