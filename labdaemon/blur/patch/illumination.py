"""The light on a patch: a plane of brightness and a contrast for each channel's colour plane.

A pixel of channel c is L_c(x)·(1 − k_c·m(x; p)) with L_c = w0 + w1·x + w2·y (white and light gradient), k_c the
contrast of ink against paper and m the modelled darkness.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.pixels import FloatArray


def illumination_coordinates(planes: ColourPlanes) -> tuple[FloatArray, FloatArray]:
    """Positions scaled to −1..1 across the patch: (1, 1, w) and (1, h, 1)."""
    _, height, width = planes.values.shape
    return _unit_coordinates(width)[None, None, :], _unit_coordinates(height)[None, :, None]


@lru_cache(maxsize=256)
def _unit_coordinates(length: int) -> FloatArray:
    result: FloatArray = (2 * np.arange(length) + 1) / length - 1
    return result


def solve_illumination(planes: ColourPlanes, weight: FloatArray, dark: FloatArray) -> FloatArray:
    """Best light for a fixed darkness: linear least squares in w0, w1, w2 and the common contrast w0·k."""
    u, v = illumination_coordinates(planes)
    n = len(dark)
    columns = np.empty((n, 5, *dark.shape[1:]), dtype=dark.dtype)
    columns[:, 0], columns[:, 1], columns[:, 2] = 1.0, u, v
    np.negative(dark, out=columns[:, 3])
    columns[:, 4] = planes.values
    columns = columns.reshape(n, 5, -1)
    normal = ((columns[:, :4] * weight.reshape(n, 1, -1)) @ columns.transpose(0, 2, 1)).astype(np.float64)
    left = normal[:, :, :4]
    solution: FloatArray = np.linalg.solve(left + ridge_matrix(left, 1e-9), normal[:, :, 4:])[..., 0].astype(np.float64)
    solution[:, 3] /= np.where(np.abs(solution[:, 0]) > 1e-12, solution[:, 0], 1.0)
    return solution


def paper_level(planes: ColourPlanes, light: FloatArray, dtype: Any = np.float64) -> FloatArray:
    """(n, h, w) values of bare paper under a light."""
    u, v = illumination_coordinates(planes)
    down = light[:, 0, None, None] + light[:, 2, None, None] * v
    across = light[:, 1, None, None] * u
    level: FloatArray = down.astype(dtype) + across.astype(dtype)
    return level


def ridge_matrix(normal: FloatArray, part: float) -> FloatArray:
    """A little on the diagonals, so that a colour plane without a valid pixel does no harm."""
    trace = np.einsum("nii->n", normal)
    result = np.zeros(normal.shape)
    np.einsum("nii->ni", result)[:] = np.where(trace > 0, part * trace, 1.0)[:, None]
    return result


def render_illumination(planes: ColourPlanes, light: FloatArray, dark: FloatArray) -> FloatArray:
    """(n, h, w) values of a darkness under a light, in the darkness' precision."""
    result: FloatArray = _relative_reflectance(light, dark)
    result *= paper_level(planes, light, dark.dtype)
    return result


def _relative_reflectance(light: FloatArray, dark: FloatArray) -> FloatArray:
    """(n, h, w) what is left of the paper's light."""
    result: FloatArray = dark * (-light[:, 3, None, None]).astype(dark.dtype)
    result += 1
    return result


def illumination_derivatives(
    planes: ColourPlanes, light: FloatArray, dark: FloatArray, by_p: FloatArray, residual: FloatArray | None = None
) -> FloatArray:
    """(n, k + 4, h, w) derivatives of the values by the parameters and each plane's illumination; last the residual."""
    u, v = illumination_coordinates(planes)
    k, dtype = len(by_p), by_p.dtype
    columns = np.empty((len(light), k + 4 + (residual is not None), *dark.shape[1:]), dtype=dtype)
    level = paper_level(planes, light, dtype)
    shade = _relative_reflectance(light, dark)
    depth = level * (-light[:, 3, None, None]).astype(dtype)
    np.multiply(by_p.swapaxes(0, 1), depth[:, None], out=columns[:, :k])
    columns[:, k] = shade
    np.multiply(shade, u.astype(dtype), out=columns[:, k + 1])
    np.multiply(shade, v.astype(dtype), out=columns[:, k + 2])
    np.multiply(-level, dark, out=columns[:, k + 3])
    if residual is not None:
        columns[:, -1] = residual
    return columns
