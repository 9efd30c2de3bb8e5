"""Damped Gauss–Newton on patches: a few shape and motion parameters, and each channel's own light.

A pixel of channel c is L_c(x)·(1 − k_c·m(x; p)) with L_c = w0 + w1·x + w2·y (white and light gradient), k_c the
contrast of ink against paper and m the modelled darkness. Each channel's four numbers are eliminated from the normal
equations (variable projection; Golub and Pereyra 1973, doi:10.1137/0710036), so that the system that remains is
as small as the motion itself. Damping is that of Marquardt (1963, doi:10.1137/0111030).

Step, scale and covariance are those of `labdaemon.least_squares`. The loop is not its `minimise`, which compares sums
of squares under one weighting: here the weights follow the model for two iterations and are then frozen, the light goes
along with each step, and the last step is taken to first order, without another look at the image, which costs most.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.illumination import render_illumination, solve_illumination
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import SOLVER
from labdaemon.blur.solver.reduced_equations import (
    Prior,
    Solution,
    build_solution,
    linear_update,
    reduce_normal_equations,
    weighted_squares,
)
from labdaemon.least_squares import scaled_inverse

DarknessModel = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From parameters (k,) to darkness (n, h, w) and its derivatives (k, n, h, w).

Sums over pixels are taken in the derivatives' precision: single is a thousandth of the noise, and enough for a model of
few parameters that do not resemble each other. Everything small is in double.
"""


