"""Damped Gauss–Newton on patches: a few shape and motion parameters, and each channel's own light.

A pixel of channel c is L_c(x)·(1 − k_c·m(x; p)) with L_c = w0 + w1·x + w2·y (white and light gradient), k_c the
contrast of ink against paper and m the modelled darkness. Each channel's four numbers are eliminated from the normal
equations (variable projection), so that what is left is as small as the motion itself.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.blur.patch.light import render_light, solve_light
from labdaemon.blur.patch.mosaic import Planes
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.solver.normal import (
    Prior,
    Solution,
    carried,
    inverse_scaled,
    normal_equations,
    solution_at,
    squares,
)

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
    cost = squares(y - signal, weight) + prior.cost(p)
    damping, converged = PLAIN, False
    for iteration in range(max_iterations):
        equations = normal_equations(planes, y - signal, weight, light, dark, by_p, p, prior)
        if iteration > settle and damping <= PLAIN:
            trial = bound(p + equations.step(damping))
            short = np.abs(trial - p)
            # Short against the deviation alone may be long where something hardly shows.
            if np.max(short * equations.scale) < tolerance and np.max(short) < SHORT:
                return carried(planes, y, weight, equations, prior, p, light, dark, by_p, trial - p)
        accepted = False
        for _ in range(8):
            trial = bound(p + equations.step(damping))
            step = trial - p
            trial_light = light + equations.light_step(step)
            trial_dark, trial_by_p = _look(model, trial)
            trial_signal = render_light(planes, trial_light, trial_dark)
            trial_cost = squares(y - trial_signal, weight) + prior.cost(trial)
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
            cost = squares(y - signal, weight) + prior.cost(p)
        elif small:
            converged = True
            break
    return solution_at(weight, equations, prior, p, light, y - signal, signal, cost, converged)


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
        equations = normal_equations(planes, y - signal, weight, light, dark, by_p, p, prior)
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
    equations = normal_equations(planes, y - signal, weight, light, dark, by_p, start, prior)
    return carried(planes, y, weight, equations, prior, start, light, dark, by_p, equations.step(0.0))


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
    information = slope.T @ (inverse_scaled(free.covariance) - known.precision) @ slope + prior.precision
    covariance = inverse_scaled(information)
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
