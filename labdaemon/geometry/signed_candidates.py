"""Twins settled jointly: each camera's signed motion and its alternatives, combined over all cameras.

Under coded light one image may show two motions of different phase, twins. The lamp is common to all cameras, so that
the motion in space explains all images at once: each combination of the cameras' candidates is intersected, and what
each image has against its candidate is added to what the rays have against the combination.

Rays alone do not decide where the motion lies in the epipolar plane: one twin in one camera is then an orbit in that
plane. Structures move in phase more often than not, so an orbit that a combination needs, where another one needs none,
speaks against it. The prior is a mixture: most motions are in phase within a few per cent, the others orbits of any
ratio of their axes.

The same prior belongs into what is reported. A camera that looks along the path sees a small motion of which it hardly
knows the phase, and in the epipolar plane the rays turn the difference of two phases into an orbit. So the free motion
and the one whose minor axis is held by the prior are weighed by their odds; their mean and covariance are reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray, ImageMotion
from labdaemon.geometry.motion_adjustment import Candidate
from labdaemon.geometry.motion_candidates import phased_candidate
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION


def signed_candidates(
    cameras: Sequence[OrientedCamera], exterior: FloatArray, motions: Sequence[ImageMotion]
) -> list[Candidate]:
    """Solutions of signed vectors for all combinations of the images' alternatives, the best first.

    Parameters
    ----------
    cameras, exterior, motions
        As for `phased_candidate`.

    Returns
    -------
    list of Candidate
        One for each combination; what is known otherwise is in `sign_penalty`.

    Raises
    ------
    DataError
        The rays of the best combination do not meet.
    """
    choices = [
        sorted((motion, *motion.alternatives), key=lambda one: one.excess)[: INTERSECTION.max_alternatives]
        for motion in motions
    ]
    combinations = sorted(product(*choices), key=lambda chosen: sum(one.excess for one in chosen))
    if len(combinations) == 1:
        return [with_phase_prior(phased_candidate(cameras, exterior, motions))]
    found = []
    for chosen in combinations[: INTERSECTION.max_combinations]:
        try:
            candidate = phased_candidate(cameras, exterior, chosen)
        except DataError:
            continue
        penalty = sum(one.excess for one in chosen) + orbit_penalty(candidate)
        found.append(replace(with_phase_prior(candidate), sign_penalty=penalty))
    if not found:
        return [with_phase_prior(phased_candidate(cameras, exterior, motions))]
    return sorted(found, key=lambda candidate: candidate.total_cost)


def orbit_penalty(candidate: Candidate) -> float:
    """What the prior has against a motion's minor axis, twice the logarithm of the odds against a straight path."""
    straight, orbit = _prior_odds(candidate)
    peak = _prior_peak(candidate)
    return float(2 * np.log((peak + orbit) / (straight + orbit)))


def with_phase_prior(candidate: Candidate) -> Candidate:
    """A candidate, its minor axis known as well as the prior says: the mean over motions in phase and orbits.

    Parameters
    ----------
    candidate
        Signed vectors as the rays alone have them.
    """
    straight, orbit = _prior_odds(candidate)
    if straight <= 0:
        return candidate
    share = straight / (straight + orbit)
    free, covariance = candidate.motion_mm.ravel(), candidate.covariance_mm2
    held, held_covariance = _in_phase(free, covariance)
    away = held - free
    mean = free + share * away
    total = share * held_covariance + (1 - share) * covariance + share * (1 - share) * np.outer(away, away)
    return replace(candidate, motion_mm=mean.reshape(3, 3), covariance_mm2=total)


def _prior_odds(candidate: Candidate) -> tuple[float, float]:
    """Prior densities of the ratio of the axes that was found: of motions in phase, and of orbits."""
    major, minor, sd = _axis_ratio(candidate)
    if major <= 0:
        return 0.0, INTERSECTION.orbit_share
    return _prior_peak(candidate) * float(np.exp(-((minor / major / sd) ** 2) / 2)), INTERSECTION.orbit_share


def _prior_peak(candidate: Candidate) -> float:
    """Density of a straight path among motions in phase, for the sd of the ratio."""
    major, _, sd = _axis_ratio(candidate)
    return float((1 - INTERSECTION.orbit_share) * np.sqrt(2 / np.pi) / sd) if major > 0 else 0.0


def _axis_ratio(candidate: Candidate) -> tuple[float, float, float]:
    """Major and minor semi-axis, and the sd of their ratio where the motion is in phase."""
    vectors = candidate.motion_mm[1:].T
    left, sizes, right = np.linalg.svd(vectors, full_matrices=False)
    major, minor = float(sizes[0]), float(sizes[1])
    # The minor axis changes by what is along it, a quarter of a cycle later than the major one.
    slope = np.kron(right[1], left[:, 1])
    variance = float(slope @ candidate.covariance_mm2[3:, 3:] @ slope)
    return major, minor, float(np.hypot(np.sqrt(max(variance, 0.0)) / max(major, 1e-12), INTERSECTION.in_phase_ratio))


def _in_phase(free: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean position, a and b (9,) with the prior of motions in phase on the minor axis, and their covariance (9, 9).

    The minor axis b cos ψ − a sin ψ, with ψ the phase of the major one, has two components across the path; each is
    0 ± `in_phase_ratio` of the major axis. The path and its phase change with every step, so that steps are repeated.
    """
    value, held = free, covariance
    for _ in range(INTERSECTION.in_phase_steps):
        a, b = value[3:6], value[6:]
        phase = float(np.angle(np.sum((a + 1j * b) ** 2)) / 2)
        path = a * np.cos(phase) + b * np.sin(phase)
        size = float(np.linalg.norm(path))
        across = np.linalg.svd(path[None] / max(size, 1e-12))[2][1:]
        rows = np.zeros((2, 9))
        rows[:, 3:6], rows[:, 6:] = -np.sin(phase) * across, np.cos(phase) * across
        variance = (INTERSECTION.in_phase_ratio * size) ** 2
        gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + variance * np.eye(2))
        before, value = value, free - gain @ (rows @ free)
        held = covariance - gain @ rows @ covariance
        if float(np.abs(value - before).max()) < INTERSECTION.in_phase_step_mm:
            break
    return value, (held + held.T) / 2
