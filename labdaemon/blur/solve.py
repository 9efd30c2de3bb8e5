"""Damped Gauss–Newton on patches: a few shape and motion parameters, and each channel's own light.

A pixel of channel c is L_c(x)·(1 − k_c·m(x; p)) with L_c = w0 + w1·x + w2·y (white and light gradient), k_c the
contrast of ink against paper and m the modelled darkness. Each channel's four numbers are eliminated from the normal
equations (variable projection), so that what is left is as small as the motion itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import lapack

from labdaemon.blur.mosaic import Planes
from labdaemon.blur.pixels import FloatArray

Model = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From parameters (k,) to darkness (n, h, w) and its derivatives (k, n, h, w).

Sums over pixels are taken in the derivatives' precision: single is a thousandth of the noise, and enough for a model of
few parameters that do not resemble each other. Everything small is in double.
"""

PLAIN = 1e-3
"""Damping up to which a short step means that the fit is over, and not that it has been held back."""

SHORT = 0.05
"""Step, px or px², up to which a model is linear enough for its result not to be looked at."""

TOLERANCE = 0.1
"""Step, in deviations, that is the last."""

SETTLE = 2
"""Iterations whose models still change the weights."""

SAME = 1e-5
"""Relative difference up to which two costs are the same."""


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
        (n, h, w) modelled values, DN; where a last step was taken without another look, to first order in it.
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
    scaled
        (n, k + 4, h·w) derivatives by the parameters and the light, over the pixels' standard deviations.
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
    scaled: FloatArray
    correlated: bool = False

    @property
    def gain(self) -> FloatArray:
        """(k, n, h, w) change of the parameters by a change of each pixel, DN⁻¹; carries any other error through."""
        k = len(self.p)
        own = self.scaled[:, :k] - self.light_part.transpose(0, 2, 1) @ self.scaled[:, k:]
        own *= np.sqrt(self.weight).reshape(len(own), 1, -1)
        result: FloatArray = (self.covariance @ own).swapaxes(0, 1).reshape(k, *self.weight.shape)
        return result

    @property
    def chi2(self) -> float:
        """Mean squared normalised residual."""
        return float(np.vdot(self.residual, self.residual)) / max(self.dof, 1)


def light_coordinates(planes: Planes) -> tuple[FloatArray, FloatArray]:
    """Positions scaled to −1..1 across the patch: (1, 1, w) and (1, h, 1)."""
    _, height, width = planes.values.shape
    return _from_side_to_side(width)[None, None, :], _from_side_to_side(height)[None, :, None]


@lru_cache(maxsize=256)
def _from_side_to_side(length: int) -> FloatArray:
    result: FloatArray = (2 * np.arange(length) + 1) / length - 1
    return result


def solve_light(planes: Planes, weight: FloatArray, dark: FloatArray) -> FloatArray:
    """Best light for a fixed darkness: linear least squares in w0, w1, w2 and the common contrast w0·k."""
    u, v = light_coordinates(planes)
    n = len(dark)
    columns = np.empty((n, 5, *dark.shape[1:]), dtype=dark.dtype)
    columns[:, 0], columns[:, 1], columns[:, 2] = 1.0, u, v
    np.negative(dark, out=columns[:, 3])
    columns[:, 4] = planes.values
    columns = columns.reshape(n, 5, -1)
    normal = ((columns[:, :4] * weight.reshape(n, 1, -1)) @ columns.transpose(0, 2, 1)).astype(np.float64)
    left = normal[:, :, :4]
    solution: FloatArray = np.linalg.solve(left + ridge(left, 1e-9), normal[:, :, 4:])[..., 0].astype(np.float64)
    solution[:, 3] /= np.where(np.abs(solution[:, 0]) > 1e-12, solution[:, 0], 1.0)
    return solution


def light_level(planes: Planes, light: FloatArray, dtype: Any = np.float64) -> FloatArray:
    """(n, h, w) values of bare paper under a light."""
    u, v = light_coordinates(planes)
    down = light[:, 0, None, None] + light[:, 2, None, None] * v
    across = light[:, 1, None, None] * u
    level: FloatArray = down.astype(dtype) + across.astype(dtype)
    return level


