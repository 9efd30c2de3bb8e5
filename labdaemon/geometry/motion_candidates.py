"""Which solution is meant when cameras see a path without its phase: ends of straight motion, roots of an orbit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray, ImageMotion
from labdaemon.geometry.motion_adjustment import Candidate, adjust_motion, nearest_point
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.orbit_axes import principal_axes, second_moment, second_moment_covariance, second_moment_jacobian


def straight_candidates(
    cameras: Sequence[OrientedCamera],
    exterior: FloatArray,
    motions: Sequence[ImageMotion],
    evidence: Sequence[float] | None = None,
) -> list[Candidate]:
    """Solutions of a straight motion for the 2^(n−1) ways of matching its ends, the better two, best first.

    A path's end carries no name, so each further camera may have its two the other way round, which is its a with the
    other sign. All combinations are judged by a linear adjustment of a alone, the best two in full.

    Parameters
    ----------
    cameras, exterior, motions
        As for `join`.
    evidence
        For each camera, twice the logarithm of the odds that its a points to where the target stood at one instant
        that all cameras share (the middle of the exposure).
    """
    known = np.zeros(len(cameras)) if evidence is None else np.asarray(evidence, dtype=float)
    start = np.zeros((3, 3))
    start[0] = nearest_point(cameras, [motion.mean_px for motion in motions])
    ranked = []
    for signs in product(*[(1.0,)] + [(1.0, -1.0)] * (len(cameras) - 1)):
        vector, cost = _linear_vector(cameras, motions, signs, start[0])
        sign_penalty = sign_penalty_of(known, signs)
        ranked.append((cost + sign_penalty, signs, vector, sign_penalty))
    ranked.sort(key=lambda entry: entry[0])
    result = []
    for _, signs, vector, sign_penalty in ranked[:2]:
        try:
            candidate = _adjust_straight(cameras, exterior, motions, signs, np.stack([start[0], vector, np.zeros(3)]))
        except DataError:
            continue  # ends matched wrongly may put the path behind a camera
        result.append(replace(candidate, sign_penalty=sign_penalty))
    if not result:
        raise DataError("no way of matching the ends of its path puts it in front of the cameras")
    return sorted(result, key=lambda candidate: candidate.total_cost)


def sign_penalty_of(evidence: FloatArray, signs: Sequence[float]) -> float:
    """What the cameras' evidence has against one way of matching the ends, whichever of the two ends it was."""
    believed = np.clip(evidence, -INTERSECTION.max_evidence, INTERSECTION.max_evidence) * np.asarray(signs)
    return float(min(np.sum(np.maximum(believed, 0.0)), np.sum(np.maximum(-believed, 0.0))))


def _adjust_straight(
    cameras: Sequence[OrientedCamera],
    exterior: FloatArray,
    motions: Sequence[ImageMotion],
    signs: Sequence[float],
    start: FloatArray,
) -> Candidate:
    """Straight motion with each camera's a taken with a sign."""
    flips = [np.array([1.0, 1.0, sign, sign]) for sign in signs]
    candidate = adjust_motion(
        cameras,
        exterior,
        [np.concatenate([m.mean_px, m.a_px]) * f for m, f in zip(motions, flips, strict=True)],
        [m.covariance_px2[:4, :4] * np.outer(f, f) for m, f in zip(motions, flips, strict=True)],
        lambda image, by_motion, by_exterior: (image[:4], by_motion[:4], by_exterior[:4]),
        range(6),
        start,
    )
    candidate.covariance_mm2[6:, 6:] = _minor_covariance(cameras, motions, candidate.motion_mm)
    return candidate


def phased_candidate(
    cameras: Sequence[OrientedCamera], exterior: FloatArray, motions: Sequence[ImageMotion]
) -> Candidate:
    """Solution of signed vectors: nothing is left to match."""
    start = np.zeros((3, 3))
    start[0] = nearest_point(cameras, [motion.mean_px for motion in motions])
    return adjust_motion(
        cameras,
        exterior,
        [np.concatenate([m.mean_px, m.a_px, m.b_px]) for m in motions],
        [m.covariance_px2 for m in motions],
        lambda image, by_motion, by_exterior: (image, by_motion, by_exterior),
        range(9),
        start,
    )


