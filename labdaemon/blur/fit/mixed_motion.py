"""Whether all parts of a textured patch move in the same way."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.patch.colour_planes import merge_planes
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.smear.errors_in_variables import CorrectedEquations, TextureFit
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.texture_settings import TEXTURE


def motion_varies(problem: FitProblem, fit: TextureFit, path: FloatArray) -> bool:
    """Whether strips or ninths of the box ask for another motion than the whole of it.

    Each part's own change of place and motion follows from its share of the equations, without another fit. It counts
    when it exceeds both its standard deviation and what the model's own faults could explain.

    Parameters
    ----------
    problem, fit
        The patch and its fit by the second moment.
    path
        (2,) direction of the motion.
    """
    here, k = fit.equations, problem.shape_count
    moment = fit.p[3 + k :]
    c, s = path / max(float(np.hypot(*path)), 1e-12)
    ray = np.array([c * c, 2 * c * s, s * s])
    square = max(float(ray @ moment), 0.0)
    least = max(TEXTURE.mixed_fraction * square, TEXTURE.mixed_least_px2)
    jacobian, residual = merge_planes(problem.planes, here.jacobian), merge_planes(problem.planes, here.residual)
    for rows, columns in _parts(residual.shape):
        change, sd = _change_of_part(here, jacobian[:, rows, columns], residual[rows, columns], k, ray)
        if abs(change) > max(least, TEXTURE.mixed_sds * sd):
            return True
    return False


def _parts(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    height, width = shape
    whole = (slice(0, height), slice(0, width))
    down = [slice(height * i // 3, height * (i + 1) // 3) for i in range(3)]
    across = [slice(width * i // 3, width * (i + 1) // 3) for i in range(3)]
    return [
        *((rows, whole[1]) for rows in down),
        *((whole[0], columns) for columns in across),
        *((rows, columns) for rows in down for columns in across),
    ]


def _change_of_part(
    here: CorrectedEquations, jacobian: FloatArray, residual: FloatArray, k: int, ray: FloatArray
) -> tuple[float, float]:
    """Change of the squared amplitude along `ray` that one part of the box asks for, and its sd; px²."""
    pick = [0, 1, 3 + k, 4 + k, 5 + k]
    own = jacobian[pick].reshape(len(pick), -1)
    part = residual.size / max(here.residual.size, 1)
    scale = here.pixels * part * here.noise_power * here.template_share
    score = own @ residual.ravel() + 0.5 * scale * here.moments.through_slopes[pick]
    raw = own @ own.T
    information = raw - scale * here.moments.bends[np.ix_(pick, pick)]
    unit = np.sqrt(np.maximum(np.diag(raw), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(unit, unit))
    good = values > TEXTURE.part_share
    if not good.any():
        return 0.0, np.inf
    inverse = (vectors[:, good] / values[good]) @ vectors[:, good].T / np.outer(unit, unit)
    target = np.concatenate((np.zeros(2), ray))
    power = max(float(np.vdot(residual, residual)) / max(residual.size - 5, 1), here.noise_power * here.widening)
    variance = float(target @ inverse @ raw @ inverse @ target) * power
    return float(target @ inverse @ score), float(np.sqrt(max(variance, 0.0)))
