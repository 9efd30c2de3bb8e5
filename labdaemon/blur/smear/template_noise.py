"""Bias of a fit whose template is a noisy image, and its correction.

The blur smooths the image's own noise, the later frame has other noise, and least squares asks for more blur to
smooth it away. To first order the shift of the parameters is −C·½·∂/∂p of the noise's part in the cost.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.spectra import closed_form


def correct_template_noise_bias(
    sharp: SharpTarget, problem: FitProblem, solution: Solution, motion: TransferFunction | None
) -> Solution:
    """The solution, corrected for the noise of the sharp image where that was the target; else as it is."""
    form = sharp.form
    if not isinstance(form, TexturedPatch):
        return solution
    k = problem.shape_count
    through, slopes, bends = _transmitted_power(
        problem, form, motion, solution.p, [2, *range(3 + k, len(solution.p))], k
    )
    # Both images' noise is in the residuals, the sharp one's as far as the blur lets it through. What a noise model
    # says would count the sensor's own pattern, too, which is the same in both.
    power = np.sum(solution.residual**2, axis=(1, 2)) / (form.frames + through)
    contrast = np.where(power > 0, solution.light[:, 3], 1.0)
    total = float(np.sum(power))
    gradient = slopes * total / 2 - (power / contrast * through) @ solution.light_jacobian[:, 3]
    step = solution.covariance @ gradient
    if motion is None:
        # A noisy image changes more with its blur than the target does: that part of the derivatives is noise. At
        # rest it is small; through a motion it is not, and more than the first order would be needed.
        step = np.linalg.solve(np.eye(len(step)) - total * solution.covariance @ bends, step)
    return replace(solution, p=solution.p + step)


def _transmitted_power(
    problem: FitProblem, form: TexturedPatch, motion: TransferFunction | None, at: FloatArray, which: list[int], k: int
) -> tuple[float, FloatArray, FloatArray]:
    """What a blur lets through of white noise's power, within the band that the samples fill.

    Returns
    -------
    through, slopes, bends
        Its part; (m,) derivatives by the parameters; (m, m) mean products of the transfer function's own derivatives.
        The last two are 0 but for the parameters `which`.
    """
    grid = problem.grid
    band = np.abs(grid.fx) + np.abs(grid.fy) < 0.5 if len(form.channel) > 1 else np.ones(grid.fx.shape, dtype=bool)
    fx, fy = grid.fx[band], grid.fy[band]

    def transfer(p: FloatArray) -> ComplexArray:
        whole = closed_form.gaussian_transfer(fx**2 + fy**2, float(p[2])).astype(np.complex128)
        return whole if motion is None else whole * motion(fx, fy, p[3 + k :])[0]

    middle = transfer(at)
    change = np.zeros((len(at), len(middle)), dtype=np.complex128)
    for index in which:
        step = np.zeros(len(at))
        step[index] = 1e-4
        change[index] = (transfer(at + step) - transfer(at - step)) / 2e-4
    count = len(middle)
    slopes = 2 * np.real(change @ np.conj(middle)) / count
    return float(np.mean(np.abs(middle) ** 2)), slopes, np.real(change @ np.conj(change.T)) / count
