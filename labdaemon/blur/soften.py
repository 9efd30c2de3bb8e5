"""Compare a sampled picture with a later one only where a mosaic's samples hold it well.

A sharp picture that stands in for its target carries noise, and near the Nyquist frequency of a colour's lattice
little else; a fit of the later frame's blur would explain that noise away. Smoothing both alike by a lattice's next
neighbours (1, 2, 1 along each side) leaves the edges' slopes and takes nine tenths of that noise's pull.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from labdaemon.blur.model import Setting
from labdaemon.blur.mosaic import Grid
from labdaemon.blur.pixels import FloatArray

KERNEL = np.array([0.25, 0.5, 0.25])
VARIANCE = float(np.sum(KERNEL**2) ** 2)
"""What the smoothing leaves of the variance of independent noise."""


def transfer(grid: Grid, period: int) -> FloatArray:
    """(rows, columns) what the smoothing leaves of each frequency, on lattices of `period`."""
    along_x, along_y = (0.5 + 0.5 * np.cos(2 * np.pi * period * f) for f in (grid.fx, grid.fy))
    result: FloatArray = along_x * along_y
    return result


def softened(setting: Setting) -> Setting:
    """A setting with picture and model smoothed; pixels without valid neighbours are masked."""
    planes, leaves = setting.planes, transfer(setting.grid, setting.planes.period)
    values = planes.values
    for axis in (1, 2):
        values = ndimage.correlate1d(values, KERNEL, axis=axis, mode="nearest")
    valid = ndimage.minimum_filter(planes.valid, size=(1, 3, 3), mode="constant", cval=0)
    return replace(
        setting,
        planes=replace(planes, values=values, valid=valid),
        spectra=setting.spectra * leaves,
        by_shape=setting.by_shape * leaves,
    )
