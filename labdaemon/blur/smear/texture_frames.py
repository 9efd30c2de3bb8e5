"""Textured patches through windows and under coded light: the noise of their sharp frame accounted for.

Least squares reads the noise of the sharp frame as motion, and as another phase. With the most probable texture for a
template it comes near, and its solutions compare by their likelihood. From the best one the corrected equations of each
frame (`errors_in_variables`), which add over frames, lead to the unbiased one in a few steps. The motion is by its
vectors, of which the image has no slope at rest: whether anything moves is asked before, by the second moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.sharp.texture_structure import texture_band, without_noise
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.errors_in_variables import (
    CorrectedEquations,
    TextureEquations,
    blur_power,
    safe_inverse,
    template_share,
    texture_depth,
)
from labdaemon.blur.smear.fit_problem import rest_spectra
from labdaemon.blur.smear.frame_set import (
    FRAME_PARAMETERS,
    FrameSet,
    TransferFactory,
    orbit_vectors,
    window_orbit_transfer,
)
from labdaemon.blur.smear.texture_fit import CorrectedState, evaluate_equations, minimise_corrected
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.texture_settings import TEXTURE

HELD_SD = 1e-5
"""Standard deviation of a direction that is held. Numerics."""


def with_clean_texture(frame_set: FrameSet) -> FrameSet:
    """The frames with the most probable texture for the template of a textured patch; those of a dot as they are."""
    sharp, form = frame_set.sharp, frame_set.sharp.form
    if not isinstance(form, TexturedPatch):
        return frame_set
    level = form.spread_dn * (1 / max(form.contrast, 1e-9) - float(form.dark.mean()))
    variance = float(sharp.noise.variance(np.array([level]))[0]) / form.frames / max(form.spread_dn, 1e-12) ** 2
    clean = without_noise(form, variance)
    problems = [replace(one, rest_spectra=rest_spectra(clean, one.grid, one.planes)) for one in frame_set.problems]
    return replace(frame_set, problems=problems)


def correct_cost(frame_set: FrameSet, solution: Solution, transfer_factory: TransferFactory) -> Solution:
    """A textured patch's solution with its cost by the likelihood; a dot's as it is.

    With the most probable texture for a template (`without_noise`) the residuals are n2 + H·e, where e is what the
    sharp frame leaves unknown of the texture: of power N·S/(S + N), by the power S of the texture and N of the noise.
    A sum of squares would prefer more blur.
    """
    form, first = frame_set.sharp.form, frame_set.first_motion
    length = float(np.linalg.norm(solution.p[first:]))
    if not isinstance(form, TexturedPatch) or not length <= float(np.hypot(*frame_set.problems[0].grid.size)):
        return solution
    nuisance, cost = FRAME_PARAMETERS * len(frame_set.problems), solution.cost
    for index, window in enumerate(frame_set.windows):
        p = np.concatenate((solution.p[FRAME_PARAMETERS * index :][:FRAME_PARAMETERS], solution.p[nuisance:]))
        motion = frame_set.transfer(window, transfer_factory, 3.0 + 1.3 * length)
        rows, planes = frame_set.rows(index), frame_set.planes_of(index)
        weight, light = solution.weight[rows], solution.light[rows]
        used = weight.any(axis=(1, 2))
        residual = np.where(weight > 0, (planes.values - solution.signal[rows]) * np.sqrt(weight), 0.0)
        image = merge_planes(planes, residual)
        share = template_share(form, light[used])
        noise = share / max(float(np.mean(weight[weight > 0])) * texture_depth(light[used]) ** 2, 1e-300)
        band = texture_band(form, image.shape, noise)
        seen = np.abs(fft.rfft2(image)[band.places]) ** 2 / band.count
        blur = blur_power(motion, frame_set.shape_count, p, band.fx, band.fy)
        double = np.where((band.fx > 0) & (band.fx < 0.5), 2.0, 1.0)
        variance = 1 + share * blur * band.weight / double
        pixels = np.count_nonzero(residual) / band.count
        cost += float(double @ (seen / variance + pixels * np.log(variance))) - float(np.vdot(residual, residual))
    return replace(solution, cost=cost)


@dataclass(frozen=True, slots=True, eq=False)
class _FramePart:
    """One frame's equations, what they are to begin with, and the places of its parameters and contrast among all."""

    equations: TextureEquations
    places: list[int]
    begun: CorrectedEquations

    @property
    def noise_power(self) -> float:
        """What weighs the cost."""
        return max(self.begun.noise_power, 1e-12)


