"""The least of the corrected cost of a noisy template (`errors_in_variables`): of one patch, or of several frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.smear.errors_in_variables import CorrectedEquations, TextureEquations, safe_inverse
from labdaemon.blur.solver.reduced_equations import Prior
from labdaemon.blur.texture_settings import TEXTURE
from labdaemon.least_squares import DampingRule, minimise

EQUAL_COST = 1e-6
"""Rise of the cost that is rounding. Numerics."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedState:
    """The corrected equations at one set of parameters.

    Attributes
    ----------
    p
        (k,) parameters, relative contrasts last.
    equations
        One a frame.
    cost
        Sum of F over the noise's power, and the prior's.
    """

    p: FloatArray
    equations: tuple[CorrectedEquations, ...]
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class TextureFit:
    """Where the fit of a noisy template ended.

    Attributes
    ----------
    p, covariance
        (k,) x, y, defocus, shape…, motion…, and their covariance.
    equations
        At the end.
    cost
        F over the noise's power at the start, and the prior's.
    """

    p: FloatArray
    covariance: FloatArray
    equations: CorrectedEquations
    cost: float


def minimise_corrected(
    here: CorrectedState,
    propose: Callable[[CorrectedState, float], tuple[FloatArray, float]],
    evaluate: Callable[[FloatArray], CorrectedState | None],
    *,
    max_steps: int,
    shortest: float,
) -> CorrectedState:
    """Take steps that lower the cost, others again a third as long.

    Parameters
    ----------
    here
        The start.
    propose
        From a state and a factor (1 at most) to the next parameters, and the squared length of the step in sd.
    evaluate
        The state at some parameters; None where the model overflows.
    max_steps
        Give up after so many.
    shortest
        Least factor.
    """

    def try_step(state: CorrectedState, damping: float) -> tuple[CorrectedState | None, bool]:
        p, squared = propose(state, 1 / damping)
        there = evaluate(p)
        if there is None or there.cost > state.cost + EQUAL_COST:
            return None, False
        return there, squared < TEXTURE.last_step_sd**2 and damping < 3.3

    rule = DampingRule(1.0, relaxed=1 / 3, raised=3.0, least=1.0, most=1 / (3 * shortest), least_raised=1.0)
    return minimise(here, try_step, rule=rule, max_steps=max_steps).at


def fit_texture(
    equations: TextureEquations,
    start: FloatArray,
    prior: Prior,
    *,
    bound: Callable[[FloatArray], FloatArray],
    basis: FloatArray | None = None,
    noise_power: float | None = None,
) -> TextureFit:
    """Minimise the corrected cost from (k,) `start`.

    Parameters
    ----------
    basis
        (k + 1, q) directions in which the parameters may change, contrast last; None for all.
    noise_power
        What weighs the cost against the prior; None takes that at the start. Costs compare under the same one only.
    """
    free = np.eye(len(start) + 1) if basis is None else basis
    p = np.append(bound(start), 1.0)
    precision = np.zeros((len(p), len(p)))
    precision[:-1, :-1] = prior.precision
    mean = np.append(prior.mean, 1.0)
    begun = equations.at(p)
    power = max(begun.noise_power if noise_power is None else noise_power, 1e-12)
    first_motion = 3 + equations.problem.shape_count

    def state_of(at: FloatArray, here: CorrectedEquations) -> CorrectedState:
        return CorrectedState(at, (here,), here.cost / power + float((at - mean) @ precision @ (at - mean)))

    def evaluate(at: FloatArray) -> CorrectedState | None:
        here = evaluate_equations(equations, at)
        return None if here is None else state_of(at, here)

    def reduced(matrix: FloatArray, unit: float) -> FloatArray:
        return free.T @ (matrix / unit + precision) @ free

    def propose(state: CorrectedState, factor: float) -> tuple[FloatArray, float]:
        at, (here,) = state.p, state.equations
        unit = here.widening * power
        information, raw = reduced(here.information, unit), reduced(here.raw_information, unit)
        step = free @ (
            factor * safe_inverse(information, raw) @ (free.T @ (here.score / unit + precision @ (mean - at)))
        )
        # The cost is far from quadratic over more than a part of the motion.
        reach = 1.0 + 0.5 * float(np.max(np.abs(at[first_motion:-1])))
        step /= max(1.0, float(np.max(np.abs(step[:3]))), float(np.max(np.abs(step[first_motion:-1])) / reach))
        trial = np.append(bound((at + step)[:-1]), np.clip((at + step)[-1], 0.05, 20.0))
        moved = free.T @ (trial - at)
        return trial, float(moved @ raw @ moved)

    end = minimise_corrected(state_of(p, begun), propose, evaluate, max_steps=TEXTURE.iterations, shortest=1e-3)
    p, (here,) = end.p, end.equations
    unit = here.widening * max(here.noise_power, 1e-12)
    spread = reduced(equations.score_covariance(p, here), unit**2)
    inverse = safe_inverse(reduced(here.information, unit), reduced(here.raw_information, unit))
    covariance = free @ inverse @ spread @ inverse @ free.T
    return TextureFit(p[:-1], covariance[:-1, :-1], here, end.cost)


def evaluate_equations(equations: TextureEquations, p: FloatArray) -> CorrectedEquations | None:
    """The equations at p; None where the model overflows, which a step from afar may ask for."""
    try:
        return equations.at(p)
    except FloatingPointError:  # the caller tries a shorter step
        return None
