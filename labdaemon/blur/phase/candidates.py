"""Solutions of one fit weighed against each other with the paper texture in the weights: the best, and its rivals.

A rival in the same valley of the phase widens the covariance. One in another valley, a twin under coded light, is
reported with its excess, since several cameras decide between twins together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import AlternativeMotion, AmbientEstimate
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.phase_arc import PhaseTable
from labdaemon.blur.phase.valley_width import widen_by_valley
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.frame_set import FrameSet, TransferFactory
from labdaemon.blur.smear.gls_frames import compare_solutions, gls_refine_frames
from labdaemon.blur.smear.uncertainty import windowed_covariance
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.texture_settings import TEXTURE

MotionVectors = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From all parameters (k,) to x, y, ax, ay, bx, by (6,) and their derivatives (6, k)."""

UnmodelledCovariance = Callable[[FloatArray], FloatArray]
"""From x, y, ax, ay, bx, by (6,) to a covariance of them (6, 6)."""


@dataclass(frozen=True, slots=True, eq=False)
class WeighedMotion:
    """What is reported of the best solution.

    Attributes
    ----------
    covariance
        (6, 6) with the rivals of the same valley in it.
    alternatives
        Those of other valleys.
    axis_scatter_px2
        (2, 2) scatter of the semi-axis over the valley.
    table
        The motions at all phases of the valley, where it is wider than linear terms say.
    """

    covariance: FloatArray
    alternatives: tuple[AlternativeMotion, ...]
    axis_scatter_px2: FloatArray
    table: PhaseTable | None


@dataclass(frozen=True, slots=True, eq=False)
class WeighedCandidates:
    """A fit's solutions by their likelihood.

    Attributes
    ----------
    transfer_factory
        The kind of motion.
    best, refined
        The most likely one, and the same after its last steps with the paper texture in the weights.
    rivals
        Others, refined likewise.
    excess
        Twice the logarithm of the odds of the best against each of them.
    """

    transfer_factory: TransferFactory
    best: Solution
    refined: Solution
    rivals: tuple[Solution, ...]
    excess: tuple[float, ...]

    def report(
        self,
        frame_set: FrameSet,
        value: FloatArray,
        covariance: FloatArray,
        unmodelled: UnmodelledCovariance,
        vectors: MotionVectors,
    ) -> WeighedMotion:
        """The covariance with rivals of the same valley in it, and those of other valleys.

        Parameters
        ----------
        frame_set
            The frames that were fitted.
        value, covariance
            (6,) and (6, 6) x, y, a, b of the best and their covariance.
        unmodelled
            What the fit does not know of (a straight path's minor axis), a part of the covariance.
        vectors
            From all parameters to x, y, a, b.
        """
        alternatives: list[AlternativeMotion] = []
        covariance, axis_scatter_px2, table = widen_by_valley(frame_set, self.best, value, covariance)
        total, weight = covariance.copy(), 1.0
        phasor = value[2:4] + 1j * value[4:6]
        for rival, excess in zip(self.rivals, self.excess, strict=True):
            other, by_parameters = vectors(rival.p)
            turn = np.angle(np.vdot(phasor, other[2:4] + 1j * other[4:6]))
            if abs(turn) < LIGHT.same_valley_rad:
                odds = float(np.exp(-max(excess, 0.0) / 2))
                away = other - value
                total += odds * (covariance + np.outer(away, away))
                weight += odds
            elif excess < LIGHT.rival_limit:
                # A code shows some phases several times better than others: each motion has its own covariance.
                full = windowed_covariance(rival, frame_set, self.transfer_factory)
                own = by_parameters @ full @ by_parameters.T + unmodelled(other)
                own, _, _ = widen_by_valley(frame_set, rival, other, own)
                ambient = ambient_estimate(frame_set, rival, full, by_parameters)
                one = AlternativeMotion(other[:2], other[2:4], other[4:], own, excess, ambient)
                if all(abs(_turn_between(one, kept)) > LIGHT.same_valley_rad / 2 for kept in alternatives):
                    alternatives.append(one)
        return WeighedMotion(total / weight, tuple(alternatives), axis_scatter_px2, table)


def weigh_candidates(
    frame_set: FrameSet, solutions: Sequence[Solution], transfer_factory: TransferFactory
) -> WeighedCandidates:
    """Refine and compare solutions.

    Parameters
    ----------
    frame_set
        The target in its frames.
    solutions
        Of one kind of motion under common weights, the best first.
    transfer_factory
        The kind of motion.
    """
    scale = max(solutions[0].chi2, LIGHT.min_noise_scale)
    if isinstance(frame_set.sharp.form, TexturedPatch):
        scale *= TEXTURE.twin_scale
    close = [one for one in solutions if one.cost - solutions[0].cost < 2 * LIGHT.rival_limit * scale]
    if len(close) == 1:
        refined = gls_refine_frames(frame_set, close[0], transfer_factory)
        return WeighedCandidates(transfer_factory, close[0], refined, (), ())
    costs = np.array(compare_solutions(frame_set, close, transfer_factory))
    order = np.argsort(costs)
    best, *rivals = [gls_refine_frames(frame_set, close[index], transfer_factory) for index in order]
    excess = (costs[order] - costs[order[0]]) / scale
    return WeighedCandidates(
        transfer_factory, close[int(order[0])], best, tuple(rivals), tuple(float(one) for one in excess[1:])
    )


def _turn_between(first: AlternativeMotion, second: AlternativeMotion) -> float:
    """Phase of the second motion, less that of the first."""
    return float(np.angle(np.vdot(first.a_px + 1j * first.b_px, second.a_px + 1j * second.b_px)))


def ambient_estimate(
    frame_set: FrameSet, solution: Solution, covariance: FloatArray, by_parameters: FloatArray
) -> AmbientEstimate | None:
    """What a solution says of the ambient light; None where that is no parameter.

    Parameters
    ----------
    frame_set, solution
        What was fitted.
    covariance
        (k, k) of all parameters.
    by_parameters
        (6, k) derivatives of x, y, a, b.
    """
    if not frame_set.ambient_count:
        return None
    place = frame_set.first_motion - 1
    return AmbientEstimate(
        float(solution.p[place]),
        float(covariance[place, place]),
        by_parameters @ covariance[:, place],
        frame_set.sd_ambient**2,
    )
