"""From spectra to darkness at each channel's pixels, with derivatives."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.mosaic import Grid, Planes, to_lattice
from labdaemon.blur.pixels import ComplexArray, FloatArray


def shifted(spectra: ComplexArray, grid: Grid, planes: Planes, centre_px: FloatArray) -> ComplexArray:
    """Spectra moved so that the target's centre falls on `centre_px` of the frame, on each lattice.

    Parameters
    ----------
    spectra
        (..., n, rows, columns) about the target's centre.
    """
    move = centre_px - np.asarray(planes.origin_px) - planes.offset_px
    along_x = np.exp(-2j * np.pi * move[:, 0, None, None] * grid.fx[:1])
    along_y = np.exp(-2j * np.pi * move[:, 1, None, None] * grid.fy[:, :1])
    result: ComplexArray = spectra * (along_y * along_x)
    return result


def darkness(spectra: ComplexArray, grid: Grid, planes: Planes) -> FloatArray:
    """(..., n, h, w) darkness from (..., n, rows, columns) spectra."""
    _, height, width = planes.values.shape
    return to_lattice(spectra, grid, planes.period)[..., :height, :width]
