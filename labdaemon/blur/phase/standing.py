"""Standing motion v·sin(ωt + ψ) through known windows: what its phase costs, and the best of it.

**What one exposure tells.** Let μ be the motion's phase at the middle of an exposure of Θ radians: the point stands at
v·sin(μ + τ), |τ| ≤ Θ/2. A picture keeps no order of time, so τ and −τ are alike, and so are the four

    (v, μ),   (v, π − μ),   (−v, −μ),   (−v, π + μ),

of which the last two are the first two written with the other sign. What a picture can tell is therefore the
displacement at the middle of the exposure, m = v·sin μ, *with* its sign, and the change there, w = v·cos μ, but for its
sign. An orbit is m cos τ + w sin τ likewise, known up to w → −w. The part that is odd in v, and shows the sign, is

    −(4i/Θ) Σ J_k(2π f·v) sin(kμ) sin(kΘ/2)/k,   k = 1, 3, 5 …,

whose k = 1 mostly shifts the picture and is lost to the free mean position. What is left at small amplitude is the
skew, −(3 e₁ + e₃)/4·|v|³ with e_k = 2 sin(kμ) sin(kΘ/2)/(kΘ), in which sin μ and sin(Θ/2) are multiplied by a number
that is never negative: no two values of sin μ look alike. Nothing is left over whole cycles (sin(Θ/2) = 0), or where
the motion is in its mean position at the middle of the exposure (sin μ = 0). The skew falls with the cube of the
amplitude: far below a pixel no sign shows.

**Hence signs.** Points of one standing motion share μ. Each alone shows on which side of its mean it stood at the
middle of the exposure; two that stood on the sides of +v₁ and +v₂ move that way together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur.law import window_nodes
from labdaemon.blur.patch.light import render_light, solve_light
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.mirror import apart, images, middle_phase, wrapped
from labdaemon.blur.sharp.texture import Texture
from labdaemon.blur.smear.windowed import FRAME, Exposures, phase_motion, standing_motion
from labdaemon.blur.solver.normal import Solution
from labdaemon.blur.solver.solve import solve

ONE_FRAME = 9  # phases looked at over half a circle, of which the other half is the mirror image
FRAMES = 16  # and over the whole circle, for several frames
LEAST_VARIANCE = 0.02  # of the course over a window: what shorter ones are taken for when the amplitude is guessed
LEAST_PX2 = 0.05
FOLLOWED = 2  # local minima that are followed to their bottom
WORTH = 60.0  # cost above the best from which they are not


@dataclass(frozen=True, slots=True, eq=False)
class PhaseProfile:
    """What a standing motion costs at each phase.

    Attributes
    ----------
    phase_rad
        (n,) phases ψ of v·sin(ωt + ψ): evenly over the circle for several frames; for a single frame over the half of
        it in which the motion's phase at the middle of the exposure is −π/2 … π/2, ends included, and at the best.
    cost
        (n,) least sum of squares at each.
    vector_px, place_px
        (n, 2) v there, all on one side; (n, 2) the mean position, mean over frames.
    best
        The best solution with its phase, shape and all: …, vx, vy, ψ last.
    image
        Of several frames, the best solution that is its mirror image in time, where there is one.
    periodic
        Whether the phases go round the circle.
    """

    phase_rad: FloatArray
    cost: FloatArray
    vector_px: FloatArray
    place_px: FloatArray
    best: Solution
    image: Solution | None
    periodic: bool

    @property
    def vector(self) -> FloatArray:
        """(2,) v of the best solution."""
        return self.best.p[-3:-1]

    @property
    def phase(self) -> float:
        """ψ of the best solution."""
        return float(self.best.p[-1])

    @property
    def sd_phase(self) -> float:
        """Its linear standard deviation."""
        return float(np.sqrt(max(self.best.covariance[-1, -1], 0.0)))


def profile_phase(exposures: Exposures, spread: FloatArray) -> PhaseProfile:
    """Fit a standing motion at phases all round, then the best of them to the end.

    Parameters
    ----------
    exposures
        The target in its frames.
    spread
        (2, 2) second moment aaᵀ + bbᵀ that a model of whole cycles would read from the smear.
    """
    periodic = len(exposures.windows) > 1
    if periodic:
        phases = 2 * np.pi * np.arange(FRAMES) / FRAMES
    else:
        phases = np.linspace(-np.pi / 2, np.pi / 2, ONE_FRAME) - middle_phase(exposures)
    courses = [_course(exposures, float(phase)) for phase in phases]
    # The same smear is the more amplitude the less of the path the window saw.
    stretch = np.array([1 / np.sqrt(2 * max(course[1], LEAST_VARIANCE)) for course in courses])
    first = len(phases) // 2
    held = exposures.held_shape()
    vector = _first_vector(held, spread, float(phases[first])) * stretch[first]
    reach = 3.0 + 1.3 * float(np.hypot(*vector)) * float(stretch.max() / stretch[first])
    start = _start(held, vector, float(phases[first]))
    found: dict[int, Solution] = {}
    found[first] = _at(held, float(phases[first]), reach, start)
    weight = found[first].weight
    for order in (range(first + 1, len(phases)), range(first - 1, -1, -1)):
        last = first
        for index in order:
            near, factor = found[last], stretch[index] / stretch[last]
            start = near.p.copy()
            start[-2:] *= factor
            for frame, (before, now) in enumerate(zip(courses[last][0], courses[index][0], strict=True)):
                start[FRAME * frame : FRAME * frame + 2] += near.p[-2:] * before - start[-2:] * now
            found[index] = _at(held, float(phases[index]), reach, start, near.light, weight)
            last = index
    solutions = [found[index] for index in range(len(phases))]
    best, image = _bottom(exposures, phases, solutions, reach, periodic=periodic), None
    if periodic:
        best, image = _with_image(exposures, best, reach)
    else:
        # Long smears have valleys that are narrow between the phases tried.
        phase = float(best.p[-1])
        place = int(np.searchsorted(phases, phase))
        if np.min(np.abs(phases - phase)) > 1e-3:
            near = solutions[min(place, len(solutions) - 1)]
            start = np.concatenate((best.p[:FRAME], best.p[-3:-1]))
            solutions.insert(place, _at(held, phase, reach, start, near.light, weight))
            phases = np.insert(phases, place, phase)
    cost = np.array([one.cost for one in solutions])
    vectors = np.array([one.p[-2:] for one in solutions])
    frames = len(exposures.settings)
    places = np.array([one.p[: FRAME * frames].reshape(frames, FRAME)[:, :2].mean(axis=0) for one in solutions])
    return PhaseProfile(phases, cost, vectors, places, best, image, periodic)


def _course(exposures: Exposures, phase_rad: float) -> tuple[list[float], float]:
    """Mean of sin(ωt + ψ) over each frame's window, and its mean variance there."""
    means, variances = [], []
    for window in exposures.windows:
        basis, weight = window_nodes(window, 3.0)
        course = np.cos(phase_rad) * basis[0] + np.sin(phase_rad) * basis[1]
        means.append(float(course @ weight))
        variances.append(float(course**2 @ weight) - means[-1] ** 2)
    return means, float(np.mean(variances))


