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

PLAIN = 1e-3
"""Damping up to which a short step means that the fit is over, and not that it has been held back."""

SHORT = 0.05
"""Step, px or px², up to which a model is linear enough for its result not to be looked at."""


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
    weighted
        (n, k + 4, h·w) derivatives by the parameters and the light, times the weights.
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
    weighted: FloatArray
    correlated: bool = False

    @property
    def gain(self) -> FloatArray:
        """(k, n, h, w) change of the parameters by a change of each pixel, DN⁻¹; carries any other error through."""
        k = len(self.p)
        own = self.weighted[:, :k] - self.light_part.transpose(0, 2, 1) @ self.weighted[:, k:]
        result: FloatArray = (self.covariance @ own).swapaxes(0, 1).reshape(k, *self.weight.shape)
        return result

    @property
    def chi2(self) -> float:
        """Mean squared normalised residual."""
        return float(np.sum(self.residual**2) / max(self.dof, 1))


def light_coordinates(planes: Planes) -> tuple[FloatArray, FloatArray]:
    """Positions scaled to −1..1 across the patch: (1, 1, w) and (1, h, 1)."""
    shape = planes.values.shape
    _, height, width = shape
    u = (2 * np.arange(width) + 1) / width - 1
    v = (2 * np.arange(height) + 1) / height - 1
    return u[None, None, :], v[None, :, None]


def solve_light(planes: Planes, weight: FloatArray, dark: FloatArray) -> FloatArray:
    """Best light for a fixed darkness: linear least squares in w0, w1, w2 and the common contrast w0·k."""
    u, v = light_coordinates(planes)
    n = planes.values.shape[0]
    full = dark.shape
    columns = (np.ones(full), np.broadcast_to(u, full), np.broadcast_to(v, full), -dark)
    design = np.stack(columns, axis=1).reshape(n, 4, -1)
    w = weight.reshape(n, -1)
    normal = (design * w[:, None]) @ design.transpose(0, 2, 1)
    normal += ridge(normal, 1e-9)
    right = (design * w[:, None]) @ planes.values.reshape(n, -1, 1)
    solution: FloatArray = np.linalg.solve(normal, right)[..., 0].astype(np.float64)
    solution[:, 3] /= np.where(np.abs(solution[:, 0]) > 1e-12, solution[:, 0], 1.0)
    return solution


def light_level(planes: Planes, light: FloatArray) -> FloatArray:
    """(n, h, w) values of bare paper under a light."""
    u, v = light_coordinates(planes)
    level: FloatArray = (light[:, 0, None, None] + light[:, 2, None, None] * v) + light[:, 1, None, None] * u
    return level


def ridge(normal: FloatArray, part: float) -> FloatArray:
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
    tolerance: float = 0.1,
    light: FloatArray | None = None,
) -> Solution:
    """Fit the model to the planes.

    Parameters
    ----------
    weights
        From modelled values (n, h, w) to inverse variances, 0 where masked. Frozen after the second iteration
        (at once when the light is given), so that the weights' own dependence on the model does not bias it.
    model
        Darkness and derivatives.
    start
        (k,) first parameters.
    prior
        On the parameters.
    bound
        Brings parameters back to where the model is defined.
    tolerance
        Stops when the step falls below this part of each standard deviation. That last step is still taken, but the
        model is not evaluated after it: steps shrink so fast that the next would be a hundredth of it.
    light
        (n, 4) light to start from; solved linearly if not given.
    """
    fresh = light is None
    y = planes.values
    p = bound(np.array(start, dtype=np.float64))
    dark, by_p = model(p)
    if light is None:
        typical = float(np.median(y[planes.valid])) if planes.valid.any() else 1.0
        light = solve_light(planes, weights(np.maximum(y, 0.25 * typical)), dark)
    signal = render_light(planes, light, dark)
    weight = weights(signal)
    cost = float(np.sum(weight * (y - signal) ** 2)) + prior.cost(p)
    # Weights that follow the model for ever would bias it.
    settle = 2 if fresh else 0
    damping, converged = PLAIN, False
    for iteration in range(max_iterations):
        equations = _normal_equations(planes, weight, light, dark, by_p, p, prior)
        if iteration > settle and damping <= PLAIN:
            trial = bound(p + equations.step(damping))
            short = np.abs(trial - p)
            # Short against the deviation alone may be long where something hardly shows.
            if np.max(short * equations.scale) < tolerance and np.max(short) < SHORT:
                light = light + equations.light_step(trial - p)
                return _solution(planes, weight, equations, prior, trial, light, signal, cost, True)
        accepted = False
        for _ in range(8):
            trial = bound(p + equations.step(damping))
            step = trial - p
            trial_light = light + equations.light_step(step)
            trial_dark, trial_by_p = model(trial)
            trial_signal = render_light(planes, trial_light, trial_dark)
            trial_cost = float(np.sum(weight * (y - trial_signal) ** 2)) + prior.cost(trial)
            if np.isfinite(trial_cost) and trial_cost <= cost * (1 + 1e-6) + 1e-12:
                accepted = True
                break
            damping = max(damping * 8, 1e-4)
        if not accepted:
            converged = True
            break
        small = bool(np.max(np.abs(step) * equations.scale) < tolerance) or cost - trial_cost < 1e-5 * cost
        p, light, dark, by_p, signal, cost = trial, trial_light, trial_dark, trial_by_p, trial_signal, trial_cost
        damping = max(damping / 10, 1e-9)
        if iteration < settle:
            weight = weights(signal)
            cost = float(np.sum(weight * (y - signal) ** 2)) + prior.cost(p)
        elif small:
            converged = True
            break
    return _solution(planes, weight, equations, prior, p, light, signal, cost, converged)


