"""The noise of a sharp picture that is used as a target: what it biases, taken off again.

The blur smooths the picture's own noise, the later frame has other noise, and least squares asks for more blur to
smooth it away. To first order the shift of the parameters is −C·½·∂/∂p of the noise's part in the cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from labdaemon.blur import shapes
from labdaemon.blur.model import Motion, Setting
from labdaemon.blur.pixels import FloatArray
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import Solution
from labdaemon.blur.texture import Texture


def without_template_noise(sharp: SharpTarget, setting: Setting, solution: Solution, motion: Motion | None) -> Solution:
    """The solution, corrected for the noise of the sharp picture where that was the target; else as it is."""
    form = sharp.form
    if not isinstance(form, Texture):
        return solution
    k = setting.shapes
    passed = _passed(setting, form, motion, k)
    slopes = _slopes(passed, solution.p, [2, *range(3 + k, len(solution.p))])
    # The sharp picture's noise, seen through the same light, is that of the blurred one.
    power = np.sum(solution.weight * sharp.noise.variance(solution.signal), axis=(1, 2)) / form.frames
    contrast = np.where(power > 0, solution.light[:, 3], 1.0)
    by_contrast = power / contrast * passed(solution.p)
    gradient = slopes * float(np.sum(power)) / 2 - by_contrast @ solution.light_part[:, 3]
    return replace(solution, p=solution.p + solution.covariance @ gradient)


def _passed(setting: Setting, form: Texture, motion: Motion | None, k: int) -> Callable[[FloatArray], float]:
    """Part of white noise's power that a blur lets through, within the band that the samples fill."""
    grid = setting.grid
    f2 = grid.fx**2 + grid.fy**2
    band = np.abs(grid.fx) + np.abs(grid.fy) < 0.5 if len(form.channel) > 1 else np.ones(f2.shape, dtype=bool)

    def passed(p: FloatArray) -> float:
        whole = shapes.gaussian(f2, float(p[2])).astype(np.complex128)
        if motion is not None:
            whole = whole * motion(grid.fx, grid.fy, p[3 + k :])[0]
        return float(np.mean(np.abs(whole[band]) ** 2))

    return passed


def _slopes(function: Callable[[FloatArray], float], at: FloatArray, which: list[int]) -> FloatArray:
    result = np.zeros(len(at))
    for index in which:
        step = np.zeros(len(at))
        step[index] = 1e-4
        result[index] = (function(at + step) - function(at - step)) / 2e-4
    return result
