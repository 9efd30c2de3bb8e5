"""Damped Gauss–Newton on patches: a few shape and motion parameters, and each channel's own light.

A pixel of channel c is L_c(x)·(1 − k_c·m(x; p)) with L_c = w0 + w1·x + w2·y (white and light gradient), k_c the
contrast of ink against paper and m the modelled darkness. Each channel's four numbers are eliminated from the normal
equations (variable projection), so that what is left is as small as the motion itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.mosaic import Planes
from labdaemon.blur.pixels import FloatArray

Model = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From parameters (k,) to darkness (n, h, w) and its derivatives (k, n, h, w)."""


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of the parameters beforehand: independent of the picture."""

    mean: FloatArray
    precision: FloatArray

    def cost(self, p: FloatArray) -> float:
        """Squared distance from the mean in units of the prior's own spread."""
        d = p - self.mean
        return float(d @ self.precision @ d)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the fit ended.

    Attributes
    ----------
    p, covariance
        (k,) and (k, k) of the shape and motion parameters, light eliminated.
    light
        (n, 4) w0, w1, w2, k of each lattice; x and y run over −1..1 across the patch.
    residual
        (n, h, w) normalised residuals, 0 where masked.
    signal
        (n, h, w) modelled values, DN.
    cost
        Sum of squares, prior included.
    dof
        Degrees of freedom.
    converged
        False when the iterations ran out.
    weight
        (n, h, w) inverse variances in use, 0 where masked.
    prior_part
        (k, k) what the prior's own uncertainty contributes to the covariance.
    light_part
        (n, 4, k) how each lattice's light follows the parameters (its negative, that is).
    gain
        (k, n, h, w) change of the parameters by a change of each pixel, DN⁻¹; carries any other error through.
    correlated
        Whether the covariance already accounts for noise that neighbours share.
    """

    p: FloatArray
    covariance: FloatArray
    light: FloatArray
    residual: FloatArray
    signal: FloatArray
    cost: float
    dof: int
    converged: bool
    weight: FloatArray
    prior_part: FloatArray
    light_part: FloatArray
    gain: FloatArray
    correlated: bool = False

    @property
    def chi2(self) -> float:
        """Mean squared normalised residual."""
        return float(np.sum(self.residual**2) / max(self.dof, 1))


def light_coordinates(planes: Planes) -> tuple[FloatArray, FloatArray]:
    """Positions scaled to −1..1 across the patch, (n, h, w) each."""
    shape = planes.values.shape
    _, height, width = shape
    u = (2 * np.arange(width) + 1) / width - 1
    v = (2 * np.arange(height) + 1) / height - 1
    return np.broadcast_to(u, shape), np.broadcast_to(v[:, None], shape)


def solve_light(planes: Planes, weight: FloatArray, dark: FloatArray) -> FloatArray:
    """Best light for a fixed darkness: linear least squares in w0, w1, w2 and the common contrast w0·k."""
    u, v = light_coordinates(planes)
    n = planes.values.shape[0]
    design = np.stack((np.ones_like(dark), u, v, -dark), axis=1).reshape(n, 4, -1)
    w = weight.reshape(n, -1)
    normal = (design * w[:, None]) @ design.transpose(0, 2, 1)
    normal += _ridge(normal, 1e-9)
    right = (design * w[:, None]) @ planes.values.reshape(n, -1, 1)
    solution: FloatArray = np.linalg.solve(normal, right)[..., 0].astype(np.float64)
    solution[:, 3] /= np.where(np.abs(solution[:, 0]) > 1e-12, solution[:, 0], 1.0)
    return solution


def light_level(planes: Planes, light: FloatArray) -> FloatArray:
    """(n, h, w) values of bare paper under a light."""
    u, v = light_coordinates(planes)
    level: FloatArray = light[:, 0, None, None] + light[:, 1, None, None] * u + light[:, 2, None, None] * v
    return level


def _ridge(normal: FloatArray, part: float) -> FloatArray:
    """A little on the diagonals, so that a lattice without a valid pixel does no harm."""
    trace = np.trace(normal, axis1=1, axis2=2)
    result: FloatArray = np.where(trace > 0, part * trace, 1.0)[:, None, None] * np.eye(normal.shape[-1])
    return result


def render_light(planes: Planes, light: FloatArray, dark: FloatArray) -> FloatArray:
    """(n, h, w) values of a darkness under a light."""
    result: FloatArray = light_level(planes, light) * (1 - light[:, 3, None, None] * dark)
    return result


def solve(
    planes: Planes,
    weights: Callable[[FloatArray], FloatArray],
    model: Model,
    start: FloatArray,
    prior: Prior,
    *,
    bound: Callable[[FloatArray], FloatArray] = lambda p: p,
    max_iterations: int = 30,
    tolerance: float = 1e-3,
    light: FloatArray | None = None,
) -> Solution:
    """Fit the model to the planes.

    Parameters
    ----------
    weights
        From modelled values (n, h, w) to inverse variances, 0 where masked. Frozen after the second iteration, so that
        the weights' own dependence on the model does not bias it.
    model
        Darkness and derivatives.
    start
        (k,) first parameters.
    prior
        On the parameters.
    bound
        Brings parameters back to where the model is defined.
    tolerance
        Stops when the step falls below this part of each standard deviation.
    light
        (n, 4) light to start from; solved linearly if not given.
    """
    n = planes.values.shape[0]
    u, v = light_coordinates(planes)
    y = planes.values
    p = bound(np.array(start, dtype=np.float64))
    dark, by_p = model(p)
    k = len(p)
    signal = np.broadcast_to(np.median(y[planes.valid]) if planes.valid.any() else 1.0, y.shape).astype(np.float64)
    if light is None:
        weight = weights(np.maximum(y, 0.25 * signal))
        light = solve_light(planes, weight, dark)
    size = k + 4
    identity = np.eye(k)

    def predict(light: FloatArray, dark: FloatArray) -> tuple[FloatArray, FloatArray]:
        level = light[:, 0, None, None] + light[:, 1, None, None] * u + light[:, 2, None, None] * v
        return level, level * (1 - light[:, 3, None, None] * dark)

    level, signal = predict(light, dark)
    weight = weights(signal)
    residual = y - signal
    cost = float(np.sum(weight * residual**2)) + prior.cost(p)
    damping, converged = 1e-3, False
    columns = np.empty((n, size, *y.shape[1:]))
    for iteration in range(max_iterations):
        contrast = light[:, 3, None, None]
        columns[:, :k] = np.moveaxis(by_p, 0, 1) * (-(level * contrast))[:, None]
        shade = 1 - contrast * dark
        columns[:, k], columns[:, k + 1], columns[:, k + 2] = shade, shade * u, shade * v
        columns[:, k + 3] = -level * dark
        flat = columns.reshape(n, size, -1)
        weighted = flat * weight.reshape(n, 1, -1)
        normal = weighted @ flat.transpose(0, 2, 1)
        gradient = (weighted @ residual.reshape(n, -1, 1))[..., 0]
        ll = normal[:, k:, k:]
        ll = ll + _ridge(ll, 1e-12)
        inner = np.linalg.solve(ll, np.concatenate((normal[:, k:, :k], gradient[:, k:, None]), axis=2))
        reduced = (normal[:, :k, :k] - normal[:, :k, k:] @ inner[:, :, :k]).sum(axis=0) + prior.precision
        right = (gradient[:, :k] - (normal[:, :k, k:] @ inner[:, :, k:])[..., 0]).sum(axis=0)
        right = right - prior.precision @ (p - prior.mean)
        scale = np.sqrt(np.maximum(np.diag(reduced), 1e-30))
        scaled = reduced / np.outer(scale, scale)
        accepted = False
        for _ in range(8):
            step = np.linalg.solve(scaled + damping * identity, right / scale) / scale
            trial = bound(p + step)
            step = trial - p
            trial_light = light + inner[:, :, k] - inner[:, :, :k] @ step
            trial_dark, trial_by_p = model(trial)
            trial_level, trial_signal = predict(trial_light, trial_dark)
            trial_residual = y - trial_signal
            trial_cost = float(np.sum(weight * trial_residual**2)) + prior.cost(trial)
            if np.isfinite(trial_cost) and trial_cost <= cost * (1 + 1e-12) + 1e-12:
                accepted = True
                break
            damping = max(damping * 8, 1e-4)
        if not accepted:
            converged = True
            break
        small = bool(np.max(np.abs(step) * scale) < tolerance) or cost - trial_cost < 1e-4 * tolerance * cost
        p, light, dark, by_p = trial, trial_light, trial_dark, trial_by_p
        level, signal, residual, cost = trial_level, trial_signal, trial_residual, trial_cost
        damping = max(damping / 10, 1e-9)
        if iteration < 2:
            weight = weights(signal)
            cost = float(np.sum(weight * residual**2)) + prior.cost(p)
        elif small:
            converged = True
            break
    covariance = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) / np.outer(scale, scale)
    through_light = np.einsum("nka,nap->nkp", inner[:, :, :k].transpose(0, 2, 1), weighted[:, k:])
    gain = np.einsum("kj,njp->knp", covariance, weighted[:, :k] - through_light).reshape(k, *y.shape)
    normalised = residual * np.sqrt(weight)
    dof = int(np.count_nonzero(weight)) - k - 4 * int(np.count_nonzero(weight.any(axis=(1, 2))))
    prior_part = covariance @ prior.precision @ covariance
    light_part: FloatArray = inner[:, :, :k].astype(np.float64)
    return Solution(
        p, covariance, light, normalised, signal, cost, dof, converged, weight, prior_part, light_part, gain
    )
