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

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.image_combinations import combine_images
from labdaemon.geometry.motion import FloatArray, ImageMotion
from labdaemon.geometry.motion_adjustment import Candidate, nearest_point
from labdaemon.geometry.motion_candidates import phased_candidate
from labdaemon.geometry.orbit_prior import UNKNOWN_CAPTURE, AxisRatio, OrbitPrior
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.half_turn import major_phase_rad


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
    combinations = combine_images(
        cameras, motions, nearest_point(cameras, [motion.mean_px for motion in motions]), prior
    )
    if len(combinations) == 1:
        return [with_phase_prior(phased_candidate(cameras, exterior, motions), prior)]
    found: list[SignedCandidate] = []
    for chosen in combinations:
        try:
            candidate = with_phase_prior(phased_candidate(cameras, exterior, chosen), prior)
        except DataError:
            continue
        excess = sum(one.excess for one in chosen) + _rest_excess(cameras, motions, chosen, candidate)
        ratio = candidate.axis_ratio
        penalty = excess + (0.0 if ratio is None else ratio.penalty(prior))
        found.append(replace(candidate, sign_penalty=penalty, image_excess=excess))
    if not found:
        return [with_phase_prior(phased_candidate(cameras, exterior, motions), prior)]
    return sorted(found, key=lambda candidate: candidate.total_cost)


def _rest_excess(
    cameras: Sequence[OrientedCamera],
    motions: Sequence[ImageMotion],
    chosen: Sequence[ImageMotion],
    candidate: Candidate,
) -> float:
    """What the places of rest have against a combination, less what each image has against its own candidate.

    An image knows its mean position the better the better its phase is known. With the motion as all cameras have it
    that position is another, and so is its distance from rest.
    """
    total = 0.0
    for camera, motion, one in zip(cameras, motions, chosen, strict=True):
        if motion.rest is None:
            continue
        jacobian = camera.project_with_jacobians(candidate.motion_mm[:1])[1][0]
        by_motion = np.kron(np.eye(2), jacobian)
        covariance = one.covariance_px2
        gain = covariance[:2, 2:] @ np.linalg.inv(covariance[2:, 2:] + INTERSECTION.floor_px2 * np.eye(4))
        away = by_motion @ candidate.motion_mm[1:].ravel() - np.concatenate((one.a_px, one.b_px))
        known = covariance[:2, :2] - gain @ covariance[2:, :2]
        known = known + gain @ by_motion @ candidate.covariance_mm2[3:, 3:] @ by_motion.T @ gain.T
        total += motion.rest.excess(one.mean_px + gain @ away, known)
        total -= motion.rest.excess(one.mean_px, covariance[:2, :2])
    return total


def cluster_candidates(candidates: Sequence[SignedCandidate]) -> list[SignedCandidate]:
    """Candidates that are one motion for any practical purpose as their mixture, the most likely one first.

    Parameters
    ----------
    candidates
        The best first.

    Returns
    -------
    list of SignedCandidate
        Moments of each mixture, so that the spread of its members is in the covariance; what it costs is by the sum of
        their probabilities.
    """
    scale = max(1.0, candidates[0].cost / candidates[0].freedom) if candidates[0].freedom > 0 else 1.0
    clusters: list[list[SignedCandidate]] = []
    for one in candidates:
        near = next((cluster for cluster in clusters if not _are_apart(cluster[0], one)), None)
        if near is None:
            clusters.append([one])
        else:
            near.append(one)
    return sorted((_mixture(cluster, scale) for cluster in clusters), key=lambda candidate: candidate.total_cost)


def _are_apart(first: SignedCandidate, second: SignedCandidate) -> bool:
    """Whether two candidates are two motions, in phase, direction or length."""
    sizes = [float(np.linalg.norm(one.motion_mm[1:])) for one in (first, second)]
    return float(np.linalg.norm((second.motion_mm - first.motion_mm)[1:])) > INTERSECTION.motions_apart * max(sizes)


def _mixture(members: Sequence[SignedCandidate], scale: float) -> SignedCandidate:
    best = members[0]
    if len(members) == 1:
        return best
    weight = np.exp([-(one.total_cost - best.total_cost) / (2 * scale) for one in members])
    total = float(weight.sum())
    weight /= total
    motions = np.array([one.motion_mm.ravel() for one in members])
    mean = weight @ motions
    away = motions - mean
    covariance = np.tensordot(weight, np.array([one.covariance_mm2 for one in members]), 1)
    covariance += (weight * away.T) @ away
    return replace(
        best,
        motion_mm=mean.reshape(3, 3),
        covariance_mm2=covariance,
        sign_penalty=best.sign_penalty - 2 * scale * float(np.log(total)),
    )


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
        phase = major_phase_rad(a, b)
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
