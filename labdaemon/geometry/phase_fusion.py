"""Signed vectors of which the phase hardly shows: their axis from all cameras, then the phase as all of them have it.

Near rest a camera measures a target's amplitude to a few per cent and its phase to half a turn. The signed vectors of
two such cameras may point anywhere on their circles, and their mean would be too short. The axis is therefore
intersected without phase, and the phases, each a von Mises distribution, are multiplied.

The motion is in phase but for a minor axis of some ratio (`orbit_prior`). A camera that looks along the path sees
little of it and all of the minor axis, a quarter of a cycle later: its phase is that much less certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ive

from labdaemon.geometry.motion import FloatArray, ImageMotion, ObjectMotion
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION


def fuse_phases(
    cameras: Sequence[OrientedCamera],
    motions: Sequence[ImageMotion],
    axis: ObjectMotion,
    in_phase_ratio: float = INTERSECTION.in_phase_ratio,
) -> ObjectMotion:
    """Give an axis in space the phase that its images have.

    Parameters
    ----------
    cameras, motions
        One of each a camera; signed vectors, whose covariance holds the phase's uncertainty.
    axis
        Straight motion joined without phase.
    in_phase_ratio
        Standard deviation of the ratio of a motion's axes.

    Returns
    -------
    ObjectMotion
        Signed vectors; their covariance is that of all phases weighted by their probability.
    """
    total = sum(_phasors(cameras, motions, axis, in_phase_ratio), start=0.0 + 0.0j)
    phase, resultant, second = float(np.angle(total)), *_circular_moments(abs(total))
    radial, tangent = np.array([np.cos(phase), np.sin(phase)]), np.array([-np.sin(phase), np.cos(phase)])
    outward, sideways = 1 - 2 * resultant + (1 + second) / 2, (1 - second) / 2
    spread = outward * np.outer(radial, radial) + sideways * np.outer(tangent, tangent)
    mean = (1 + second) / 2 * np.outer(radial, radial) + sideways * np.outer(tangent, tangent)
    covariance = np.zeros((9, 9))
    covariance[:3, :3] = axis.covariance_mm2[:3, :3]
    covariance[:3, 3:] = np.kron(radial, axis.covariance_mm2[:3, 3:6])
    covariance[3:, :3] = covariance[:3, 3:].T
    across = in_phase_ratio**2 * (float(axis.a_mm @ axis.a_mm) * np.eye(3) - np.outer(axis.a_mm, axis.a_mm))
    minor_covariance = np.kron(np.outer(tangent, tangent), axis.covariance_mm2[6:, 6:] + across)
    covariance[3:, 3:] = (
        np.kron(spread, np.outer(axis.a_mm, axis.a_mm))
        + np.kron(mean, axis.covariance_mm2[3:6, 3:6])
        + minor_covariance
    )
    return replace(axis, a_mm=radial[0] * axis.a_mm, b_mm=radial[1] * axis.a_mm, covariance_mm2=covariance)


def phase_cost(
    cameras: Sequence[OrientedCamera],
    motions: Sequence[ImageMotion],
    axis: ObjectMotion,
    in_phase_ratio: float = INTERSECTION.in_phase_ratio,
) -> float:
    """How far the images' phases along an axis contradict each other, as a sum of squares."""
    phasors = _phasors(cameras, motions, axis, in_phase_ratio)
    return 2 * (sum(abs(one) for one in phasors) - abs(sum(phasors)))