def _at(
    held: Exposures,
    phase_rad: float,
    reach_px: float,
    start: FloatArray,
    light: FloatArray | None = None,
    weight: FloatArray | None = None,
) -> Solution:
    """Standing motion at a held phase; with the weights given, so that costs can be compared."""
    model, prior = held.model(standing_motion(phase_rad), reach_px), held.prior(2)
    if weight is None:
        return solve(held.planes, held.weights, model, start, prior)
    kept = weight
    return solve(held.planes, lambda _: kept, model, start, prior, light=light, max_iterations=6, tolerance=0.2)


def _bottom(
    exposures: Exposures, phases: FloatArray, solutions: list[Solution], reach_px: float, *, periodic: bool
) -> Solution:
    """The lowest place of the profile, its phase and the target's shape free."""
    cost = np.array([one.cost for one in solutions])
    padded = np.concatenate((cost[-1:], cost, cost[:1])) if periodic else np.pad(cost, 1, constant_values=np.inf)
    minima = np.flatnonzero((cost <= padded[:-2]) & (cost <= padded[2:]))
    minima = minima[np.argsort(cost[minima])][:FOLLOWED]
    model, prior = exposures.model(phase_motion, reach_px), exposures.prior(3)

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        if not periodic:
            p[-1] = np.clip(p[-1], phases[0], phases[-1])
        return p

    best: Solution | None = None
    for index in minima:
        if cost[index] > cost[minima[0]] + WORTH:
            break
        near, phase = solutions[index], float(phases[index])
        if not periodic and index in (0, len(phases) - 1):
            # The picture depends on sin μ, of which the slope is nothing there: nothing would move.
            phase += 0.4 * float(phases[abs(index - 1)] - phases[index])
        nuisance = FRAME * len(exposures.settings)
        start = np.concatenate((near.p[:nuisance], np.zeros(exposures.shape_count), near.p[-2:], [phase]))
        found = solve(exposures.planes, exposures.weights, model, start, prior, bound=bound, light=near.light)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return best


def _with_image(exposures: Exposures, best: Solution, reach_px: float) -> tuple[Solution, Solution | None]:
    """The better one of a solution and its images in time, and the best of the others."""
    model, prior = exposures.model(phase_motion, reach_px), exposures.prior(3)
    v, phase = best.p[-3:-1], float(best.p[-1])
    kept = best.weight  # so that costs can be compared
    found = [best]
    for a, b in images(exposures, *_vectors(best)):
        start = best.p.copy()
        start[-1] += wrapped(float(np.arctan2(b @ v, a @ v)) - phase)
        found.append(solve(exposures.planes, lambda _: kept, model, start, prior, light=best.light))
    found.sort(key=lambda one: one.cost)
    others = [one for one in found[1:] if apart(*_vectors(found[0]), *_vectors(one))]
    return found[0], others[0] if others else None


def _vectors(solution: Solution) -> tuple[FloatArray, FloatArray]:
    v, phase = solution.p[-3:-1], float(solution.p[-1])
    return v * np.cos(phase), v * np.sin(phase)


def _first_vector(held: Exposures, spread: FloatArray, phase_rad: float) -> FloatArray:
    """The smear's major semi-axis; for a texture, which has no smear to be measured, the best of several."""
    if not isinstance(held.sharp.form, Texture):
        values, vectors = np.linalg.eigh(spread)
        result: FloatArray = np.sqrt(max(values[1], LEAST_PX2)) * vectors[:, 1]
        return result
    tried = [
        size * np.array([np.cos(angle), np.sin(angle)])
        for size in (0.7, 2.5, 6.0)
        for angle in np.arange(4) * np.pi / 4
    ]
    model = held.model(standing_motion(phase_rad), 12.0)
    weight = held.weights(np.maximum(held.planes.values, 0))
    costs = []
    for vector in tried:
        dark, _ = model(_start(held, vector, phase_rad))
        light = solve_light(held.planes, weight, dark)
        costs.append(float(np.sum(weight * (held.planes.values - render_light(held.planes, light, dark)) ** 2)))
    return tried[int(np.argmin(costs))]


def _start(exposures: Exposures, vector: FloatArray, phase_rad: float) -> FloatArray:
    return exposures.begin(vector * np.cos(phase_rad), vector * np.sin(phase_rad), vector)