def refine_texture_frames(
    frame_set: FrameSet,
    form: TexturedPatch,
    solution: Solution,
    transfer_factory: TransferFactory,
    held_along: FloatArray,
) -> Solution:
    """The solution of the corrected equations near one of least squares; that one where none is near.

    Parameters
    ----------
    frame_set, form
        The target in its frames, and its sharp patch.
    solution
        A converged fit by least squares.
    transfer_factory
        The kind of motion that was fitted.
    held_along
        (k,) direction of the parameters that is held, a phase that hardly shows; 0 where all are free.
    """
    first, count = frame_set.first_motion, len(solution.p)
    length = float(np.linalg.norm(solution.p[first:]))
    if not length <= float(np.hypot(*frame_set.problems[0].grid.size)):
        return solution  # a step without bound, where the phase hardly shows
    reach = 3.0 + 1.3 * length
    parts = _frame_parts(frame_set, form, solution, transfer_factory, reach)
    prior = frame_set.prior(count - first)
    p = np.concatenate((solution.p, np.ones(len(parts))))
    precision = np.zeros((len(p), len(p)))
    precision[:count, :count] = prior.precision
    mean = np.concatenate((prior.mean, np.ones(len(parts))))
    stiff = precision.copy()
    stiff[:count, :count] += np.outer(held_along, held_along) / HELD_SD**2

    def evaluate(at: FloatArray) -> CorrectedState | None:
        states = [evaluate_equations(part.equations, at[part.places]) for part in parts]
        seen = tuple(one for one in states if one is not None)
        if len(seen) < len(parts):
            return None
        squares = sum(one.cost / part.noise_power for one, part in zip(seen, parts, strict=True))
        return CorrectedState(at, seen, float(squares + (at - mean) @ precision @ (at - mean)))

    def propose(state: CorrectedState, factor: float) -> tuple[FloatArray, float]:
        score, information, raw = _sum_equations(parts, state.equations, len(state.p))
        gradient = score + precision @ (mean - state.p)
        step = factor * safe_inverse(information + stiff, raw + stiff) @ gradient
        step /= max(1.0, float(np.max(np.abs(step[first:count]))))
        return state.p + step, float(step @ (raw + precision) @ step)

    begun = evaluate(p)
    if begun is None:
        return solution
    end = minimise_corrected(begun, propose, evaluate, max_steps=TEXTURE.frame_iterations, shortest=1e-2)
    p, here = end.p, end.equations
    if not np.linalg.norm(p[first:count]) <= reach:
        return solution
    _, information, raw = _sum_equations(parts, here, len(p))
    inverse = safe_inverse(information + stiff, raw + stiff)
    spread = precision.copy()
    for part, state in zip(parts, here, strict=True):
        unit = state.widening * max(state.noise_power, 1e-12)
        own = part.equations.score_covariance(p[part.places], state)
        spread[np.ix_(part.places, part.places)] += own / unit**2
    covariance = inverse @ spread @ inverse
    light = solution.light.copy()
    for index in range(len(parts)):
        light[frame_set.rows(index), 3] *= p[count + index]
    return replace(solution, p=p[:count], covariance=covariance[:count, :count], light=light, template_noise=True)


def equations_of_frames(frame_set: FrameSet, solution: Solution) -> list[tuple[ColourPlanes, CorrectedEquations]]:
    """Planes and corrected equations of each frame at a solution, by an orbit's vectors; none for dots.

    Parameters
    ----------
    frame_set, solution
        The frames, and their joint fit by an orbit or an in-phase motion.
    """
    form, first = frame_set.sharp.form, frame_set.first_motion
    length = float(np.linalg.norm(orbit_vectors(solution.p[first:])))
    if not isinstance(form, TexturedPatch) or not length <= float(np.hypot(*frame_set.problems[0].grid.size)):
        return []
    p = np.concatenate((solution.p[:first], orbit_vectors(solution.p[first:])))
    parts = _frame_parts(frame_set, form, replace(solution, p=p), window_orbit_transfer, 3.0 + 1.3 * length)
    return [(part.equations.problem.planes, part.begun) for part in parts]


def _frame_parts(
    frame_set: FrameSet, form: TexturedPatch, solution: Solution, transfer_factory: TransferFactory, reach_px: float
) -> list[_FramePart]:
    nuisance, parts = FRAME_PARAMETERS * len(frame_set.problems), []
    for index, (problem, window) in enumerate(zip(frame_set.problems, frame_set.windows, strict=True)):
        rows = frame_set.rows(index)
        planes = frame_set.planes_of(index)
        alone = replace(problem, planes=planes, rest_spectra=rest_spectra(form, problem.grid, planes))
        own = replace(solution, light=solution.light[rows], weight=solution.weight[rows])
        motion = frame_set.transfer(window, transfer_factory, reach_px)
        places = [
            *range(FRAME_PARAMETERS * index, FRAME_PARAMETERS * (index + 1)),
            *range(nuisance, len(solution.p)),
            len(solution.p) + index,
        ]
        equations = TextureEquations(alone, form, own, motion)
        begun = equations.at(np.append(solution.p[places[:-1]], 1.0))
        parts.append(_FramePart(equations, places, begun))
    return parts


def _sum_equations(
    parts: Sequence[_FramePart], states: Sequence[CorrectedEquations], size: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Score, information and raw normal matrix of all parameters, over the noise's power."""
    score, information, raw = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
    for part, state in zip(parts, states, strict=True):
        unit, block = state.widening * part.noise_power, np.ix_(part.places, part.places)
        score[part.places] += state.score / unit
        information[block] += state.information / unit
        raw[block] += state.raw_information / unit
    return score, information, raw
