"""In-phase motion v·sin(ωt + ψ) through known windows: what its phase costs, and the best of it.

**What one exposure shows.** Let μ be the motion's phase at the middle of an exposure of Θ radians: the point stands at
v·sin(μ + τ), |τ| ≤ Θ/2. An image keeps no order of time, so τ and −τ give the same image, and so do the four

    (v, μ),   (v, π − μ),   (−v, −μ),   (−v, π + μ),

of which the last two are the first two written with the other sign. What an image shows is therefore the
displacement at the middle of the exposure, m = v·sin μ, *with* its sign, and the change there, w = v·cos μ, but for its
sign. An orbit is m cos τ + w sin τ likewise, known up to w → −w. The part that changes sign with v is

    −(4i/Θ) Σ J_k(2π f·v) sin(kμ) sin(kΘ/2)/k,   k = 1, 3, 5 …,

whose k = 1 mostly shifts the image and is lost to the free mean position. What is left at small amplitude is the skew,
−(3 e₁ + e₃)/4·|v|³ with e_k = 2 sin(kμ) sin(kΘ/2)/(kΘ), in which sin μ and sin(Θ/2) are multiplied by a number that is
never negative: all values of sin μ are distinguishable. Nothing is left over whole cycles (sin(Θ/2) = 0), or where
the motion is in its mean position at the middle of the exposure (sin μ = 0). The skew falls with the cube of the
amplitude: far below a pixel no sign shows.

**Hence signs.** Points of one in-phase motion share μ. Each alone shows on which side of its mean it stood at the
middle of the exposure; two that stood on the sides of +v₁ and +v₂ move that way together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur.patch.illumination import render_illumination, solve_illumination
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.time_reversal import mid_exposure_phase
from labdaemon.blur.phase.valleys import follow_valleys, with_free_phase
from labdaemon.blur.settings import PHASE
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.frame_set import (
    FRAME_PARAMETERS,
    FrameSet,
    window_fixed_phase_transfer,
    window_in_phase_transfer,
)
from labdaemon.blur.smear.texture_frames import correct_cost
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import window_nodes


@dataclass(frozen=True, slots=True, eq=False)
class PhaseProfile:
    """What an in-phase motion costs at each phase.

    Attributes
    ----------
    phase_rad
        (n,) phases ψ of v·sin(ωt + ψ): evenly over the circle for several frames; for a single frame over the half of
        it in which the motion's phase at the middle of the exposure is −π/2 … π/2, ends included, and at the best.
    cost
        (n,) least sum of squares at each.
    vector_px, centre_px
        (n, 2) v there, all on one side; (n, 2) the mean position, mean over frames.
    best
        The best solution with its phase, shape and all: …, vx, vy, ψ last.
    rivals
        Where the phase shows, other minima under the best one's weights, from the lowest.
    periodic
        Whether the phases go round the circle.
    coded
        Whether coded light shows the phase.
    """

    phase_rad: FloatArray
    cost: FloatArray
    vector_px: FloatArray
    centre_px: FloatArray
    best: Solution
    rivals: tuple[Solution, ...]
    periodic: bool
    coded: bool = False

    @property
    def vector(self) -> FloatArray:
        """(2,) v of the best solution."""
        return self.best.p[-3:-1]

    @property
    def phase(self) -> float:
        """ψ of the best solution."""
        return float(self.best.p[-1])

    @property
    def is_narrow(self) -> bool:
        """Whether the minimum is narrower than the phases tried; other minima were followed and are rivals."""
        return self.coded and self.sd_phase < PHASE.linear_phase_sd_rad

    @property
    def sd_phase(self) -> float:
        """Its linear standard deviation."""
        return float(np.sqrt(max(self.best.covariance[-1, -1], 0.0)))


def profile_phase(frame_set: FrameSet, moment_px2: FloatArray) -> PhaseProfile:
    """Fit an in-phase motion at phases all round, then the best of them to the end.

    Parameters
    ----------
    frame_set
        The target in its frames.
    moment_px2
        (2, 2) second moment aaᵀ + bbᵀ that a model of whole cycles would read from the smear.
    """
    periodic = frame_set.shows_phase
    if periodic:
        phases = 2 * np.pi * np.arange(PHASE.group_phases) / PHASE.group_phases
    else:
        phases = np.linspace(-np.pi / 2, np.pi / 2, PHASE.single_frame_phases) - mid_exposure_phase(frame_set)
    window_moments = [_window_moments(frame_set, float(phase)) for phase in phases]
    # The same smear is the more amplitude the less of the path the window saw.
    stretch = np.array([1 / np.sqrt(2 * max(waveform[1], PHASE.min_window_variance)) for waveform in window_moments])
    first = len(phases) // 2
    fixed = frame_set.with_fixed_shape()
    vector = _initial_vector(fixed, moment_px2, float(phases[first])) * stretch[first]
    reach = 3.0 + 1.3 * float(np.hypot(*vector)) * float(stretch.max() / stretch[first])
    start = _initial_parameters(fixed, vector, float(phases[first]))
    # At a held phase v and −v are two minima; the circle has both at phases half a turn apart.
    side = vector / float(np.hypot(*vector)) if periodic else None
    found: dict[int, Solution] = {}
    found[first] = _at(fixed, float(phases[first]), reach, start, side=side)
    weight = found[first].weight
    for order in (range(first + 1, len(phases)), range(first - 1, -1, -1)):
        last = first
        for index in order:
            near, factor = found[last], stretch[index] / stretch[last]
            start = near.p.copy()
            start[-2:] *= factor
            for frame, (before, now) in enumerate(zip(window_moments[last][0], window_moments[index][0], strict=True)):
                start[FRAME_PARAMETERS * frame : FRAME_PARAMETERS * frame + 2] += (
                    near.p[-2:] * before - start[-2:] * now
                )
            found[index] = _at(fixed, float(phases[index]), reach, start, near.light, weight, side=side)
            last = index
    solutions = [found[index] for index in range(len(phases))]
    rivals: tuple[Solution, ...] = ()
    if periodic:
        best, *others = follow_valleys(frame_set, phases, solutions, reach)
        rivals = tuple(others)
    else:
        best = _refine_minima(frame_set, phases, solutions, reach)[0]
        # Long smears have valleys that are narrow between the phases tried.
        phase = float(best.p[-1])
        place = int(np.searchsorted(phases, phase))
        if np.min(np.abs(phases - phase)) > 1e-3:
            near = solutions[min(place, len(solutions) - 1)]
            start = np.concatenate((best.p[:FRAME_PARAMETERS], best.p[-3:-1]))
            solutions.insert(place, _at(fixed, phase, reach, start, near.light, weight))
            phases = np.insert(phases, place, phase)
    cost = np.array([one.cost for one in solutions])
    vectors = np.array([one.p[-2:] for one in solutions])
    frames = len(frame_set.problems)
    places = np.array(
        [one.p[: FRAME_PARAMETERS * frames].reshape(frames, FRAME_PARAMETERS)[:, :2].mean(axis=0) for one in solutions]
    )
    coded = any(window.is_coded for window in frame_set.windows)
    return PhaseProfile(phases, cost, vectors, places, best, rivals, periodic, coded)


def mean_waveform(frame_set: FrameSet) -> tuple[float, float]:
    """Means of sin ωt and cos ωt over the windows, mean over the frames."""
    sine, cosine = (float(np.mean(_window_moments(frame_set, phase)[0])) for phase in (0.0, np.pi / 2))
    return sine, cosine


def _window_moments(frame_set: FrameSet, phase_rad: float) -> tuple[list[float], float]:
    """Mean of sin(ωt + ψ) over each frame's window, and its mean variance there."""
    means, variances = [], []
    for window in frame_set.windows:
        basis, weight = window_nodes(window, 3.0)
        waveform = np.cos(phase_rad) * basis[0] + np.sin(phase_rad) * basis[1]
        means.append(float(waveform @ weight))
        variances.append(float(waveform**2 @ weight) - means[-1] ** 2)
    return means, float(np.mean(variances))