def orbit_candidates(
    cameras: Sequence[OrientedCamera], exterior: FloatArray, motions: Sequence[ImageMotion]
) -> list[Candidate]:
    """Solutions of an orbit from the second moments of its images, distinct ones only, best first.

    Each image's ``M = a aᵀ + b bᵀ`` is the projection of ``A Aᵀ + B Bᵀ``, which has rank 2. Two cameras leave the
    product of their rays' directions undetermined, and rank 2 picks two roots along it (measurement note, section 4).
    """
    mean = nearest_point(cameras, [motion.mean_px for motion in motions])
    moments = [second_moment(m.a_px, m.b_px) for m in motions]
    floor = np.diag([0.0, 0.0, INTERSECTION.min_axis_sd_px**2, INTERSECTION.min_axis_sd_px**2])
    noise = []
    for motion, moment in zip(motions, moments, strict=True):
        block = np.zeros((5, 5))
        block[:2, :2] = motion.covariance_px2[:2, :2]
        block[2:, 2:] = second_moment_covariance(motion.a_px, motion.b_px, motion.covariance_px2[2:, 2:] + floor)
        cross = second_moment_jacobian(motion.a_px, motion.b_px) @ motion.covariance_px2[2:, :2]
        block[2:, :2], block[:2, 2:] = cross, cross.T
        # Moments of a large orbit are large numbers: a relative floor keeps the matrix invertible.
        block[2:, 2:] += 1e-12 * float(moment @ moment) * np.eye(3)
        noise.append(block)
    observed = [np.concatenate([m.mean_px, moment]) for m, moment in zip(motions, moments, strict=True)]
    found: list[Candidate] = []
    for start in _orbit_starts(cameras, moments, mean):
        try:
            candidate = adjust_motion(
                cameras, exterior, observed, noise, _moment_model, range(9), np.stack([mean, *start]), phase_free=True
            )
        except DataError:  # another start may lead to an orbit in front of the cameras
            continue
        a, b, covariance = principal_axes(candidate.motion_mm[1], candidate.motion_mm[2], candidate.covariance_mm2)
        motion_mm = np.stack([candidate.motion_mm[0], a, b])
        if not any(_are_same_motion(motion_mm, other.motion_mm) for other in found):
            worst_px = candidate.worst_px / max(1.0, 2.0 * max(float(np.linalg.norm(m.a_px)) for m in motions))
            found.append(Candidate(motion_mm, covariance, candidate.cost, candidate.freedom, worst_px))
    if not found:
        raise DataError("no orbit in space fits what its cameras see")
    return sorted(found, key=lambda candidate: candidate.cost)


def _linear_vector(
    cameras: Sequence[OrientedCamera], motions: Sequence[ImageMotion], signs: Sequence[float], mean: FloatArray
) -> tuple[FloatArray, float]:
    """Vector (3,) that projects to the signed a of all cameras, and its squared normalised residual."""
    normal, right, total = np.zeros((3, 3), float), np.zeros(3, float), 0.0
    for camera, motion, sign in zip(cameras, motions, signs, strict=True):
        jacobian = camera.project_with_jacobians(mean[None])[1][0]
        weight = np.linalg.inv(motion.covariance_px2[2:4, 2:4] + 1e-8 * np.eye(2))
        normal += jacobian.T @ weight @ jacobian
        right += sign * jacobian.T @ weight @ motion.a_px
        total += float(motion.a_px @ weight @ motion.a_px)
    vector: FloatArray = np.linalg.solve(normal, right)
    return vector, total - float(right @ vector)


def _minor_covariance(
    cameras: Sequence[OrientedCamera], motions: Sequence[ImageMotion], motion_mm: FloatArray
) -> FloatArray:
    """(3, 3) covariance of a minor axis that was found to be zero.

    An image shows of it only what stands across the path: the rest would merely lengthen a. It is at right angles to
    the major axis and no longer than that.
    """
    size = max(float(np.linalg.norm(motion_mm[1])), 1e-6)
    along = motion_mm[1] / size
    normal = np.eye(3) / size**2 + np.outer(along, along) * 1e6 / size**2
    for camera, motion in zip(cameras, motions, strict=True):
        a, block = motion.a_px, motion.covariance_px2[4:, 4:]
        length = float(np.linalg.norm(a))
        if length == 0.0 or not np.isfinite(block).all():
            continue
        across = np.array([-a[1], a[0]]) / length
        variance = float(across @ block @ across) + INTERSECTION.min_axis_sd_px**2
        seen = across @ camera.project_with_jacobians(motion_mm[:1])[1][0]
        normal += np.outer(seen, seen) / variance
    return np.asarray(np.linalg.inv(normal), dtype=float)


