"""Orbits through known windows: a and b by their vectors, from starts all round, in both directions of rotation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.patch.illumination import render_illumination, solve_illumination
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.phase.in_phase import PhaseProfile
from labdaemon.blur.phase.time_reversal import time_reversed_solutions
from labdaemon.blur.settings import PHASE
from labdaemon.blur.smear.fit_problem import TransferFunction
from labdaemon.blur.smear.frame_set import FrameSet, window_orbit_transfer
from labdaemon.blur.smear.gls_frames import gls_refine_frames
from labdaemon.blur.smear.texture_frames import correct_cost
from labdaemon.blur.smear.uncertainty import robust_covariance
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import gauss_newton_step, solve
from labdaemon.blur.waveform import in_phase_transfer, quadrature_transfer, window_nodes

Weights = Callable[[FloatArray], FloatArray]
"""From modelled values to inverse variances."""


@dataclass(frozen=True, slots=True, eq=False)
class MinorAxis:
    """What a fitted in-phase motion leaves to be said of a minor axis β n·cos(ωt + ψ), n a quarter turn from v.

    Attributes
    ----------
    size_px, covariance
        β by the antisymmetric part of the images, with its sign (the direction of rotation).
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
        """Standard deviation of β²."""
        return float(np.sqrt(max(self.covariance[1, 1], 0.0)))

    def mean_square(self, amplitude_px: float) -> float:
        """Mean of β² over what both tell, px²: how far a motion that is taken for straight may be from it.

        Straight paths and orbits of any β up to the amplitude are held for equally likely beforehand.
        """
        square, share = self._of_orbits(amplitude_px)
        return square * share

    def orbit_mean_square(self, amplitude_px: float) -> float:
        """The same of orbits alone, px²: for those who weigh straight paths against orbits by more than one image."""
        return self._of_orbits(amplitude_px)[0]

    def _of_orbits(self, amplitude_px: float) -> tuple[float, float]:
        """Mean of β² among orbits, px², and their share."""
        beta = np.linspace(-1.0, 1.0, 801) * max(amplitude_px, 1e-6)
        away = np.stack((beta - self.size_px, beta**2 - self.square_px2))
        square = np.sum(away * (np.linalg.pinv(self.covariance, hermitian=True) @ away), axis=0)
        probability = np.exp(-(square - square.min()) / 2)
        orbit, straight = float(probability.mean()), float(probability[len(beta) // 2])
        return float(probability @ beta**2 / probability.sum()), orbit / (orbit + straight)


def estimate_minor_axis(frame_set: FrameSet, profile: PhaseProfile) -> MinorAxis:
    """One step from an in-phase motion that frees a minor axis and its square."""
    at = np.concatenate((profile.best.p, np.zeros(2)))
    reach = 3.0 + 1.3 * float(np.hypot(*profile.vector))
    model, prior = frame_set.forward_model(minor_axis_transfer, reach), frame_set.prior(5)
    found = gauss_newton_step(frame_set.planes, frame_set.weights, model, at, prior, profile.best.light)
    found = gls_refine_frames(frame_set, found, minor_axis_transfer)
    covariance = robust_covariance(frame_set.sharp, found, frame_set.planes)
    size, square, longest = float(found.p[-2]), float(found.p[-1]), 3.0 * float(np.hypot(*profile.vector))
    if not (abs(size) <= longest and abs(square) <= longest**2):
        size = square = 0.0  # a step without bound, where the phase hardly shows
    return MinorAxis(size, square, covariance[-2:, -2:])


def solve_orbit(
    frame_set: FrameSet, moment_px2: FloatArray, profile: PhaseProfile, minor_px: float
) -> tuple[Solution, list[Solution], Solution | None]:
    """Best orbit, those that differ from it, and its image in time; a and b are the last four parameters.

    The image in time of a single frame is no other solution: it is left out.

    Parameters
    ----------
    frame_set
        The target in its frames.
    moment_px2
        (2, 2) aaᵀ + bbᵀ by the smear's moments.
    profile, minor_px
        The in-phase motion that fits best, and the minor axis that it lacks.
    """
    rotations = (1.0, -1.0) if frame_set.shows_phase else (1.0,)
    pairs = [pair for rotation in rotations for pair in _initial_orbits(frame_set, moment_px2, rotation)]
    known = len(pairs)
    pairs += [
        vectors_from_axes(near.p[-3:-1], float(near.p[-1]), rotation * minor_px)
        for near in (profile.best, *profile.rivals[: LIGHT.orbit_rivals if profile.coded else 0])
        for rotation in rotations
    ]
    size = max(float(np.hypot(np.hypot(*a), np.hypot(*b))) for a, b in pairs)
    model, prior = frame_set.forward_model(window_orbit_transfer, 3.0 + 1.3 * size), frame_set.prior(4)
    planes = frame_set.planes

    def initial(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
        return [frame_set.initial_parameters(a, b, np.concatenate((a, b))) for a, b in pairs]

    def solve_all(starts: Sequence[FloatArray], weights: Weights = frame_set.weights) -> list[Solution]:
        found = [solve(planes, weights, model, start, prior, max_iterations=25) for start in starts]
        return [correct_cost(frame_set, one, window_orbit_transfer) for one in found]

    starts = initial(pairs)
    costs = [_rough_cost(frame_set, model(start)[0]) for start in starts]
    chosen = list(np.argsort(costs)[: PHASE.followed_starts])
    if profile.coded:
        chosen += [index for index in range(known, len(pairs)) if index not in chosen]
    solutions = solve_all([starts[index] for index in chosen])
    best = min(solutions, key=lambda x: x.cost)
    mirror: list[Solution] = []
    if len(rotations) > 1:
        solutions += solve_all(initial([_reverse_rotation(best.p[-4:-2], best.p[-2:])]))
        best = min(solutions, key=lambda x: x.cost)
        kept = best.weight  # so that costs can be compared
        if profile.coded:
            solutions = [best, *solve_all([x.p for x in solutions if x is not best], lambda _: kept)]
        mirror = solve_all(initial(time_reversed_solutions(frame_set, best.p[-4:-2], best.p[-2:])), lambda _: kept)
        time_reversed = min(mirror, key=lambda x: x.cost, default=best)
        if time_reversed.cost < best.cost:
            best, mirror = time_reversed, [best]
    mirrors = _distinct(best, mirror)
    return best, _distinct(best, solutions + mirror), mirrors[0] if mirrors else None


def _distinct(best: Solution, solutions: list[Solution]) -> list[Solution]:
    """Those of several that are neither the best one again nor each other, from the lowest cost."""
    information = np.linalg.pinv(best.covariance[-4:, -4:], hermitian=True)
    kept = [best]
    for one in sorted(solutions, key=lambda x: x.cost):
        away = [one.p[-4:] - other.p[-4:] for other in kept]
        if all(float(d @ information @ d) > PHASE.distinct_distance2 for d in away):
            kept.append(one)
    return kept[1:]


def _initial_orbits(
    frame_set: FrameSet, moment_px2: FloatArray, rotation: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Vectors a and b, L = (a b), at eight phases, of which the image has the smear's second moment.

    With K the covariance of (sin ωt, cos ωt) over the window that moment is L K Lᵀ, so that L = S^½ R K^−½ with any
    rotation R, or any reflection for the other direction of rotation.
    """
    moment = np.zeros((2, 2))
    for window in frame_set.windows:
        basis, weight = window_nodes(window, 3.0)
        away = basis - (basis @ weight)[:, None]
        moment += (weight * away) @ away.T / len(frame_set.windows)
    inverse, root = (
        _matrix_power(moment, -0.5, PHASE.min_window_variance),
        _matrix_power(moment_px2 / 2, 0.5, PHASE.min_orbit_moment_px2),
    )
    pairs = []
    for psi in np.arange(8) * np.pi / 4:
        c, s = np.cos(psi), np.sin(psi)
        vectors = root @ np.array([[c, s], [-rotation * s, rotation * c]]) @ inverse
        pairs.append((vectors[:, 0], vectors[:, 1]))
    return pairs


def _matrix_power(matrix: FloatArray, exponent: float, least: float) -> FloatArray:
    """A symmetric matrix to some power, its eigenvalues not less than `least`."""
    values, vectors = np.linalg.eigh(matrix)
    result: FloatArray = (vectors * np.maximum(values, least) ** exponent) @ vectors.T
    return result


def vectors_from_axes(vector: FloatArray, phase_rad: float, minor_px: float) -> tuple[FloatArray, FloatArray]:
    """Vectors a and b of v·sin(ωt + ψ) with a minor axis added, across v and a quarter of a cycle later."""
    c, s = np.cos(phase_rad), np.sin(phase_rad)
    minor = minor_px * perpendicular(vector)
    return vector * c - minor * s, vector * s + minor * c


def perpendicular(vector: FloatArray) -> FloatArray:
    """(2,) unit vector a quarter turn from a vector."""
    result: FloatArray = np.array([-vector[1], vector[0]]) / max(float(np.hypot(*vector)), 1e-12)
    return result


def _reverse_rotation(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same ellipse and the same phase along its major axis, run through in the other sense."""
    _, vectors = np.linalg.eigh(np.outer(a, a) + np.outer(b, b))
    mirror = np.eye(2) - 2 * np.outer(vectors[:, 0], vectors[:, 0])
    return mirror @ a, mirror @ b


def _rough_cost(frame_set: FrameSet, dark: FloatArray) -> float:
    planes = frame_set.planes
    weight = frame_set.weights(np.maximum(planes.values, 0))
    light = solve_illumination(planes, weight, dark)
    return float(np.sum(weight * (planes.values - render_illumination(planes, light, dark)) ** 2))


def minor_axis_transfer(basis: FloatArray, weight: FloatArray) -> TransferFunction:
    """In-phase motion by (vx, vy, ψ), with a minor axis β across v and a quarter later, and its square: β, β² after."""

    def motion(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        waveform = np.cos(p[2]) * basis[0] + np.sin(p[2]) * basis[1]
        later = np.cos(p[2]) * basis[1] - np.sin(p[2]) * basis[0]
        transfer, slopes = in_phase_transfer(fx, fy, p[:3], basis, weight)
        n = perpendicular(p[:2])
        side = n[0] * fx + n[1] * fy
        turning, _ = quadrature_transfer(fx, fy, p[:2], waveform[None], weight * later)
        wide, _ = quadrature_transfer(fx, fy, p[:2], waveform[None], weight * later**2)
        slopes = np.concatenate((slopes, [-2j * np.pi * side * turning, -2 * np.pi**2 * side**2 * wide]))
        return transfer + p[3] * slopes[3] + p[4] * slopes[4], slopes

    return motion
