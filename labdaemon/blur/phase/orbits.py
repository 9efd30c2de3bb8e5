"""Orbits through known windows: a and b by their vectors, from starts all round, in both senses of turning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.law import nodes_transfer, standing_transfer, window_nodes
from labdaemon.blur.patch.light import render_light, solve_light
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.phase.mirror import images
from labdaemon.blur.phase.standing import LEAST_VARIANCE, PhaseProfile
from labdaemon.blur.smear.honesty import honest_covariance
from labdaemon.blur.smear.model import Motion
from labdaemon.blur.smear.windowed import Exposures, orbit_motion
from labdaemon.blur.solver.normal import Solution
from labdaemon.blur.solver.solve import one_step, solve

Weights = Callable[[FloatArray], FloatArray]
"""From modelled values to inverse variances."""

SHORT_LIST = 4  # starts that are followed to their end
LEAST_PX2 = 0.02  # of the smear's moments when a and b are guessed
DIFFERENT = 16.0  # squared distance, in the best solution's own deviations, from which another is not the same one


@dataclass(frozen=True, slots=True, eq=False)
class MinorAxis:
    """What a fitted standing motion leaves to be said of a minor axis β n·cos(ωt + ψ), n a quarter turn from v.

    Attributes
    ----------
    size_px, covariance
        β as the odd part of the pictures has it, with its sign (the sense of turning).
    square_px2
        β² as their widening has it; analytic at rest, where β alone is not.
    covariance
        (2, 2) of the two.
    """

    size_px: float
    square_px2: float
    covariance: FloatArray

    @property
    def sd_square_px2(self) -> float:
        """Deviation of β²."""
        return float(np.sqrt(max(self.covariance[1, 1], 0.0)))

    def mean_square(self, amplitude_px: float) -> float:
        """Mean of β² over what both tell, px²: how far a motion that is taken for straight may be from it.

        Straight paths and orbits of any β up to the amplitude are held for equally likely beforehand.
        """
        beta = np.linspace(-1.0, 1.0, 801) * max(amplitude_px, 1e-6)
        away = np.stack((beta - self.size_px, beta**2 - self.square_px2))
        square = np.sum(away * (np.linalg.pinv(self.covariance, hermitian=True) @ away), axis=0)
        chance = np.exp(-(square - square.min()) / 2)
        orbit, straight = float(chance.mean()), float(chance[len(beta) // 2])
        return float(chance @ beta**2 / chance.sum()) * orbit / (orbit + straight)


def minor_axis(exposures: Exposures, profile: PhaseProfile) -> MinorAxis:
    """One step from a standing motion that frees a minor axis and its square."""
    at = np.concatenate((profile.best.p, np.zeros(2)))
    reach = 3.0 + 1.3 * float(np.hypot(*profile.vector))
    model, prior = exposures.model(_widened_motion, reach), exposures.prior(5)
    found = one_step(exposures.planes, exposures.weights, model, at, prior, profile.best.light)
    covariance = honest_covariance(exposures.sharp, found, exposures.planes)
    return MinorAxis(float(found.p[-2]), float(found.p[-1]), covariance[-2:, -2:])


def solve_orbit(
    exposures: Exposures, spread: FloatArray, profile: PhaseProfile, minor_px: float
) -> tuple[Solution, Solution | None, Solution | None]:
    """Best orbit, the best one that differs from it, and its image in time; a and b are the last four parameters.

    The image in time of a single frame is no other solution: it is left out.

    Parameters
    ----------
    exposures
        The target in its frames.
    spread
        (2, 2) aaᵀ + bbᵀ by the smear's moments.
    profile, minor_px
        The standing motion that fits best, and the minor axis that it lacks.
    """
    senses = (1.0, -1.0) if len(exposures.windows) > 1 else (1.0,)
    pairs = [pair for turn in senses for pair in _round_the_circle(exposures, spread, turn)]
    pairs += [turned(profile.vector, profile.phase, turn * minor_px) for turn in senses]
    size = max(float(np.hypot(np.hypot(*a), np.hypot(*b))) for a, b in pairs)
    model, prior = exposures.model(orbit_motion, 3.0 + 1.3 * size), exposures.prior(4)
    planes = exposures.planes

    def begun(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
        return [exposures.begin(a, b, np.concatenate((a, b))) for a, b in pairs]

    def solved(starts: Sequence[FloatArray], weights: Weights = exposures.weights) -> list[Solution]:
        return [solve(planes, weights, model, start, prior, max_iterations=25) for start in starts]

    starts = begun(pairs)
    costs = [_rough_cost(exposures, model(start)[0]) for start in starts]
    solutions = solved([starts[index] for index in np.argsort(costs)[:SHORT_LIST]])
    best = min(solutions, key=lambda x: x.cost)
    mirror: list[Solution] = []
    if len(senses) > 1:
        solutions += solved(begun([_other_way_round(best.p[-4:-2], best.p[-2:])]))
        best = min(solutions, key=lambda x: x.cost)
        kept = best.weight  # so that costs can be compared
        mirror = solved(begun(images(exposures, best.p[-4:-2], best.p[-2:])), lambda _: kept)
        image = min(mirror, key=lambda x: x.cost, default=best)
        if image.cost < best.cost:
            best, mirror = image, [best]
    return best, _best_other(best, solutions + mirror), _best_other(best, mirror)


def _best_other(best: Solution, solutions: list[Solution]) -> Solution | None:
    """The best of several that are not the best one again."""
    information = np.linalg.pinv(best.covariance[-4:, -4:], hermitian=True)
    away = [(x, x.p[-4:] - best.p[-4:]) for x in solutions]
    others = [x for x, d in away if float(d @ information @ d) > DIFFERENT]
    return min(others, key=lambda x: x.cost, default=None)


def _round_the_circle(exposures: Exposures, spread: FloatArray, turn: float) -> list[tuple[FloatArray, FloatArray]]:
    """Vectors a and b, L = (a b), at eight phases, of which the picture has the smear's second moment.

    With K the covariance of (sin ωt, cos ωt) over the window that moment is L K Lᵀ, so that L = S^½ R K^−½ with any
    rotation R, or any reflection for the other sense of turning.
    """
    moment = np.zeros((2, 2))
    for window in exposures.windows:
        basis, weight = window_nodes(window, 3.0)
        away = basis - (basis @ weight)[:, None]
        moment += (weight * away) @ away.T / len(exposures.windows)
    inverse, root = _power(moment, -0.5, LEAST_VARIANCE), _power(spread / 2, 0.5, LEAST_PX2)
    pairs = []
    for psi in np.arange(8) * np.pi / 4:
        c, s = np.cos(psi), np.sin(psi)
        vectors = root @ np.array([[c, s], [-turn * s, turn * c]]) @ inverse
        pairs.append((vectors[:, 0], vectors[:, 1]))
    return pairs


def _power(matrix: FloatArray, exponent: float, least: float) -> FloatArray:
    """A symmetric matrix to some power, its eigenvalues not less than `least`."""
    values, vectors = np.linalg.eigh(matrix)
    result: FloatArray = (vectors * np.maximum(values, least) ** exponent) @ vectors.T
    return result


def turned(vector: FloatArray, phase_rad: float, minor_px: float) -> tuple[FloatArray, FloatArray]:
    """Vectors a and b of v·sin(ωt + ψ) with a minor axis added, across v and a quarter of a cycle later."""
    c, s = np.cos(phase_rad), np.sin(phase_rad)
    minor = minor_px * across(vector)
    return vector * c - minor * s, vector * s + minor * c


def across(vector: FloatArray) -> FloatArray:
    """(2,) unit vector a quarter turn from a vector."""
    result: FloatArray = np.array([-vector[1], vector[0]]) / max(float(np.hypot(*vector)), 1e-12)
    return result


def _other_way_round(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same ellipse and the same phase along its major axis, run through in the other sense."""
    _, vectors = np.linalg.eigh(np.outer(a, a) + np.outer(b, b))
    mirror = np.eye(2) - 2 * np.outer(vectors[:, 0], vectors[:, 0])
    return mirror @ a, mirror @ b


def _rough_cost(exposures: Exposures, dark: FloatArray) -> float:
    planes = exposures.planes
    weight = exposures.weights(np.maximum(planes.values, 0))
    light = solve_light(planes, weight, dark)
    return float(np.sum(weight * (planes.values - render_light(planes, light, dark)) ** 2))


def _widened_motion(basis: FloatArray, weight: FloatArray) -> Motion:
    def motion(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        course = np.cos(p[2]) * basis[0] + np.sin(p[2]) * basis[1]
        later = np.cos(p[2]) * basis[1] - np.sin(p[2]) * basis[0]
        transfer, slopes = standing_transfer(fx, fy, p[:3], basis, weight)
        n = across(p[:2])
        side = n[0] * fx + n[1] * fy
        turning, _ = nodes_transfer(fx, fy, p[:2], course[None], weight * later)
        wide, _ = nodes_transfer(fx, fy, p[:2], course[None], weight * later**2)
        slopes = np.concatenate((slopes, [-2j * np.pi * side * turning, -2 * np.pi**2 * side**2 * wide]))
        return transfer + p[3] * slopes[3] + p[4] * slopes[4], slopes

    return motion
