"""The forward model in single precision: `labdaemon.blur.smear.forward_model` in less time.

Three measures make it fast, and none of them biases a fit: all spectra are single precision; the exponentials of the
position factor into x and y; and the derivatives are those of the mean of all colours unless `exact`, so that one
inverse transform serves all colour planes. A test holds that both models agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur.patch.colour_planes import FrequencyGrid, sample_plane
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.solver.solve import DarknessModel
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.spectra.render import sample_planes, to_single


def fast_forward_model(
    problem: FitProblem, transfer_function: TransferFunction | None, *, exact: bool = False
) -> DarknessModel:
    """Darkness of a moving target, as `forward_model`.

    Parameters
    ----------
    problem, transfer_function
        As for `forward_model`.
    exact
        Compute the derivatives of each colour plane on its own. This doubles the work; without it a fit loses a
        hundredth of its precision, because the colours differ by parts of a pixel of blur.
    """
    grid, planes, rest_spectra = problem.grid, problem.planes, problem.rest_spectra
    k = problem.shape_count
    _, height, width = planes.values.shape
    axes = _frequency_axes(grid)
    origin = np.asarray(planes.origin_px)

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = p[:2] - origin
        still = axes.place_target(float(x), float(y), float(p[2]))
        transfer, slopes = (
            transfer_function(axes.fx, axes.fy, p[3 + k :])
            if transfer_function is not None
            else _rest_transfer(axes.fx)
        )
        moving = still * to_single(transfer)
        dark = sample_plane(rest_spectra.spectra * moving, grid, planes.period)[:, :height, :width]
        own = np.empty((3 + k + len(slopes), *still.shape), dtype=np.complex64)
        np.multiply(rest_spectra.by_shape, moving, out=own[3 : 3 + k])
        if exact:
            np.multiply(axes.by_nuisance, moving, out=own[:3])
            np.multiply(to_single(slopes), still, out=own[3 + k :])
            each = np.concatenate((own[:3], own[3 + k :]))[:, None] * rest_spectra.spectra
            by_own = sample_plane(each, grid, planes.period)[..., :height, :width]
            by_p = np.concatenate((by_own[:3], sample_planes(own[3 : 3 + k], grid, planes), by_own[3:]))
        else:
            np.multiply(axes.by_nuisance, rest_spectra.common * moving, out=own[:3])
            np.multiply(to_single(slopes), rest_spectra.common * still, out=own[3 + k :])
            by_p = sample_planes(own, grid, planes)
        if np.any(p[3 : 3 + k]):
            dark = dark + np.tensordot(to_single(p[3 : 3 + k]), by_p[3 : 3 + k], axes=1)
        return dark, by_p

    return model


def darkness_model(problem: FitProblem, transfer_function: TransferFunction) -> Callable[[FloatArray], FloatArray]:
    """Darkness of a moving target as by `fast_forward_model`, without derivatives: a fifth of the time, for searches.

    The shape is that of the sharp frame.
    """
    grid, planes, k = problem.grid, problem.planes, problem.shape_count
    _, height, width = planes.values.shape
    axes, origin = _frequency_axes(grid), np.asarray(planes.origin_px)

    def model(p: FloatArray) -> FloatArray:
        x, y = p[:2] - origin
        transfer, _ = transfer_function(axes.fx, axes.fy, p[3 + k :])
        moving = axes.place_target(float(x), float(y), float(p[2])) * to_single(transfer)
        result: FloatArray = sample_plane(problem.rest_spectra.spectra * moving, grid, planes.period)
        return result[:, :height, :width]

    return model


@dataclass(frozen=True, slots=True, eq=False)
class _FrequencyAxes:
    """A grid's frequencies in single precision, and what follows from them."""

    fx: FloatArray
    fy: FloatArray
    by_nuisance: NDArray[np.complex64]

    def place_target(self, x: float, y: float, variance_px2: float) -> NDArray[np.complex64]:
        """(rows, columns) factors that move a target's centre to a place in the patch and blur it."""
        along_x, along_y = self.fx[:1].astype(np.float64), self.fy[:, :1].astype(np.float64)
        fade_x, fade_y = (
            closed_form.gaussian_transfer(along_x**2, variance_px2),
            closed_form.gaussian_transfer(along_y**2, variance_px2),
        )
        result: NDArray[np.complex64] = to_single(np.exp(-2j * np.pi * x * along_x) * fade_x) * to_single(
            np.exp(-2j * np.pi * y * along_y) * fade_y
        )
        return result


@lru_cache(maxsize=64)
def _frequency_axes(grid: FrequencyGrid) -> _FrequencyAxes:
    by_nuisance = np.stack((-2j * np.pi * grid.fx, -2j * np.pi * grid.fy, -2 * np.pi**2 * (grid.fx**2 + grid.fy**2)))
    return _FrequencyAxes(to_single(grid.fx), to_single(grid.fy), to_single(by_nuisance))


def _rest_transfer(fx: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.ones_like(fx), np.zeros((0, *fx.shape), dtype=fx.dtype)