def with_minor_axes(
    cameras: Sequence[OrientedCamera], axes: Sequence[ImageMotion], motion: ObjectMotion, in_phase_ratio: float
) -> list[ImageMotion]:
    """Images by their axes, each with what a minor axis in space may have done to its major one.

    An image without phase shows the second moment of the path u and of the minor axis w together. Of a camera that
    looks along the path the longer one may be w's: its axis then is no image of the path. Where w is small its square
    alone adds, w²/2u along the path.

    Parameters
    ----------
    cameras, axes
        One of each a camera.
    motion
        Straight motion joined from them.
    in_phase_ratio
        Standard deviation of the ratio of a motion's axes.
    """
    a = motion.a_mm
    across_mm2 = in_phase_ratio**2 * (float(a @ a) * np.eye(3) - np.outer(a, a))
    found = []
    for camera, one in zip(cameras, axes, strict=True):
        jacobian = camera.project_with_jacobians(motion.mean_mm[None])[1][0]
        shown = jacobian @ across_mm2 @ jacobian.T
        path = jacobian @ a
        covariance = one.covariance_px2.copy()
        size2 = float(np.trace(shown))
        covariance[2:4, 2:4] += shown * size2 / max(size2 + 4 * float(path @ path), 1e-12)
        found.append(replace(one, covariance_px2=covariance))
    return found


def _phasors(
    cameras: Sequence[OrientedCamera], motions: Sequence[ImageMotion], axis: ObjectMotion, in_phase_ratio: float
) -> list[complex]:
    """Concentration and phase that each camera gives; a camera that looks along the axis gives none."""
    length = float(np.linalg.norm(axis.a_mm))
    found = []
    for camera, motion in zip(cameras, motions, strict=True):
        jacobian = camera.project_with_jacobians(axis.mean_mm[None])[1][0]
        along = jacobian @ axis.a_mm
        size = float(np.linalg.norm(along))
        if size > 0:
            # What of a minor axis shows along the path's image, for all directions across the path together.
            shown = along @ jacobian / size
            across = float(shown @ shown) * length**2 - size**2
            found.append(_camera_phasor(motion, along / size, in_phase_ratio**2 * max(across, 0.0)))
    return found


def evidence_from_phases(motions: Sequence[ImageMotion], axes: Sequence[ImageMotion]) -> list[float]:
    """What the cameras' phases say of the signs of their axes, as `straight_candidates` takes it.

    Parameters
    ----------
    motions, axes
        One of each a camera: signed vectors, and the same without phase.
    """
    phasors = [
        _camera_phasor(motion, axis.a_px / max(float(np.hypot(*axis.a_px)), 1e-12))
        for motion, axis in zip(motions, axes, strict=True)
    ]
    reference = max(phasors, key=abs)
    return [2 * (_log_i0(abs(reference + one)) - _log_i0(abs(reference - one))) for one in phasors]


def _log_i0(kappa: float) -> float:
    return float(np.log(ive(0, kappa))) + kappa


def _camera_phasor(motion: ImageMotion, along: FloatArray, minor_variance_px2: float = 0.0) -> complex:
    """Concentration and phase that one camera gives, as a complex number."""
    phasor = complex(motion.a_px @ along, motion.b_px @ along)
    size = abs(phasor)
    block = motion.covariance_px2[2:, 2:]
    # |e^iδ − 1|² = 2 (1 − cos δ): the variance on the circle, compared with which the amplitude's own is small.
    variance = sum(
        float(e @ block @ e) for e in (np.concatenate((along, 0 * along)), np.concatenate((0 * along, along)))
    )
    resultant = 1 - (variance + minor_variance_px2) / (2 * max(size, 1e-12) ** 2)
    return _concentration(resultant) * phasor / max(size, 1e-12)


def _concentration(resultant: float) -> float:
    """κ of a von Mises distribution with a mean resultant length."""
    if resultant <= 1e-6:
        return 0.0
    if resultant >= _circular_moments(INTERSECTION.max_concentration)[0]:
        return INTERSECTION.max_concentration
    return float(brentq(lambda kappa: _circular_moments(kappa)[0] - resultant, 0.0, INTERSECTION.max_concentration))


def _circular_moments(kappa: float) -> tuple[float, float]:
    """Mean of cos δ and of cos 2δ."""
    none = float(ive(0, kappa))
    return float(ive(1, kappa)) / none, float(ive(2, kappa)) / none
