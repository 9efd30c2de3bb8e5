"""Several cameras: from each target's images to its motion in space, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.geometry.motion import FloatArray, ImageMotion, IntersectedMotion, ObjectMotion
from labdaemon.geometry.motion_adjustment import Candidate
from labdaemon.geometry.motion_candidates import orbit_candidates, straight_candidates
from labdaemon.geometry.orbit_prior import UNKNOWN_CAPTURE, OrbitPrior, estimate_orbit_prior
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.phase_fusion import evidence_from_phases, fuse_phases, phase_cost, with_minor_axes
from labdaemon.geometry.resolution import resolve_ambiguous_targets
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.geometry.signed_candidates import SignedCandidate, cluster_candidates, signed_candidates
from labdaemon.orbit_axes import largest_sign, principal_axes


def intersect_motion(
    cameras: Sequence[OrientedCamera],
    motions: Sequence[ImageMotion],
    *,
    covariance: FloatArray | None = None,
    evidence: Sequence[float] | None = None,
    orbit_prior: OrbitPrior = UNKNOWN_CAPTURE,
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
    orbit_prior
        Of motions in phase and orbits.

    Returns
    -------
    IntersectedMotion

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
    if phased and any(not motion.arc for motion in motions) and all(m.arc or m.axes is None for m in motions):
        return _signed_motion(cluster_candidates(signed_candidates(cameras, exterior, motions, orbit_prior)))
    if phase_unresolved:
        return _fuse_alternatives(cameras, exterior, motions, orbit_prior.in_phase_ratio)
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


def _signed_motion(candidates: Sequence[SignedCandidate]) -> IntersectedMotion:
    """The best combination of signed motions, flagged where another one is not excluded."""
    best, others = candidates[0], candidates[1:]
    rival = others[0] if others else None
    ratio = None if rival is None else float(np.sqrt(max(rival.total_cost, 0.0) / max(best.total_cost, 1e-12)))
    signed = _object_motion(best, ratio, phased=True)
    if chi2.sf(best.cost, best.freedom) < INTERSECTION.sign_conflict_probability:
        return IntersectedMotion(replace(signed, flags=signed.flags | {Flag.AMBIGUOUS}))
    scale = max(1.0, best.cost / best.freedom) if best.freedom > 0 else 1.0
    gap = np.inf if rival is None else _cost_difference(best, rival, scale)
    if rival is None or gap >= INTERSECTION.twin_cost_gap:
        by_images = all(_image_difference(best, one, scale) >= INTERSECTION.twin_cost_gap for one in others)
        axis_ratio = best.axis_ratio if by_images else None
        return IntersectedMotion(signed, resolved_by="phase", signed=True, axis_ratio=axis_ratio)
    signed = replace(signed, flags=signed.flags | {Flag.AMBIGUOUS})
    return IntersectedMotion(signed, _object_motion(rival, ratio, phased=True), evidence=0.5 * float(gap), signed=True)


def _image_difference(best: SignedCandidate, other: SignedCandidate, scale: float) -> float:
    """As `_cost_difference`, by rays and images alone: no prior takes part."""
    return (other.cost - best.cost) / scale + other.image_excess - best.image_excess


def _fuse_alternatives(
    cameras: Sequence[OrientedCamera], exterior: FloatArray, motions: Sequence[ImageMotion], in_phase_ratio: float
) -> IntersectedMotion:
    """Signed motion where a camera hardly shows the phase: by the other cameras' candidates that it excludes least."""
    found: list[tuple[float, IntersectedMotion]] = []
    choices = [(motion, *motion.alternatives[: INTERSECTION.max_alternatives - 1]) for motion in motions]
    for chosen in list(product(*choices))[: INTERSECTION.max_combinations]:
        axes = [_principal_motion(motion) for motion in chosen]
        known = evidence_from_phases(chosen, axes)
        try:
            unphased = intersect_motion(cameras, axes, covariance=exterior, evidence=known)
            axes = with_minor_axes(cameras, axes, unphased.motion, in_phase_ratio)
            unphased = intersect_motion(cameras, axes, covariance=exterior, evidence=known)
        except DataError:
            if found:
                continue
            raise
        signed = replace(
            unphased, motion=fuse_phases(cameras, chosen, unphased.motion, in_phase_ratio), alternative=None
        )
        found.append(
            (sum(one.excess for one in chosen) + phase_cost(cameras, chosen, unphased.motion, in_phase_ratio), signed)
        )
    found.sort(key=lambda one: one[0])
    cost, best = found[0]
    if any(other - cost < INTERSECTION.twin_cost_gap for other, _ in found[1:]):
        return replace(best, motion=replace(best.motion, flags=best.motion.flags | {Flag.AMBIGUOUS}))
    return best


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
    """Join all targets of a capture, then settle by the others what the cameras left open.

    Targets under coded light are joined twice: those that need no prior say how many motions of the capture are orbits.

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
    refused: dict[str, str] = {}
    nothing = np.full(3, np.nan)

    def intersect_all(targets: Iterable[str], orbit_prior: OrbitPrior) -> dict[str, IntersectedMotion]:
        found = {}
        for target in targets:
            images = motions[target]
            present = [i for i, name in enumerate(camera_names) if name in images]
            rows = np.array([6 * i + k for i in present for k in range(6)], dtype=int)
            try:
                found[target] = intersect_motion(
                    [cameras[camera_names[i]] for i in present],
                    [images[camera_names[i]] for i in present],
                    covariance=None if covariance is None else covariance[np.ix_(rows, rows)],
                    evidence=[known.get(target, {}).get(camera_names[i], 0.0) for i in present],
                    orbit_prior=orbit_prior,
                )
            except DataError as exc:
                refused[target] = str(exc)
        return found

    joined = intersect_all(motions, UNKNOWN_CAPTURE)
    ratios = [one.axis_ratio for one in joined.values() if one.axis_ratio is not None]
    if ratios:
        signed = [target for target, one in joined.items() if one.signed]
        joined |= intersect_all(signed, estimate_orbit_prior(ratios))
    joined = resolve_ambiguous_targets(joined, members)
    result = {
        target: joined[target].motion
        if target in joined
        else ObjectMotion(nothing, nothing, nothing, np.full((9, 9), np.nan))
        for target in motions
    }
    return IntersectedTargets(result, {name: entry.resolved_by for name, entry in joined.items()}, refused)


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
