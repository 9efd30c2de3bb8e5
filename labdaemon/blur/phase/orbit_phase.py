"""Orbits with a poorly determined phase or direction of rotation: all of them, weighted by their probability.

The shape of a small orbit shows by its widening of the dot, its phase and sense only by the skew. What is reported is
the best of them, with the covariance of all.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.phase.in_phase import PhaseProfile
from labdaemon.blur.phase.orbits import perpendicular, vectors_from_axes
from labdaemon.blur.phase.phase_arc import PhaseTable, condition_on_phase
from labdaemon.blur.settings import PHASE
from labdaemon.blur.smear.fit_problem import TransferFunction
from labdaemon.blur.smear.frame_set import FRAME_PARAMETERS, FrameSet, TransferFactory
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import quadrature_transfer
from labdaemon.half_turn import major_phase_rad

PHASES_PER_ROTATION = PHASE.phase_count // 2  # phases of each sense over which the probabilities are summed


def marginalise_orbit_phase(
    frame_set: FrameSet, profile: PhaseProfile, best: Solution, value: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, tuple[PhaseTable, ...]]:
    """Sum up an orbit over all phases and both senses.

    Parameters
    ----------
    profile
        The in-phase motion that fits best.
    best, value, covariance
        The orbit that fits best, its (6,) x, y, ax, ay, bx, by and their linear covariance.

    Returns
    -------
    covariance, tables
        (6, 6) about the best solution; where the phase hardly shows the orbits of each direction of rotation at all
        phases, else nothing.
    """
    minor_px = float(np.linalg.svd(value[2:].reshape(2, 2), compute_uv=False)[1])
    phases = profile.phase_rad
    fine = np.linspace(0, 2 * np.pi, PHASES_PER_ROTATION + 1)[:-1]
    costs, places = [], []
    for rotation in (1.0, -1.0):
        found = [
            _solve_orbit_at_phase(frame_set, profile, best, index, rotation * minor_px, float(phase))
            for index, phase in enumerate(phases)
        ]
        table = np.array([[cost, *motion] for cost, motion in found])
        spline = CubicSpline(
            np.append(phases, phases[0] + 2 * np.pi), np.vstack((table, table[:1])), bc_type="periodic"
        )
        costs.append(spline(fine)[:, 0])
        places.append(spline(fine)[:, 1:])
    cost, others = np.array(costs), np.array(places)
    probability = np.exp(-(cost - cost.min()) / (2 * max(best.chi2, 1.0)))
    probability /= probability.sum()
    away = others - value
    near = int(np.argmin(cost.min(axis=1)))
    own = probability[near] / probability[near].sum()
    size2 = float(value[2:] @ value[2:])
    phase_unresolved = float(own @ np.sum(away[near, :, 2:] ** 2, axis=1)) > PHASE.linear_phase_sd_rad**2 * size2
    if not phase_unresolved and probability[1 - near].sum() < PHASE.min_probability:
        return covariance, ()
    flat, weight = away.reshape(-1, 6), probability.reshape(-1)
    held = condition_on_phase(value, covariance)
    phase = major_phase_rad(value[2:4], value[4:])
    excess = (cost - cost.min()) / max(best.chi2, 1.0)
    tables = tuple(PhaseTable(fine, one, motion, held, phase) for one, motion in zip(excess, others, strict=True))
    return held + (weight * flat.T) @ flat, tables if phase_unresolved else ()


def _solve_orbit_at_phase(
    frame_set: FrameSet, profile: PhaseProfile, best: Solution, index: int, minor_px: float, phase_rad: float
) -> tuple[float, FloatArray]:
    """Cost of an orbit with its major axis at a phase, and its (6,) x, y, ax, ay, bx, by."""
    fixed = frame_set.with_fixed_shape()
    v = profile.vector_px[index]
    start = fixed.initial_parameters(*vectors_from_axes(v, phase_rad, minor_px), np.append(v, minor_px))
    reach = 3.0 + 1.5 * float(np.hypot(*v))
    kept = best.weight
    found = solve(
        fixed.planes,
        lambda _: kept,
        fixed.forward_model(_orbit_transfer_at_phase(phase_rad), reach),
        start,
        fixed.prior(3),
        bound=_keep_rotation(minor_px),
        light=best.light,
        max_iterations=6,
        tolerance=0.2,
    )
    frames = len(frame_set.problems)
    place = found.p[: FRAME_PARAMETERS * frames].reshape(frames, FRAME_PARAMETERS)[:, :2].mean(axis=0)
    return found.cost, np.concatenate((place, *vectors_from_axes(found.p[-3:-1], phase_rad, float(found.p[-1]))))


def _keep_rotation(minor_px: float) -> Callable[[FloatArray], FloatArray]:
    rotation = np.sign(minor_px)

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[-1] = rotation * max(rotation * p[-1], 0.0)
        return p

    return bound


def _orbit_transfer_at_phase(phase_rad: float) -> TransferFactory:
    """Orbits by (vx, vy, β): major axis v at a held phase, minor axis β a quarter turn from it and a quarter later."""

    def of(basis: FloatArray, weight: FloatArray) -> TransferFunction:
        c, s = np.cos(phase_rad), np.sin(phase_rad)
        waveforms = np.stack((c * basis[0] + s * basis[1], c * basis[1] - s * basis[0]))

        def motion(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
            n, size = perpendicular(p[:2]), max(float(np.hypot(*p[:2])), 1e-9)
            transfer, by_vectors = quadrature_transfer(fx, fy, np.concatenate((p[:2], p[2] * n)), waveforms, weight)
            # The minor axis turns with the major one.
            along = p[:2] / size
            by_turn = -p[2] / size * (along[0] * by_vectors[2] + along[1] * by_vectors[3])
            slopes = np.stack(
                (
                    by_vectors[0] + n[0] * by_turn,
                    by_vectors[1] + n[1] * by_turn,
                    n[0] * by_vectors[2] + n[1] * by_vectors[3],
                )
            )
            return transfer, slopes

        return motion

    return of
