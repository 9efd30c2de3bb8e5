"""Generalised least squares over several frames, each through its own window, and the evidence between solutions.

The weights are those of `gls`. Normal equations add over frames. With the same weights the sums of squares of two
solutions can be compared: that separates a motion from its twins: sums under weights for independent noise take
the paper texture for evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.patch.illumination import render_illumination
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import GLS, PHASE, SOLVER
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.frame_set import FRAME_PARAMETERS, FrameSet, TransferFactory
from labdaemon.blur.smear.gls import FramePart, FrameWeights, TextureMotion, frame_equations, refined_solution
from labdaemon.blur.smear.texture_frames import refine_texture_frames
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.spectra.render import to_single
from labdaemon.least_squares import scaled_inverse

IN_PHASE_PARAMETERS = 3  # vx, vy, ψ
HELD_PHASE_SD_RAD = 1e-7
"""Standard deviation of a phase that is held. Numerics."""


def gls_refine_frames(frame_set: FrameSet, solution: Solution, transfer_factory: TransferFactory) -> Solution:
    """As `gls_refine`, of a target in several frames, each through its own window: normal equations add over frames.

    Where the phase hardly shows the model is curved, and steps are repeated. A single frame under constant light hardly
    shows it near its turning points: the model has no slope there, and a step has no bound. The phase is then held, and
    its variance is 0; `marginalise_phase` and `condition_on_phase` account for all phases. A textured patch is refined
    by `refine_texture_frames` instead.

    Parameters
    ----------
    frame_set
        The target in its frames.
    solution
        A converged fit of all of them with independent weights.
    transfer_factory
        The kind of motion that was fitted.
    """
    sharp = frame_set.sharp
    if isinstance(sharp.form, TexturedPatch):
        held_along = np.zeros(len(solution.p))
        if not _shows_phase(frame_set, solution):
            held_along = _phase_direction(solution.p, frame_set.first_motion)
        return refine_texture_frames(frame_set, sharp.form, solution, transfer_factory, held_along)
    if not sharp.noise_known or solution.chi2 > GLS.max_chi2:
        return solution
    unrefined = solution
    held = not _shows_phase(frame_set, solution)
    # Near rest the phase does not show and the sd has no bound: a step may leave the paths that the model represents.
    longest_px = frame_set.max_amplitude_px(unrefined.p)
    if not np.linalg.norm(unrefined.p[frame_set.first_motion :]) <= longest_px:
        return unrefined
    for _ in range(GLS.frame_steps):
        before = solution
        solution = _step_frames(frame_set, before, transfer_factory, held=held)
        away = np.abs(solution.p - unrefined.p)
        if not np.all(away <= GLS.max_step_sd * np.sqrt(np.abs(np.diag(solution.covariance))) + HELD_PHASE_SD_RAD):
            return unrefined
        motion = slice(frame_set.first_motion, None)
        if not np.linalg.norm(solution.p[motion]) <= longest_px:
            return unrefined
        if not held and not np.linalg.eigvalsh(solution.covariance[motion, motion])[0] > 0:
            return unrefined
        step = np.abs(solution.p - before.p)
        if np.all(step < SOLVER.last_step_sd * np.sqrt(np.diag(solution.covariance)) + HELD_PHASE_SD_RAD):
            break
        dark, _ = frame_set.forward_model(transfer_factory, frame_set.max_amplitude_px(solution.p))(solution.p)
        solution = replace(solution, signal=render_illumination(frame_set.planes, solution.light, dark))
    return solution


def compare_solutions(
    frame_set: FrameSet, solutions: Sequence[Solution], transfer_factory: TransferFactory
) -> list[float]:
    """Twice the negative logarithm of each solution's likelihood, under the weights of the first.

    Parameters
    ----------
    frame_set
        The target in its frames.
    solutions
        Of one kind of motion, near their minima: the last step to them is included.
    transfer_factory
        The kind of motion.

    Returns
    -------
    list of float
        The solutions' own sums of squares where the noise is not known.
    """
    is_texture = isinstance(frame_set.sharp.form, TexturedPatch)
    if is_texture or not frame_set.sharp.noise_known or solutions[0].chi2 > GLS.max_chi2:
        return [one.cost for one in solutions]
    weights: list[FrameWeights] | None = None
    costs = []
    for solution in solutions:
        equations, used = _frames_equations(frame_set, solution, transfer_factory, weights)
        weights = weights or used
        prior = frame_set.prior(len(solution.p) - frame_set.first_motion)
        pull = equations[:-1, -1] - prior.precision @ (solution.p - prior.mean)
        gain = float(pull @ scaled_inverse(equations[:-1, :-1] + prior.precision) @ pull)
        costs.append(float(equations[-1, -1]) + prior.cost(solution.p) - gain)
    return costs


def _shows_phase(frame_set: FrameSet, solution: Solution) -> bool:
    """Whether the phase can be a parameter: of a single frame where it is in phase, and not near its turning points."""
    if frame_set.shows_phase:
        return True
    if len(solution.p) - frame_set.first_motion != IN_PHASE_PARAMETERS:
        return False
    (window,) = frame_set.windows
    middle = float(solution.p[-1]) + (window.phase_rad or 0.0) + np.pi * window.cycles
    sd = float(np.sqrt(max(solution.covariance[-1, -1], 0.0)))
    return sd < PHASE.linear_phase_sd_rad and abs(np.cos(middle)) > 3 * sd


def _step_frames(frame_set: FrameSet, solution: Solution, transfer_factory: TransferFactory, *, held: bool) -> Solution:
    """One step of `gls_refine_frames`, with the phase held or free."""
    equations, _ = _frames_equations(frame_set, solution, transfer_factory, None)
    prior = frame_set.prior(len(solution.p) - frame_set.first_motion)
    if held:
        along = _phase_direction(solution.p, frame_set.first_motion)
        equations[:-1, :-1] += np.outer(along, along) / HELD_PHASE_SD_RAD**2
    return refined_solution(solution, equations[:-1, :-1], equations[:-1, -1], prior)


def _phase_direction(p: FloatArray, first: int) -> FloatArray:
    """(k,) derivative of all parameters by the phase, of an in-phase motion (vx, vy, ψ, …) or an orbit (a, b)."""
    motion = p[first:]
    result = np.zeros(len(p))
    if len(motion) == 4:
        result[first:] = np.concatenate((-motion[2:], motion[:2])) / max(float(motion @ motion), 1e-12)
    elif len(motion) > 2:
        result[first + 2] = 1.0
    return result


def _frames_equations(
    frame_set: FrameSet, solution: Solution, transfer_factory: TransferFactory, weights: Sequence[FrameWeights] | None
) -> tuple[FloatArray, list[FrameWeights]]:
    """(k + 1, k + 1) products of all frames, and the weights of each."""
    size = len(solution.p) + 1
    total, used = np.zeros((size, size)), []
    for own, products, own_weights in frame_products(frame_set, solution, transfer_factory, weights):
        total[np.ix_([*own, -1], [*own, -1])] += products
        used.append(own_weights)
    return total, used


def frame_products(
    frame_set: FrameSet,
    solution: Solution,
    transfer_factory: TransferFactory,
    weights: Sequence[FrameWeights] | None = None,
    extra: Mapping[int, FloatArray] | None = None,
) -> Iterator[tuple[list[int], FloatArray, FrameWeights]]:
    """Each frame's products of `gls.frame_equations`, the parameters that they are of, and the frame's weights.

    The parameters are the frame's own and the common ones: the shape's, the ambient light's and the motion's.

    Parameters
    ----------
    frame_set, solution, transfer_factory, weights
        As for `compare_solutions`.
    extra
        For some frames (m, n, h, w) derivatives of their rows of the model by what is no parameter of the fit. Their
        products follow those of the parameters.
    """
    p, first, ambient = solution.p, frame_set.first_motion, frame_set.ambient_count
    max_amplitude_px = frame_set.max_amplitude_px(p)
    dark, by_p = frame_set.forward_model(transfer_factory, max_amplitude_px, exact=True)(p)
    nuisance = FRAME_PARAMETERS * len(frame_set.problems)
    for index, (problem, window) in enumerate(zip(frame_set.problems, frame_set.windows, strict=True)):
        own = [*range(FRAME_PARAMETERS * index, FRAME_PARAMETERS * (index + 1)), *range(nuisance, len(p))]
        rows = frame_set.rows(index)
        more = by_p[:0, rows] if extra is None or index not in extra else to_single(extra[index])
        part = FramePart(
            frame_set.planes_of(index),
            problem.shape_count + ambient,
            solution.light[rows],
            solution.signal[rows],
            solution.weight[rows] > 0,
            dark[rows],
            np.concatenate((by_p[own][:, rows], more)),
            len(more),
        )
        transfer = frame_set.transfer(window, transfer_factory, max_amplitude_px)
        motion = TextureMotion.through_window(transfer, p[own[:FRAME_PARAMETERS]], p[first - ambient :])
        given = None if weights is None else weights[index]
        products, used = frame_equations(frame_set.sharp, part, motion, given)
        yield own, products, used