def ridge(normal: FloatArray, part: float) -> FloatArray:
    """A little on the diagonals, so that a lattice without a valid pixel does no harm."""
    trace = np.einsum("nii->n", normal)
    result = np.zeros(normal.shape)
    np.einsum("nii->ni", result)[:] = np.where(trace > 0, part * trace, 1.0)[:, None]
    return result


def render_light(planes: Planes, light: FloatArray, dark: FloatArray) -> FloatArray:
    """(n, h, w) values of a darkness under a light, in the darkness' precision."""
    result: FloatArray = _shade(light, dark)
    result *= light_level(planes, light, dark.dtype)
    return result


def _shade(light: FloatArray, dark: FloatArray) -> FloatArray:
    """(n, h, w) what is left of the paper's light."""
    result: FloatArray = dark * (-light[:, 3, None, None]).astype(dark.dtype)
    result += 1
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
    tolerance: float = TOLERANCE,
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
        Part of each standard deviation below which a step is the last.
    light
        (n, 4) light to start from; solved linearly if not given.

    Returns
    -------
    Solution
        The last step is still taken, but the model is not evaluated after it: steps shrink so fast that the next would
        be a hundredth of it.
    """
    p = bound(np.array(start, dtype=np.float64))
    dark, by_p = _look(model, p)
    y = planes.values.astype(by_p.dtype, copy=False)
    settle = 0 if light is not None else SETTLE
    if light is None:
        light = _first_light(planes, weights, y, dark)
    signal = render_light(planes, light, dark)
    weight = weights(signal)
    cost = _squares(y - signal, weight) + prior.cost(p)
    damping, converged = PLAIN, False
    for iteration in range(max_iterations):
        equations = _normal_equations(planes, y - signal, weight, light, dark, by_p, p, prior)
        if iteration > settle and damping <= PLAIN:
            trial = bound(p + equations.step(damping))
            short = np.abs(trial - p)
            # Short against the deviation alone may be long where something hardly shows.
            if np.max(short * equations.scale) < tolerance and np.max(short) < SHORT:
                return _carried(planes, y, weight, equations, prior, p, light, dark, by_p, trial - p)
        accepted = False
        for _ in range(8):
            trial = bound(p + equations.step(damping))
            step = trial - p
            trial_light = light + equations.light_step(step)
            trial_dark, trial_by_p = _look(model, trial)
            trial_signal = render_light(planes, trial_light, trial_dark)
            trial_cost = _squares(y - trial_signal, weight) + prior.cost(trial)
            if np.isfinite(trial_cost) and trial_cost <= cost * (1 + SAME) + 1e-12:
                accepted = True
                break
            damping = max(damping * 8, 1e-4)
        if not accepted:
            converged = True
            break
        small = bool(np.max(np.abs(step) * equations.scale) < tolerance) or cost - trial_cost < SAME * cost
        p, light, dark, by_p, signal, cost = trial, trial_light, trial_dark, trial_by_p, trial_signal, trial_cost
        damping = max(damping / 10, 1e-9)
        if iteration < settle:
            weight = weights(signal)
            cost = _squares(y - signal, weight) + prior.cost(p)
        elif small:
            converged = True
            break
    return _solution(weight, equations, prior, p, light, y - signal, signal, cost, converged)


def _first_light(
    planes: Planes, weights: Callable[[FloatArray], FloatArray], y: FloatArray, dark: FloatArray
) -> FloatArray:
    typical = float(np.mean(y[planes.valid])) if planes.valid.any() else 1.0
    return solve_light(planes, weights(np.maximum(y, 0.25 * typical)), dark)


def approach(
    planes: Planes,
    weights: Callable[[FloatArray], FloatArray],
    model: Model,
    start: FloatArray,
    prior: Prior,
    last: FloatArray,
    *,
    bound: Callable[[FloatArray], FloatArray] = lambda p: p,
    max_iterations: int = 6,
) -> tuple[FloatArray, FloatArray] | None:
    """Parameters and light near the best, for another fit to begin with; None where they are not soon reached.

    Plain Gauss–Newton steps under the weights of the first model; other parameters as for `solve`.

    Parameters
    ----------
    last
        (k,) step, in the parameters' own units, after which the model need not be looked at again.
    """
    p = bound(np.array(start, dtype=np.float64))
    light, weight = None, None
    for _ in range(max_iterations):
        dark, by_p = _look(model, p)
        y = planes.values.astype(by_p.dtype, copy=False)
        begun = light is not None
        if light is None:
            light = _first_light(planes, weights, y, dark)
        signal = render_light(planes, light, dark)
        if weight is None:
            weight = weights(signal)
        equations = _normal_equations(planes, y - signal, weight, light, dark, by_p, p, prior)
        there = bound(p + equations.step(0.0))
        step = there - p
        if not np.all(np.isfinite(step)):
            break
        p, light = there, light + equations.light_step(step)
        if begun and np.all(np.abs(step) < last):
            return p, light
    return None


def one_step(
    planes: Planes,
    weights: Callable[[FloatArray], FloatArray],
    model: Model,
    start: FloatArray,
    prior: Prior,
    light: FloatArray,
) -> Solution:
    """A single Gauss–Newton step from where the fit is all but converged; parameters as for `solve`."""
    dark, by_p = _look(model, start)
    y = planes.values.astype(by_p.dtype, copy=False)
    signal = render_light(planes, light, dark)
    weight = weights(signal)
    equations = _normal_equations(planes, y - signal, weight, light, dark, by_p, start, prior)
    return _carried(planes, y, weight, equations, prior, start, light, dark, by_p, equations.step(0.0))


def _look(model: Model, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    dark, by_p = model(p)
    return dark.astype(by_p.dtype, copy=False), by_p


def restricted(
    free: Solution, known: Prior, p: FloatArray, step: FloatArray, slope: FloatArray, prior: Prior
) -> Solution:
    """The solution under fewer, curved parameters, without another look at the picture.

    Parameters
    ----------
    free, known
        A solution and the prior that it was fitted with.
    p
        (m,) the new parameters, best to first order.
    step
        (k,) from the old solution to where they are.
    slope
        (k, m) derivatives of the old parameters by the new.
    prior
        On the new ones.
    """
    k = len(free.p)
    light_step = -free.light_part @ step
    change = step @ free.scaled[:, :k] + (light_step[:, None] @ free.scaled[:, k:])[:, 0]
    change = change.reshape(free.signal.shape)
    root = np.sqrt(free.weight)
    residual = free.residual - change
    signal = free.signal + np.divide(change, root, out=np.zeros_like(root), where=root > 0)
    information = slope.T @ (_inverse_scaled(free.covariance) - known.precision) @ slope + prior.precision
    covariance = _inverse_scaled(information)
    return Solution(
        p,
        covariance,
        free.light + light_step,
        residual,
        signal,
        float(np.vdot(residual, residual)) + prior.cost(p),
        free.dof + k - len(p),
        free.converged,
        free.weight,
        covariance @ prior.precision @ covariance,
        free.light_part @ slope,
        np.concatenate((slope.T.astype(free.scaled.dtype) @ free.scaled[:, :k], free.scaled[:, k:]), axis=1),
    )


def _squares(residual: FloatArray, weight: FloatArray) -> float:
    """Weighted sum of squares."""
    return float(np.vdot(residual * weight, residual))


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations with each lattice's light eliminated."""

    reduced: FloatArray
    right: FloatArray
    inner: FloatArray
    scale: FloatArray
    scaled: FloatArray

    def step(self, damping: float) -> FloatArray:
        """Change of the parameters, with the diagonal raised by a factor 1 + damping."""
        damped, right = self.reduced / (self.scale[:, None] * self.scale), self.right / self.scale
        damped.flat[:: len(damped) + 1] += damping
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
    residual: FloatArray,
    weight: FloatArray,
    light: FloatArray,
    dark: FloatArray,
    by_p: FloatArray,
    p: FloatArray,
    prior: Prior,
) -> _Equations:
    n, k = len(light), len(p)
    root = np.sqrt(weight)
    columns = derivatives(planes, light, dark, by_p, residual)
    columns *= root[:, None]
    columns = columns.reshape(n, k + 5, -1)
    products = (columns @ columns.transpose(0, 2, 1)).astype(np.float64)
    normal, gradient = products[:, :-1, :-1], products[:, :-1, -1]
    inner = np.linalg.solve(
        normal[:, k:, k:] + ridge(normal[:, k:, k:], 1e-12),
        np.concatenate((normal[:, k:, :k], gradient[:, k:, None]), axis=2),
    )
    reduced = (normal[:, :k, :k] - normal[:, :k, k:] @ inner[:, :, :k]).sum(axis=0) + prior.precision
    right = (gradient[:, :k] - (normal[:, :k, k:] @ inner[:, :, k:])[..., 0]).sum(axis=0)
    right = right - prior.precision @ (p - prior.mean)
    scale = np.sqrt(np.maximum(np.diag(reduced), 1e-30))
    return _Equations(reduced, right, inner.astype(np.float64), scale, columns[:, :-1])