def _at(
    fixed: FrameSet,
    phase_rad: float,
    max_amplitude_px: float,
    start: FloatArray,
    light: FloatArray | None = None,
    weight: FloatArray | None = None,
    *,
    side: FloatArray | None = None,
) -> Solution:
    """In-phase motion at a held phase; with the weights given, so that costs can be compared.

    Parameters
    ----------
    side
        (2,) direction against which v must not point.
    """

    def bound(p: FloatArray) -> FloatArray:
        if side is None or (along := float(p[-2:] @ side)) >= PHASE.min_along_px:
            return p
        p = p.copy()
        p[-2:] += (PHASE.min_along_px - along) * side
        return p

    transfer_factory, prior = window_fixed_phase_transfer(phase_rad), fixed.prior(2)
    model = fixed.forward_model(transfer_factory, max_amplitude_px)
    if weight is None:
        found = solve(fixed.planes, fixed.weights, model, start, prior, bound=bound)
    else:
        kept = weight
        found = solve(
            fixed.planes, lambda _: kept, model, start, prior, bound=bound, light=light, max_iterations=6, tolerance=0.2
        )
    return correct_cost(fixed, found, transfer_factory)


def _refine_minima(
    frame_set: FrameSet, phases: FloatArray, solutions: list[Solution], max_amplitude_px: float
) -> list[Solution]:
    """The lowest minima of a single frame's profile, its phase and the target's shape free; the best one first."""
    cost = np.array([one.cost for one in solutions])
    padded = np.pad(cost, 1, constant_values=np.inf)
    minima = np.flatnonzero((cost <= padded[:-2]) & (cost <= padded[2:]))
    minima = minima[np.argsort(cost[minima])][: PHASE.followed_minima]
    model, prior = frame_set.forward_model(window_in_phase_transfer, max_amplitude_px), frame_set.prior(3)

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[-1] = np.clip(p[-1], phases[0], phases[-1])
        return p

    refined: list[Solution] = []
    for index in minima:
        if cost[index] > cost[minima[0]] + PHASE.max_extra_cost:
            break
        near, phase = solutions[index], float(phases[index])
        if index in (0, len(phases) - 1):
            # The image depends on sin μ, of which the slope is nothing there: nothing would move.
            phase += 0.4 * float(phases[abs(index - 1)] - phases[index])
        start = with_free_phase(frame_set, near, phase)
        found = solve(frame_set.planes, frame_set.weights, model, start, prior, bound=bound, light=near.light)
        refined.append(correct_cost(frame_set, found, window_in_phase_transfer))
    return sorted(refined, key=lambda one: one.cost)