def one_step(
    planes: Planes,
    weights: Callable[[FloatArray], FloatArray],
    model: Model,
    start: FloatArray,
    prior: Prior,
    light: FloatArray,
) -> Solution:
    """A single Gauss–Newton step from where the fit is all but converged; parameters as for `solve`."""
    dark, by_p = model(start)
    signal = render_light(planes, light, dark)
    weight = weights(signal)
    equations = _normal_equations(planes, weight, light, dark, by_p, start, prior)
    step = equations.step(0.0)
    p, light = start + step, light + equations.light_step(step)
    cost = float(np.sum(weight * (planes.values - signal) ** 2)) + prior.cost(start)
    return _solution(planes, weight, equations, prior, p, light, signal, cost, True)


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations with each lattice's light eliminated."""

    reduced: FloatArray
    right: FloatArray
    inner: FloatArray
    scale: FloatArray
    weighted: FloatArray

    def step(self, damping: float) -> FloatArray:
        """Change of the parameters, with the diagonal raised by a factor 1 + damping."""
        scaled = self.reduced / np.outer(self.scale, self.scale)
        damped, right = scaled + damping * np.eye(len(scaled)), self.right / self.scale
        try:
            step = np.linalg.solve(damped, right)
        except np.linalg.LinAlgError:  # something does not show at all: it stays
            step = np.linalg.lstsq(damped, right, rcond=1e-12)[0]
        result: FloatArray = step.astype(np.float64) / self.scale
        return result

    def light_step(self, step: FloatArray) -> FloatArray:
        """(n, 4) change of the light that goes with a change of the parameters."""
        k = len(self.right)
        result: FloatArray = self.inner[:, :, k] - self.inner[:, :, :k] @ step
        return result


def _normal_equations(
    planes: Planes,
    weight: FloatArray,
    light: FloatArray,
    dark: FloatArray,
    by_p: FloatArray,
    p: FloatArray,
    prior: Prior,
) -> _Equations:
    n, k = len(light), len(p)
    columns = derivatives(planes, light, dark, by_p)
    flat = columns.reshape(n, k + 4, -1)
    weighted = flat * weight.reshape(n, 1, -1)
    normal = weighted @ flat.transpose(0, 2, 1)
    residual = planes.values - render_light(planes, light, dark)
    gradient = (weighted @ residual.reshape(n, -1, 1))[..., 0]
    ll = normal[:, k:, k:]
    inner = np.linalg.solve(ll + ridge(ll, 1e-12), np.concatenate((normal[:, k:, :k], gradient[:, k:, None]), axis=2))
    reduced = (normal[:, :k, :k] - normal[:, :k, k:] @ inner[:, :, :k]).sum(axis=0) + prior.precision
    right = (gradient[:, :k] - (normal[:, :k, k:] @ inner[:, :, k:])[..., 0]).sum(axis=0)
    right = right - prior.precision @ (p - prior.mean)
    scale = np.sqrt(np.maximum(np.diag(reduced), 1e-30))
    return _Equations(reduced, right, inner.astype(np.float64), scale, weighted)


def derivatives(planes: Planes, light: FloatArray, dark: FloatArray, by_p: FloatArray) -> FloatArray:
    """(n, k + 4, h, w) derivatives of the values by the parameters and by each lattice's own light."""
    u, v = light_coordinates(planes)
    k = len(by_p)
    level = light_level(planes, light)
    contrast = light[:, 3, None, None]
    shade = 1 - contrast * dark
    columns = np.empty((len(light), k + 4, *dark.shape[1:]))
    np.multiply(by_p.swapaxes(0, 1), -(level * contrast)[:, None], out=columns[:, :k])
    columns[:, k], columns[:, k + 1], columns[:, k + 2] = shade, shade * u, shade * v
    columns[:, k + 3] = -level * dark
    return columns


def _solution(
    planes: Planes,
    weight: FloatArray,
    equations: _Equations,
    prior: Prior,
    p: FloatArray,
    light: FloatArray,
    signal: FloatArray,
    cost: float,
    converged: bool,
) -> Solution:
    k, scale = len(p), equations.scale
    scaled = equations.reduced / np.outer(scale, scale)
    covariance = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) / np.outer(scale, scale)
    dof = int(np.count_nonzero(weight)) - k - 4 * int(np.count_nonzero(weight.any(axis=(1, 2))))
    residual = (planes.values - signal) * np.sqrt(weight)
    prior_part = covariance @ prior.precision @ covariance
    light_part = equations.inner[:, :, :k].copy()
    return Solution(
        p, covariance, light, residual, signal, cost, dof, converged, weight, prior_part, light_part, equations.weighted
    )