def derivatives(
    planes: Planes, light: FloatArray, dark: FloatArray, by_p: FloatArray, residual: FloatArray | None = None
) -> FloatArray:
    """(n, k + 4, h, w) derivatives of the values by the parameters and each lattice's own light; last the residual."""
    u, v = light_coordinates(planes)
    k, dtype = len(by_p), by_p.dtype
    columns = np.empty((len(light), k + 4 + (residual is not None), *dark.shape[1:]), dtype=dtype)
    level = light_level(planes, light, dtype)
    shade = _shade(light, dark)
    depth = level * (-light[:, 3, None, None]).astype(dtype)
    np.multiply(by_p.swapaxes(0, 1), depth[:, None], out=columns[:, :k])
    columns[:, k] = shade
    np.multiply(shade, u.astype(dtype), out=columns[:, k + 1])
    np.multiply(shade, v.astype(dtype), out=columns[:, k + 2])
    np.multiply(-level, dark, out=columns[:, k + 3])
    if residual is not None:
        columns[:, -1] = residual
    return columns


def _carried(
    planes: Planes,
    y: FloatArray,
    weight: FloatArray,
    equations: _Equations,
    prior: Prior,
    p: FloatArray,
    light: FloatArray,
    dark: FloatArray,
    by_p: FloatArray,
    step: FloatArray,
) -> Solution:
    """The solution a last step away, without another look at the model."""
    there, light = p + step, light + equations.light_step(step)
    signal = render_light(planes, light, dark + np.tensordot(step.astype(by_p.dtype), by_p, axes=1))
    cost = _squares(y - signal, weight) + prior.cost(there)
    return _solution(weight, equations, prior, there, light, y - signal, signal, cost, True)