def _moment_model(
    image: FloatArray, by_motion: FloatArray, by_exterior: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean and second moment of one camera's image."""
    a, b = image[2:4], image[4:6]
    change = np.zeros((5, 6))
    change[:2, :2] = np.eye(2)
    change[2:, 2:] = second_moment_jacobian(a, b)
    return np.concatenate([image[:2], second_moment(a, b)]), change @ by_motion, change @ by_exterior


def _orbit_starts(
    cameras: Sequence[OrientedCamera], moments: Sequence[FloatArray], mean: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Semi-axes of orbits that fit each pair of cameras exactly in linear terms."""
    starts = []
    for first, second in combinations(range(len(cameras)), 2):
        pair = [cameras[first], cameras[second]]
        system = np.concatenate([_moment_rows(camera.project_with_jacobians(mean[None])[1][0]) for camera in pair])
        right = np.concatenate([moments[first], moments[second]])
        numbers = np.linalg.lstsq(system, right, rcond=1e-9)[0]
        rays = [mean - camera.position_mm for camera in pair]
        rays = [ray / np.linalg.norm(ray) for ray in rays]
        base, null = _symmetric(numbers), np.outer(rays[0], rays[1]) + np.outer(rays[1], rays[0])
        starts += [_rank_two(base + root * null) for root in _roots_of_rank_two(base, null)]
    return starts


def _moment_rows(jacobian: FloatArray) -> FloatArray:
    """(3, 6) map from (xx, xy, xz, yy, yz, zz) of Q to (xx, xy, yy) of ``J Q Jᵀ``."""
    rows = []
    for u, v in ((0, 0), (0, 1), (1, 1)):
        outer = np.outer(jacobian[u], jacobian[v])
        outer = outer + outer.T
        rows.append([outer[i, j] * (0.5 if i == j else 1.0) for i, j in _PLACES])
    return np.array(rows)


_PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _symmetric(numbers: FloatArray) -> FloatArray:
    """(3, 3) of (xx, xy, xz, yy, yz, zz)."""
    result = np.zeros((3, 3))
    for (i, j), value in zip(_PLACES, numbers, strict=True):
        result[i, j] = result[j, i] = value
    return result


def _roots_of_rank_two(base: FloatArray, null: FloatArray) -> list[float]:
    """Values t with ``det(base + t null) = 0``: a quadratic, for `null` has rank 2; its extremum if none is real."""
    scale = float(np.abs(base).max()) or 1.0
    samples = np.array([np.linalg.det((base + t * scale * null) / scale) for t in (-1.0, 0.0, 1.0)])
    quadratic, linear = 0.5 * (samples[0] + samples[2]) - samples[1], 0.5 * (samples[2] - samples[0])
    if abs(quadratic) < 1e-14:
        return [0.0] if abs(linear) < 1e-14 else [-samples[1] / linear * scale]
    inside = linear**2 - 4.0 * quadratic * samples[1]
    if inside <= 0:
        return [-linear / (2.0 * quadratic) * scale]
    return [(-linear + sign * np.sqrt(inside)) / (2.0 * quadratic) * scale for sign in (1.0, -1.0)]


def _rank_two(moment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two vectors whose outer products sum to the nearest moment of rank 2."""
    values, vectors = np.linalg.eigh(moment)
    major, minor = np.sqrt(np.maximum(values[[2, 1]], 1e-12))
    return major * vectors[:, 2], minor * vectors[:, 1]


def _are_same_motion(first: FloatArray, second: FloatArray) -> bool:
    """Tell whether two motions are one, up to the signs of their axes."""
    size = float(np.linalg.norm(first[1])) or 1.0
    return all(
        min(float(np.linalg.norm(first[i] - second[i])), float(np.linalg.norm(first[i] + second[i]))) < 1e-3 * size
        for i in (1, 2)
    )
