"""Several cameras: from each target's images to its motion in space, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.geometry.continuity import ResolvedNeighbour, resolve_by_neighbours
from labdaemon.geometry.motion import FloatArray, ImageMotion, ObjectMotion
from labdaemon.geometry.motion_adjustment import Candidate
from labdaemon.geometry.motion_candidates import orbit_candidates, phased_candidate, straight_candidates
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.phase_fusion import evidence_from_phases, fuse_phases
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.orbit_axes import largest_sign, principal_axes


@dataclass(frozen=True, slots=True, eq=False)
class IntersectedMotion:
    """A target's motion and what else it might be.

    Attributes
    ----------
    motion
        The best solution.
    alternative
        The runner-up that could not be excluded; None when the match is settled, or an orbit's two roots merge.
    resolved_by
        ``residual`` (two cameras), ``third camera``, ``phase``, ``continuity``; empty where not settled.
    evidence
        Logarithm of the odds for the motion against its alternative, from the residuals alone.
    """

    motion: ObjectMotion
    alternative: ObjectMotion | None = None
    resolved_by: str = ""
    evidence: float = 0.0


def intersect_motion(
    cameras: Sequence[OrientedCamera],
    motions: Sequence[ImageMotion],
    *,
    covariance: FloatArray | None = None,
    evidence: Sequence[float] | None = None,
) -> IntersectedMotion:
    """Motion in space of one target seen by several cameras.

    Straight motion is matched by its ends, orbits by their second moments, signed vectors directly. A path counts as
    straight when its minor axis is consistent with zero in every camera.

    Parameters
    ----------
    cameras, motions
        One of each a camera, in the same order; cameras without a finite measurement are left out.
    covariance
        (6 n, 6 n) joint covariance of the cameras' exterior parameters; without it each view's own is taken, the
        cameras independent of each other.
    evidence
        What each camera knows of the sign of its a, see `straight_candidates`.

    Returns
    -------
    Joined

    Raises
    ------
    DataError
        Fewer than two cameras measured it, or their rays do not meet.
    """
    seen = [i for i, m in enumerate(motions) if np.isfinite([*m.mean_px, *m.a_px, *m.b_px]).all()]
    if covariance is None:
        covariance = np.zeros((6 * len(cameras), 6 * len(cameras)))
        for i, camera in enumerate(cameras):
            covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = camera.covariance
    rows = np.concatenate([np.arange(6 * i, 6 * i + 6) for i in seen]) if seen else np.arange(0)
    exterior = covariance[np.ix_(rows, rows)]
    cameras, motions = [cameras[i] for i in seen], [motions[i] for i in seen]
    known = None if evidence is None else [evidence[i] for i in seen]
    if len(cameras) < 2:
        raise DataError("seen by one camera only: its depth is unknown")
    phased = all(motion.phased for motion in motions)
    phase_unresolved = phased and any(motion.axes is not None for motion in motions)
    if phased and not phase_unresolved:
        best = phased_candidate(cameras, exterior, motions)
        signed = _object_motion(best, None, phased=True)
        if chi2.sf(best.cost, best.freedom) < INTERSECTION.sign_conflict_probability:
            return IntersectedMotion(replace(signed, flags=signed.flags | {Flag.AMBIGUOUS}))
        return IntersectedMotion(signed, resolved_by="phase")
    if phase_unresolved:
        axes = [_principal_motion(motion) for motion in motions]
        unphased = intersect_motion(cameras, axes, covariance=exterior, evidence=evidence_from_phases(motions, axes))
        signed = fuse_phases(cameras, motions, unphased.motion)
        return replace(unphased, motion=signed, alternative=None)
    motions = [_principal_motion(motion) for motion in motions]
    candidates, straight = _unphased_candidates(cameras, exterior, motions, known)
    best, others = candidates[0], candidates[1:]
    # Residuals larger than stated mean noise larger than stated: it may have decided the match.
    scale = max(1.0, best.cost / best.freedom) if best.freedom > 0 else 1.0
    ratio = float(np.sqrt(others[0].cost / max(best.cost, 1e-12))) if others else None
    close = [other for other in others if _cost_difference(best, other, scale) < INTERSECTION.match_cost_gap]
    rival = next((other for other in close if _are_distinct(best, other)), None)
    joined = _object_motion(best, ratio, phased=False)
    # Two cameras fix five of an orbit's six numbers. Where its plane is nearly edge-on to one of them the two roots
    # merge, and linear theory no longer says how far apart they may be: only roots that agree are believed.
    undetermined = not straight and len(cameras) == 2 and not (len(candidates) > 1 and _are_equal(*candidates[:2]))
    if rival is None and not undetermined:
        by_rays = (
            not others
            or (others[0].cost - best.cost) / scale >= INTERSECTION.match_cost_gap
            or not others[0].sign_penalty
        )
        return IntersectedMotion(
            joined, resolved_by=("residual" if len(cameras) == 2 else "third camera") if by_rays else "phase"
        )
    joined = replace(joined, flags=joined.flags | {Flag.AMBIGUOUS})
    if rival is None:
        return IntersectedMotion(joined)
    odds = 0.5 * _cost_difference(best, rival, scale)
    return IntersectedMotion(joined, _object_motion(rival, ratio, phased=False), evidence=odds)


def _cost_difference(best: Candidate, other: Candidate, scale: float) -> float:
    """By how much another candidate is the less likely, as a difference of squares."""
    return (other.cost - best.cost) / scale + other.sign_penalty - best.sign_penalty


def _unphased_candidates(
    cameras: Sequence[OrientedCamera],
    exterior: FloatArray,
    motions: Sequence[ImageMotion],
    evidence: Sequence[float] | None,
) -> tuple[list[Candidate], bool]:
    """Solutions without phase, best first, and whether they are straight.

    A path that is straight in every image within their uncertainty may still be an orbit: where each alone sees
    nothing across its path, the cameras together may contradict each other about its length. Then the orbit is taken
    if it explains them.
    """
    if not all(is_straight(motion) for motion in motions):
        return orbit_candidates(cameras, exterior, motions), False
    straight = straight_candidates(cameras, exterior, motions, evidence)
    best = straight[0]
    # Two cameras pay for an orbit with an ambiguity: only what a straight path cannot explain is called one.
    suspect = (
        best.cost > best.freedom
        if len(cameras) > 2
        else chi2.sf(best.cost, best.freedom) < INTERSECTION.orbit_trial_probability
    )
    if suspect:
        try:
            orbits = orbit_candidates(cameras, exterior, motions)
        except DataError:
            orbits = []
        if orbits and best.cost - orbits[0].cost > (
            INTERSECTION.orbit_cost_gain if len(cameras) > 2 else INTERSECTION.match_cost_gap
        ):
            return orbits, False
    return straight, True


def is_straight(motion: ImageMotion) -> bool:
    """Tell whether a path's minor axis is consistent with zero."""
    size = float(np.linalg.norm(motion.b_px))
    if size == 0.0:
        return True
    along = motion.b_px / size
    variance = float(along @ motion.covariance_px2[4:, 4:] @ along)
    return not size**2 > INTERSECTION.straight_ratio2 * variance