def _solution(
    weight: FloatArray,
    equations: _Equations,
    prior: Prior,
    p: FloatArray,
    light: FloatArray,
    residual: FloatArray,
    signal: FloatArray,
    cost: float,
    converged: bool,
) -> Solution:
    k = len(p)
    covariance = _inverse_scaled(equations.reduced)
    dof = int(np.count_nonzero(weight)) - k - 4 * int(np.count_nonzero(weight.any(axis=(1, 2))))
    prior_part = covariance @ prior.precision @ covariance
    light_part = equations.inner[:, :, :k].copy()
    return Solution(
        p,
        covariance,
        light,
        (residual * np.sqrt(weight)).astype(np.float64),
        signal.astype(np.float64),
        cost,
        dof,
        converged,
        weight.astype(np.float64),
        prior_part,
        light_part,
        equations.scaled,
    )


def _inverse_scaled(matrix: FloatArray) -> FloatArray:
    """Inverse of a non-negative matrix, scaled first; directions that nothing determines stay out."""
    scale = 1 / np.sqrt(np.maximum(matrix.diagonal(), 1e-30))
    both = scale[:, None] * scale
    factor, singular = lapack.dpotrf(matrix * both, lower=1, clean=1)
    if singular:
        inverse = np.linalg.pinv(matrix * both, rcond=1e-14, hermitian=True)
    else:
        root = lapack.dtrtri(factor, lower=1)[0]
        inverse = root.T @ root
    result: FloatArray = inverse * both
    return result
