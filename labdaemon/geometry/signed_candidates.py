"""Twins settled jointly: each camera's signed motion and its alternatives, combined over all cameras.

Under coded light one image may show two motions of different phase, twins. The lamp is common to all cameras, so that
the motion in space explains all images at once: each combination of the cameras' candidates is intersected, and what
each image has against its candidate is added to what the rays have against the combination.

Rays alone do not decide where the motion lies in the epipolar plane: one twin in one camera is then an orbit in that
plane. Structures move in phase more often than not, so an orbit that a combination needs, where another one needs none,
speaks against it. The prior is a mixture: most motions are in phase within a few per cent, the others orbits of any
ratio of their axes.
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
        return [phased_candidate(cameras, exterior, motions)]
    found = []
    for chosen in combinations[: INTERSECTION.max_combinations]:
        try:
            candidate = phased_candidate(cameras, exterior, chosen)
        except DataError:
            continue
        penalty = sum(one.excess for one in chosen) + orbit_penalty(candidate)
        found.append(replace(candidate, sign_penalty=penalty))
    if not found:
        return [phased_candidate(cameras, exterior, motions)]
    return sorted(found, key=lambda candidate: candidate.total_cost)


def orbit_penalty(candidate: Candidate) -> float:
    """What the prior has against a motion's minor axis, twice the logarithm of the odds against a straight path."""
    vectors = candidate.motion_mm[1:].T
    left, sizes, right = np.linalg.svd(vectors, full_matrices=False)
    major, minor = float(sizes[0]), float(sizes[1])
    if major <= 0:
        return 0.0
    # The minor axis changes by what is along it, a quarter of a cycle later than the major one.
    slope = np.kron(right[1], left[:, 1])
    variance = float(slope @ candidate.covariance_mm2[3:, 3:] @ slope)
    sd = float(np.hypot(np.sqrt(max(variance, 0.0)) / major, INTERSECTION.in_phase_ratio))
    share = INTERSECTION.orbit_share
    peak = (1 - share) * np.sqrt(2 / np.pi) / sd
    density = peak * np.exp(-((minor / major / sd) ** 2) / 2) + share
    return float(2 * np.log((peak + share) / density))