@dataclass(frozen=True, slots=True, eq=False)
class IntersectedTargets:
    """All targets of a capture.

    Attributes
    ----------
    motions
        By target's name; NaN where it could not be joined.
    resolved_by
        How the match of each joined target was settled, as in `IntersectedMotion`.
    refused
        Reason for each target that could not be joined.
    """

    motions: dict[str, ObjectMotion]
    resolved_by: dict[str, str]
    refused: dict[str, str]


def intersect_targets(
    cameras: Mapping[str, OrientedCamera],
    motions: Mapping[str, Mapping[str, ImageMotion]],
    *,
    covariance: FloatArray | None = None,
    members: Mapping[str, str] | None = None,
    evidence: Mapping[str, Mapping[str, float]] | None = None,
) -> IntersectedTargets:
    """Join all targets of a capture, then settle by continuity what the cameras left open.

    Parameters
    ----------
    cameras
        By camera.
    motions
        By target, then by camera.
    covariance
        (6 n, 6 n) joint covariance of the exteriors, cameras in the order of `cameras`.
    members
        Structural member of each target, if known; without it all targets may be neighbours.
    evidence
        By target, then by camera: what is known of the sign of its a (`straight_candidates`).

    Returns
    -------
    IntersectedTargets
    """
    known = evidence or {}
    camera_names = list(cameras)
    joined: dict[str, IntersectedMotion] = {}
    refused: dict[str, str] = {}
    nothing = np.full(3, np.nan)
    for target, images in motions.items():
        present = [i for i, name in enumerate(camera_names) if name in images]
        rows = np.array([6 * i + k for i in present for k in range(6)], dtype=int)
        try:
            joined[target] = intersect_motion(
                [cameras[camera_names[i]] for i in present],
                [images[camera_names[i]] for i in present],
                covariance=None if covariance is None else covariance[np.ix_(rows, rows)],
                evidence=[known.get(target, {}).get(camera_names[i], 0.0) for i in present],
            )
        except DataError as exc:
            refused[target] = str(exc)
    joined = resolve_ambiguous_targets(joined, members)
    result = {
        target: joined[target].motion
        if target in joined
        else ObjectMotion(nothing, nothing, nothing, np.full((9, 9), np.nan))
        for target in motions
    }
    return IntersectedTargets(result, {name: entry.resolved_by for name, entry in joined.items()}, refused)


