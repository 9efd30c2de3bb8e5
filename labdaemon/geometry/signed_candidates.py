"""Twins settled jointly: each camera's signed motion and its alternatives, combined over all cameras.

Under coded light one image may show two motions of different phase, twins. The lamp is common to all cameras, so that
the motion in space explains all images at once: each combination of the cameras' candidates is intersected, and what
each image has against its candidate is added to what the rays have against the combination.

Rays alone do not decide where the motion lies in the epipolar plane: one twin in one camera is then an orbit in that
plane. Structures move in phase more often than not, so an orbit that a combination needs, where another one needs none,
speaks against it (`orbit_prior`).

The same prior belongs into what is reported. A camera that looks along the path sees a small motion of which it hardly
knows the phase, and in the epipolar plane the rays turn the difference of two phases into an orbit. So the free motion
and the one whose minor axis is held by the prior are weighed by their odds; their mean and covariance are reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray, ImageMotion
from labdaemon.geometry.motion_adjustment import Candidate
from labdaemon.geometry.motion_candidates import phased_candidate
from labdaemon.geometry.orbit_prior import UNKNOWN_CAPTURE, AxisRatio, OrbitPrior
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION


@dataclass(frozen=True, slots=True, eq=False)
class SignedCandidate(Candidate):
    """A combination of the images' candidates.

    Attributes
    ----------
    image_excess
        What the images have against their candidates, a part of `sign_penalty`; the rest is the prior's.
    axis_ratio
        As the rays alone have it; None at rest.
    """

    image_excess: float = 0.0
    axis_ratio: AxisRatio | None = None


def signed_candidates(
    cameras: Sequence[OrientedCamera],
    exterior: FloatArray,
    motions: Sequence[ImageMotion],
    prior: OrbitPrior = UNKNOWN_CAPTURE,
) -> list[SignedCandidate]:
    """Solutions of signed vectors for all combinations of the images' alternatives, the best first.

    Parameters
    ----------
    cameras, exterior, motions
        As for `phased_candidate`.
    prior
        Of motions in phase and orbits.

    Returns
    -------
    list of SignedCandidate
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
        return [with_phase_prior(phased_candidate(cameras, exterior, motions), prior)]
    found: list[SignedCandidate] = []
    for chosen in combinations[: INTERSECTION.max_combinations]:
        try:
            candidate = with_phase_prior(phased_candidate(cameras, exterior, chosen), prior)
        except DataError:
            continue
        excess = sum(one.excess for one in chosen)
        ratio = candidate.axis_ratio
        penalty = excess + (0.0 if ratio is None else ratio.penalty(prior))
        found.append(replace(candidate, sign_penalty=penalty, image_excess=excess))
    if not found:
        return [with_phase_prior(phased_candidate(cameras, exterior, motions), prior)]
    return sorted(found, key=lambda candidate: candidate.total_cost)


def with_phase_prior(candidate: Candidate, prior: OrbitPrior = UNKNOWN_CAPTURE) -> SignedCandidate:
    """A candidate, its minor axis known as well as the prior says: the mean over motions in phase and orbits.

    Parameters
    ----------
    candidate
        Signed vectors as the rays alone have them.
    prior
        Of motions in phase and orbits.
    """
    free, covariance = candidate.motion_mm.ravel(), candidate.covariance_mm2
    ratio = AxisRatio.of_motion(candidate.motion_mm, covariance)
    share = 0.0 if ratio is None else ratio.straight_probability(prior)
    mean, total = free, covariance
    if share > 0:
        held, held_covariance = _in_phase(free, covariance, prior.in_phase_ratio)
        away = held - free
        mean = free + share * away
        total = share * held_covariance + (1 - share) * covariance + share * (1 - share) * np.outer(away, away)
    return SignedCandidate(
        mean.reshape(3, 3), total, candidate.cost, candidate.freedom, candidate.worst_px, axis_ratio=ratio
    )


def _in_phase(free: FloatArray, covariance: FloatArray, in_phase_ratio: float) -> tuple[FloatArray, FloatArray]:
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
        variance = (in_phase_ratio * size) ** 2
        gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + variance * np.eye(2))
        before, value = value, free - gain @ (rows @ free)
        held = covariance - gain @ rows @ covariance
        if float(np.abs(value - before).max()) < INTERSECTION.in_phase_step_mm:
            break
    return value, (held + held.T) / 2
