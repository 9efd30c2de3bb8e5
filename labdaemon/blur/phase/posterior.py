"""What is known of an in-phase motion once its phase has been tried all round: each phase weighted by its probability.

Where the phase shows well the linear covariance of the fit holds. Where it hardly does (far below a pixel) the phase
may be anywhere along a valley, and the covariance is that of all of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.in_phase import PhaseProfile
from labdaemon.blur.phase.phase_arc import PhaseTable
from labdaemon.blur.settings import PHASE

MIN_PHASE_VARIANCE = 1e-12
"""Variance below which the phase was held. Numerics."""


@dataclass(frozen=True, slots=True, eq=False)
class InPhaseMotion:
    """An in-phase motion v·sin(ωt + ψ).

    Attributes
    ----------
    axis, axis_covariance
        (4,) and (4, 4) x, y, vx, vy, whatever the phase.
    value, covariance
        (6,) and (6, 6) x, y, ax, ay, bx, by: the same in terms of the phase.
    table
        The motions at all phases, where the phase shows less well than its circle is straight; else None.
    """

    axis: FloatArray
    axis_covariance: FloatArray
    value: FloatArray
    covariance: FloatArray
    table: PhaseTable | None = None


def marginalise_phase(
    profile: PhaseProfile, p: FloatArray, covariance: FloatArray, unrefined: FloatArray, inflation: float
) -> InPhaseMotion:
    """The motion and its covariance over all phases.

    Parameters
    ----------
    profile
        Costs at all phases.
    p, covariance
        (5,) and (5, 5) x, y, vx, vy, ψ of the best solution and their linear covariance; of a single frame that
        hardly shows its phase with that held.
    unrefined
        (5,) the same without the paper texture in the weights.
    inflation
        Variance with the paper texture in the weights over that without, by which costs of the profile count less.
    """
    phases, cost, others = _fine_profile(profile, inflation)
    probability = np.exp(-cost / 2)
    value = in_phase_vectors(p[None])[0]
    # Other valleys of the phase are other motions, which are reported as alternatives.
    near, place = probability, int(np.argmin(np.abs(np.angle(np.exp(1j * (phases - p[4]))))))
    if profile.periodic:
        near = np.where(_wall_height(cost, place) > PHASE.barrier_cost, 0.0, probability)
    scatter = 2 * float(near @ (1 - np.cos(phases - p[4]))) / max(float(near.sum()), 1e-300)
    is_held = covariance[4, 4] < MIN_PHASE_VARIANCE
    is_linear = not is_held and max(covariance[4, 4], scatter) < PHASE.linear_phase_sd_rad**2
    if profile.is_narrow or is_linear:
        v = p[2:4]
        jacobian = in_phase_jacobian(p)
        # The circle of phases leaves its tangent by half the square of the phase's standard deviation: less than the
        # amplitude's own, or the tangents of two cameras would seem to cross at one phase.
        along = v / max(float(np.hypot(*v)), 1e-12)
        part = float(np.sqrt(along @ covariance[2:4, 2:4] @ along)) / max(float(np.hypot(*v)), 1e-12)
        bent = bool(covariance[4, 4] > part)
        table = _linear_table(p, covariance) if bent else None
        return InPhaseMotion(p[:4], covariance[:4, :4], value, jacobian @ covariance @ jacobian.T, table)
    at_phase = covariance[:4, :4] - np.outer(covariance[:4, 4], covariance[4, :4]) / max(covariance[4, 4], 1e-12)
    # The profile's weights are those of independent noise: all its motions differ as the one at the best phase does.
    others[:, :4] += p[:4] - (others[place, :4] if profile.periodic else unrefined[:4])
    table = PhaseTable(phases, cost, in_phase_vectors(others), _at_phase(at_phase, float(p[4])), float(p[4]))
    probability /= probability.sum()
    axis = probability @ others[:, :4]
    if profile.periodic:
        # Far below a pixel valleys are no parabolas, and their mean errs less than the most likely phase.
        mean_phase = float(np.angle(near @ np.exp(1j * phases)))
        value = in_phase_vectors(np.append(axis, mean_phase)[None])[0]
    total = _weighted_scatter(probability, table.motion_px - value)
    for weight, phase in zip(probability, phases, strict=True):
        total += weight * _at_phase(at_phase, float(phase))
    bent = profile.periodic or scatter > PHASE.linear_phase_sd_rad**2
    axis_covariance = at_phase + _weighted_scatter(probability, others[:, :4] - axis)
    return InPhaseMotion(axis, axis_covariance, value, total, table if bent else None)


def _linear_table(p: FloatArray, covariance: FloatArray) -> PhaseTable:
    """The motions at all phases about the best one, in linear terms."""
    variance = max(float(covariance[4, 4]), MIN_PHASE_VARIANCE)
    away = np.linspace(-PHASE.arc_sds, PHASE.arc_sds, PHASE.phase_count) * np.sqrt(variance)
    others = p + np.outer(away, covariance[:, 4] / variance)
    at_phase = covariance[:4, :4] - np.outer(covariance[:4, 4], covariance[4, :4]) / variance
    phase = float(p[4])
    return PhaseTable(others[:, 4], away**2 / variance, in_phase_vectors(others), _at_phase(at_phase, phase), phase)


def _weighted_scatter(probability: FloatArray, away: FloatArray) -> FloatArray:
    result: FloatArray = (probability * away.T) @ away
    return result


def in_phase_jacobian(p: FloatArray) -> FloatArray:
    """(6, 5) derivatives of x, y, ax, ay, bx, by by x, y, vx, vy, ψ."""
    c, s, v = np.cos(p[4]), np.sin(p[4]), p[2:4]
    jacobian = np.zeros((6, 5))
    jacobian[:, :4] = _vector_jacobian(float(p[4]))
    jacobian[2:, 4] = np.concatenate((-s * v, c * v))
    return jacobian


def _at_phase(covariance: FloatArray, phase_rad: float) -> FloatArray:
    """(6, 6) covariance of x, y, a, b of a (4, 4) one of x, y, v at a held phase."""
    jacobian = _vector_jacobian(phase_rad)
    result: FloatArray = jacobian @ covariance @ jacobian.T
    return result


def _vector_jacobian(phase_rad: float) -> FloatArray:
    """(6, 4) derivative of x, y, a, b by x, y, v."""
    result = np.zeros((6, 4))
    result[:2, :2] = np.eye(2)
    result[2:4, 2:], result[4:, 2:] = np.cos(phase_rad) * np.eye(2), np.sin(phase_rad) * np.eye(2)
    return result


def in_phase_vectors(in_phase: FloatArray) -> FloatArray:
    """(n, 6) x, y, ax, ay, bx, by of (n, 5) x, y, vx, vy, ψ."""
    c, s = np.cos(in_phase[:, 4:]), np.sin(in_phase[:, 4:])
    return np.concatenate((in_phase[:, :2], c * in_phase[:, 2:4], s * in_phase[:, 2:4]), axis=1)


def _fine_profile(profile: PhaseProfile, inflation: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(m,) phases finely, (m,) the cost of each less the least, squared sd, and (m, 5) x, y, vx, vy, ψ there."""
    at, table = profile.phase_rad, np.column_stack((profile.cost, profile.centre_px, profile.vector_px))
    if profile.periodic:
        at, table = np.append(at, at[0] + 2 * np.pi), np.vstack((table, table[:1]))
        phases = np.linspace(at[0], at[-1], PHASE.phase_count + 1)[:-1]
        values = CubicSpline(at, table, bc_type="periodic")(phases)
    else:
        # Over the sine of the phase at the middle of the exposure, which is all that the image depends on.
        phases = np.linspace(at[0], at[-1], PHASE.phase_count)
        middle = (at[0] + at[-1]) / 2
        sines = np.sin(at - middle)
        values = PchipInterpolator(sines, table)(np.clip(np.sin(phases - middle), sines[0], sines[-1]))
    cost = (values[:, 0] - values[:, 0].min()) / (max(profile.best.chi2, 1.0) * inflation)
    return phases, cost, np.column_stack((values[:, 1:], phases))


def _wall_height(cost: FloatArray, place: int) -> FloatArray:
    """(n,) highest cost on the lower of the two ways round the circle from one place to each."""
    cost = np.roll(cost, -place)
    wall = np.minimum(np.maximum.accumulate(cost), np.maximum.accumulate(cost[::-1])[::-1])
    result: FloatArray = np.roll(wall, place)
    return result


def is_bimodal(profile: PhaseProfile) -> bool:
    """Whether two phases with a height between them cost the same; a profile that is low all round has but one.

    A single frame's phase has its mirror image in time, which is another unless both are within its standard deviation.
    """
    if not profile.periodic:
        middle = (profile.phase_rad[0] + profile.phase_rad[-1]) / 2
        return bool(np.pi - 2 * abs(profile.phase - middle) > 3 * min(profile.sd_phase, PHASE.linear_phase_sd_rad))
    if profile.is_narrow:
        return False
    scale = max(profile.best.chi2, 1.0)
    cost = (profile.cost - profile.cost.min()) / scale
    wall = _wall_height(cost, int(np.argmin(cost)))
    return bool(np.any((cost < PHASE.rival_cost) & (wall > PHASE.barrier_cost)))
