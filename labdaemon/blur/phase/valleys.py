"""All valleys of the phase: minima of the cost of an in-phase motion whose phase shows.

Where frames show the phase, its cost has several valleys, often narrower than the phases that a profile tries. Each
local minimum of the profile is followed to its end, and so are the time-reversed solutions of the best one, and starts
on either side of each minimum that comes close: two valleys may lie between neighbouring phases. Under coded light a
valley may also lie between two phases that both stand on its walls, higher than their neighbours: there the slopes of
the cost point towards each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.patch.illumination import render_illumination
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.time_reversal import differ, time_reversed_solutions, wrap_angle
from labdaemon.blur.settings import PHASE
from labdaemon.blur.smear.frame_set import FRAME_PARAMETERS, FrameSet, window_in_phase_transfer
from labdaemon.blur.smear.texture_frames import correct_cost
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import DarknessModel, solve


def follow_valleys(
    frame_set: FrameSet, phases: FloatArray, solutions: list[Solution], max_amplitude_px: float
) -> list[Solution]:
    """Minima of the cost over the phase, under the weights of the first one, from the lowest.

    Parameters
    ----------
    frame_set
        Frames that show the phase.
    phases, solutions
        (n,) evenly over the circle, and the in-phase motion at each, phase and shape held.
    max_amplitude_px
        Largest amplitude to be represented.

    Returns
    -------
    list of Solution
        Distinct ones, with the phase and the target's shape free.
    """
    model, prior = frame_set.forward_model(window_in_phase_transfer, max_amplitude_px), frame_set.prior(3)
    cost = np.array([one.cost for one in solutions])
    low = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost <= np.roll(cost, -1)))
    # Coded light has narrow minima, which the phases that were tried do not show in their depth.
    coded = any(window.is_coded for window in frame_set.windows)
    hidden: list[tuple[int, float]] = []
    if coded:
        slopes = np.array([_slope(frame_set, model, *each) for each in zip(phases, solutions, strict=True)])
        hidden = valleys_between(phases, cost, slopes, low)[: LIGHT.hidden_minima]
    minima = [int(index) for index in low[np.argsort(cost[low])][: LIGHT.coded_minima]]
    # A parabola whose minimum lies half a step away is lower there by an eighth of the second difference.
    depth = cost - (np.roll(cost, 1) + np.roll(cost, -1) - 2 * cost) / 8
    minima = [index for index in minima if coded or depth[index] < cost[minima[0]] + PHASE.max_extra_cost]
    starts = [solutions[index] for index in minima]
    start = with_free_phase(frame_set, starts[0], float(phases[minima[0]]))
    first = solve(frame_set.planes, frame_set.weights, model, start, prior, light=starts[0].light)
    first = correct_cost(frame_set, first, window_in_phase_transfer)
    kept = first.weight  # so that costs can be compared

    def follow(start: FloatArray, near: Solution) -> Solution:
        found = solve(frame_set.planes, lambda _: kept, model, start, prior, light=near.light, max_iterations=20)
        return correct_cost(frame_set, found, window_in_phase_transfer)

    found = [first]
    found += [
        follow(with_free_phase(frame_set, near, float(phases[index])), near)
        for near, index in zip(starts[1:], minima[1:], strict=True)
    ]
    found += [follow(with_free_phase(frame_set, solutions[index], phase), solutions[index]) for index, phase in hidden]
    best = min(found, key=lambda one: one.cost)
    for a, b in time_reversed_solutions(frame_set, *solution_vectors(best)):
        v, phase = best.p[-3:-1], float(best.p[-1])
        found.append(follow(_turned(best, wrap_angle(float(np.arctan2(b @ v, a @ v)) - phase)), best))
    lowest = min(one.cost for one in found)
    scale = max(best.chi2, LIGHT.min_noise_scale)
    for one in [one for one in distinct(found) if one.cost < lowest + PHASE.max_extra_cost * scale]:
        found += [follow(_turned(one, turn), one) for turn in (-LIGHT.valley_step_rad, LIGHT.valley_step_rad)]
    return distinct(found)


def valleys_between(
    phases: FloatArray, cost: FloatArray, slopes: FloatArray, minima: NDArray[np.intp]
) -> list[tuple[int, float]]:
    """Where slopes point towards each other between two phases neither of which is a minimum.

    Parameters
    ----------
    phases, cost, slopes
        (n,) evenly over the circle, the cost at each and its derivative.
    minima
        Phases that are followed anyway.

    Returns
    -------
    list of tuple
        For each valley the nearer phase by its cost, and where to start; from the lowest.
    """
    step = float(phases[1] - phases[0])
    found = []
    for index in np.flatnonzero((slopes < 0) & (np.roll(slopes, -1) > 0)):
        after = (index + 1) % len(phases)
        if index in minima or after in minima:
            continue
        phase = float(phases[index] + step * slopes[index] / (slopes[index] - slopes[after]))
        found.append((int(index if cost[index] < cost[after] else after), phase))
    return sorted(found, key=lambda start: float(cost[start[0]]))


def _slope(frame_set: FrameSet, model: DarknessModel, phase_rad: float, near: Solution) -> float:
    """Derivative of the cost by the phase at a held one: all else is at its best there, so that it alone counts."""
    planes = frame_set.planes
    dark, by_parameters = model(with_free_phase(frame_set, near, phase_rad))
    signal = render_illumination(planes, near.light, dark)
    change = render_illumination(planes, near.light, dark + by_parameters[-1]) - signal
    return float(-2 * np.sum(near.weight * (planes.values - signal) * change))


def distinct(solutions: list[Solution]) -> list[Solution]:
    """In-phase solutions that are not the same again, from the lowest cost."""
    kept: list[Solution] = []
    for one in sorted(solutions, key=lambda one: one.cost):
        if all(differ(*solution_vectors(other), *solution_vectors(one)) for other in kept):
            kept.append(one)
    return kept


def solution_vectors(solution: Solution) -> tuple[FloatArray, FloatArray]:
    """Vectors a and b of an in-phase solution."""
    v, phase = solution.p[-3:-1], float(solution.p[-1])
    return v * np.cos(phase), v * np.sin(phase)


def with_free_phase(frame_set: FrameSet, near: Solution, phase_rad: float) -> FloatArray:
    """Parameters to start from, by a solution with phase and shape held."""
    places = near.p[: FRAME_PARAMETERS * len(frame_set.problems)]
    return np.concatenate((places, np.zeros(frame_set.nuisance_count), near.p[-2:], [phase_rad]))


def _turned(solution: Solution, turn_rad: float) -> FloatArray:
    """The parameters of a solution at another phase."""
    start = solution.p.copy()
    start[-1] += turn_rad
    return start