def solve(
    planes: ColourPlanes,
    weights: Callable[[FloatArray], FloatArray],
    model: DarknessModel,
    start: FloatArray,
    prior: Prior,
    *,
    bound: Callable[[FloatArray], FloatArray] = lambda p: p,
    max_iterations: int = 30,
    tolerance: float = SOLVER.last_step_sd,
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
    dark, by_p = evaluate_model(model, p)
    y = planes.values.astype(by_p.dtype, copy=False)
    reweighted = 0 if light is not None else SOLVER.reweighted_iterations
    if light is None:
        light = _initial_light(planes, weights, y, dark)
    signal = render_illumination(planes, light, dark)
    weight = weights(signal)
    cost = weighted_squares(y - signal, weight) + prior.cost(p)
    damping, converged = SOLVER.undamped, False
    for iteration in range(max_iterations):
        equations = reduce_normal_equations(planes, y - signal, weight, light, dark, by_p, p, prior)
        if iteration > reweighted and damping <= SOLVER.undamped:
            trial = bound(p + equations.step(damping))
            step_size = np.abs(trial - p)
            # Short against the standard deviation alone may be long where something hardly shows.
            if np.max(step_size * equations.scale) < tolerance and np.max(step_size) < SOLVER.linear_step_px:
                return linear_update(planes, y, weight, equations, prior, p, light, dark, by_p, trial - p)
        accepted = False
        for _ in range(8):
            trial = bound(p + equations.step(damping))
            step = trial - p
            trial_light = light + equations.light_step(step)
            trial_dark, trial_by_p = evaluate_model(model, trial)
            trial_signal = render_illumination(planes, trial_light, trial_dark)
            trial_cost = weighted_squares(y - trial_signal, weight) + prior.cost(trial)
            if np.isfinite(trial_cost) and trial_cost <= cost * (1 + SOLVER.equal_cost) + 1e-12:
                accepted = True
                break
            damping = max(damping * 8, 1e-4)
        if not accepted:
            converged = True
            break
        small = bool(np.max(np.abs(step) * equations.scale) < tolerance) or cost - trial_cost < SOLVER.equal_cost * cost
        p, light, dark, by_p, signal, cost = trial, trial_light, trial_dark, trial_by_p, trial_signal, trial_cost
        damping = max(damping / 10, 1e-9)
        if iteration < reweighted:
            weight = weights(signal)
            cost = weighted_squares(y - signal, weight) + prior.cost(p)
        elif small:
            converged = True
            break
    return build_solution(weight, equations, prior, p, light, y - signal, signal, cost, converged)


def _initial_light(
    planes: ColourPlanes, weights: Callable[[FloatArray], FloatArray], y: FloatArray, dark: FloatArray
) -> FloatArray:
    typical = float(np.mean(y[planes.valid])) if planes.valid.any() else 1.0
    return solve_illumination(planes, weights(np.maximum(y, 0.25 * typical)), dark)


def warm_start(
    planes: ColourPlanes,
    weights: Callable[[FloatArray], FloatArray],
    model: DarknessModel,
    start: FloatArray,
    prior: Prior,
    last_step: FloatArray,
    *,
    bound: Callable[[FloatArray], FloatArray] = lambda p: p,
    max_iterations: int = 6,
) -> tuple[FloatArray, FloatArray] | None:
    """Parameters and light near the best, for another fit to begin with; None where they are not soon reached.

    Plain Gauss–Newton steps under the weights of the first model; other parameters as for `solve`.

    Parameters
    ----------
    last_step
        (k,) step, in the parameters' own units, after which the model need not be looked at again.
    """
    p = bound(np.array(start, dtype=np.float64))
    light, weight = None, None
    for _ in range(max_iterations):
        dark, by_p = evaluate_model(model, p)
        y = planes.values.astype(by_p.dtype, copy=False)
        begun = light is not None
        if light is None:
            light = _initial_light(planes, weights, y, dark)
        signal = render_illumination(planes, light, dark)
        if weight is None:
            weight = weights(signal)
        equations = reduce_normal_equations(planes, y - signal, weight, light, dark, by_p, p, prior)
        updated = bound(p + equations.step(0.0))
        step = updated - p
        if not np.all(np.isfinite(step)):
            break
        p, light = updated, light + equations.light_step(step)
        if begun and np.all(np.abs(step) < last_step):
            return p, light
    return None


def gauss_newton_step(
    planes: ColourPlanes,
    weights: Callable[[FloatArray], FloatArray],
    model: DarknessModel,
    start: FloatArray,
    prior: Prior,
    light: FloatArray,
) -> Solution:
    """A single Gauss–Newton step from where the fit is all but converged; parameters as for `solve`."""
    dark, by_p = evaluate_model(model, start)
    y = planes.values.astype(by_p.dtype, copy=False)
    signal = render_illumination(planes, light, dark)
    weight = weights(signal)
    equations = reduce_normal_equations(planes, y - signal, weight, light, dark, by_p, start, prior)
    return linear_update(planes, y, weight, equations, prior, start, light, dark, by_p, equations.step(0.0))


def evaluate_model(model: DarknessModel, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    dark, by_p = model(p)
    return dark.astype(by_p.dtype, copy=False), by_p


def project_to_submodel(
    full: Solution, full_prior: Prior, p: FloatArray, step: FloatArray, jacobian: FloatArray, prior: Prior
) -> Solution:
    """The solution under fewer, curved parameters, without another look at the image.

    Parameters
    ----------
    full, full_prior
        A solution and the prior that it was fitted with.
    p
        (m,) the new parameters, best to first order.
    step
        (k,) from the old solution to where they are.
    jacobian
        (k, m) derivatives of the old parameters by the new.
    prior
        On the new ones.
    """
    k = len(full.p)
    light_step = -full.light_jacobian @ step
    change = step @ full.whitened_jacobian[:, :k] + (light_step[:, None] @ full.whitened_jacobian[:, k:])[:, 0]
    change = change.reshape(full.signal.shape)
    root = np.sqrt(full.weight)
    residual = full.residual - change
    signal = full.signal + np.divide(change, root, out=np.zeros_like(root), where=root > 0)
    information = jacobian.T @ (scaled_inverse(full.covariance) - full_prior.precision) @ jacobian + prior.precision
    covariance = scaled_inverse(information)
    return Solution(
        p,
        covariance,
        full.light + light_step,
        residual,
        signal,
        float(np.vdot(residual, residual)) + prior.cost(p),
        full.dof + k - len(p),
        full.converged,
        full.weight,
        covariance @ prior.precision @ covariance,
        full.light_jacobian @ jacobian,
        np.concatenate(
            (
                jacobian.T.astype(full.whitened_jacobian.dtype) @ full.whitened_jacobian[:, :k],
                full.whitened_jacobian[:, k:],
            ),
            axis=1,
        ),
    )