def resolve_ambiguous_targets(
    joined: Mapping[str, IntersectedMotion], members: Mapping[str, str] | None = None
) -> dict[str, IntersectedMotion]:
    """Choose between a target's two solutions by its settled neighbours (`labdaemon.geometry.continuity`).

    Parameters
    ----------
    joined
        By target.
    members
        Member of each target, if known.

    Returns
    -------
    dict
        The same targets; those settled lose `Flag.AMBIGUOUS` and say so.
    """
    result = dict(joined)
    unsettled = {name for name, entry in joined.items() if entry.alternative is not None}
    trusted = {
        name: ResolvedNeighbour(entry.motion.mean_mm, entry.motion.a_mm)
        for name, entry in joined.items()
        if name not in unsettled and Flag.AMBIGUOUS not in entry.motion.flags
    }
    for name in sorted(unsettled):
        entry = joined[name]
        assert entry.alternative is not None
        near = [other for other in joined if other != name and _same_member(name, other, members)]
        near.sort(key=lambda other: float(np.linalg.norm(joined[other].motion.mean_mm - entry.motion.mean_mm)))
        if not _neighbours_represent([other in trusted for other in near]):
            continue
        neighbours = [trusted[other] for other in near if other in trusted]
        options = (entry.motion, entry.alternative)
        choice = resolve_by_neighbours(options, entry.evidence, neighbours)
        if choice is not None:
            motion = options[choice]
            result[name] = IntersectedMotion(replace(motion, flags=motion.flags - {Flag.AMBIGUOUS}), None, "continuity")
    return result


def _same_member(name: str, other: str, members: Mapping[str, str] | None) -> bool:
    """Tell whether two targets are of the same member; all are where no members are known."""
    return members is None or members.get(name) == members.get(other)


def _neighbours_represent(settled: Sequence[bool]) -> bool:
    """Tell whether a target's neighbours, nearest first, may speak for it.

    Where most of its nearest are open too (a column moving in the epipolar plane), those that are settled belong to
    something else and moved otherwise: that is why they are settled.
    """
    return sum(settled[:3]) >= 2 and 3 * sum(settled[:6]) >= 2 * len(settled[:6])


def _principal_motion(motion: ImageMotion) -> ImageMotion:
    """Image by its principal axes (cameras with phase joined to ones without lose it)."""
    if not motion.phased:
        return motion
    if motion.axes is not None:
        return motion.axes
    a, b, covariance = principal_axes(motion.a_px, motion.b_px, motion.covariance_px2)
    return ImageMotion(motion.mean_px, a, b, covariance)


def _are_distinct(first: Candidate, second: Candidate) -> bool:
    """Tell whether two candidates differ by more than the uncertainty of the first."""
    distance2 = 0.0
    for axis in (1, 2):
        block = first.covariance_mm2[3 * axis : 3 * axis + 3, 3 * axis : 3 * axis + 3]
        if not np.isfinite(block).all():
            continue
        inverse = np.linalg.pinv(block + 1e-12 * np.eye(3), hermitian=True)
        here, there = first.motion_mm[axis], second.motion_mm[axis]
        distance2 = max(distance2, min(float((here - s * there) @ inverse @ (here - s * there)) for s in (1.0, -1.0)))
    return distance2 > chi2.isf(INTERSECTION.distinct_probability, 3)


def _are_equal(first: Candidate, second: Candidate) -> bool:
    """Tell whether two candidates are the same for any practical purpose."""
    here, there = first.motion_mm[1:], second.motion_mm[1:]
    unphased = np.minimum(np.abs(here - there).max(axis=1), np.abs(here + there).max(axis=1))
    return bool(unphased.max() < INTERSECTION.same_root_mm)


def _object_motion(candidate: Candidate, ratio: float | None, *, phased: bool) -> ObjectMotion:
    """What is reported of a candidate."""
    motion, covariance = candidate.motion_mm, candidate.covariance_mm2
    if not phased:
        signs = np.array([1.0, largest_sign(motion[1]), largest_sign(motion[2])])
        motion = motion * signs[:, None]
        nine = np.repeat(signs, 3)
        covariance = covariance * np.outer(nine, nine)
    poor = (
        candidate.freedom > 0
        and candidate.cost > chi2.isf(INTERSECTION.poor_fit_probability, candidate.freedom)
        and candidate.worst_px > INTERSECTION.poor_fit_px
    )
    flags = frozenset({Flag.POOR_FIT}) if poor else frozenset()
    return ObjectMotion(motion[0], motion[1], motion[2], covariance, ratio, flags)