def _initial_vector(fixed: FrameSet, moment_px2: FloatArray, phase_rad: float) -> FloatArray:
    """The smear's major semi-axis; for a texture, which has no smear to be measured, the best of several."""
    if fixed.moment_px2 is not None or not isinstance(fixed.sharp.form, TexturedPatch):
        values, vectors = np.linalg.eigh(moment_px2)
        result: FloatArray = np.sqrt(max(values[1], PHASE.min_moment_px2)) * vectors[:, 1]
        return result
    tried = [
        size * np.array([np.cos(angle), np.sin(angle)])
        for size in (0.7, 2.5, 6.0)
        for angle in np.arange(4) * np.pi / 4
    ]
    model = fixed.forward_model(window_fixed_phase_transfer(phase_rad), 12.0)
    weight = fixed.weights(np.maximum(fixed.planes.values, 0))
    costs = []
    for vector in tried:
        dark, _ = model(_initial_parameters(fixed, vector, phase_rad))
        light = solve_illumination(fixed.planes, weight, dark)
        costs.append(
            float(np.sum(weight * (fixed.planes.values - render_illumination(fixed.planes, light, dark)) ** 2))
        )
    return tried[int(np.argmin(costs))]


def _initial_parameters(frame_set: FrameSet, vector: FloatArray, phase_rad: float) -> FloatArray:
    return frame_set.initial_parameters(vector * np.cos(phase_rad), vector * np.sin(phase_rad), vector)
