"""An arc of phases as a mixture of motions: what an image shows of a motion of which the phase hardly shows.

The signed vectors a and b of such a motion lie along an arc of a circle, which no covariance describes. A row of
normal distributions along it does: each at a phase of its own, as wide along the arc as the circle is straight, with
the likelihood of its phase. Another camera that knows the phase, or the place of rest, then picks from the row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import AlternativeMotion
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.orbits import perpendicular
from labdaemon.half_turn import major_phase_rad


@dataclass(frozen=True, slots=True, eq=False)
class PhaseTable:
    """Motions of one image at many phases.

    Attributes
    ----------
    phase_rad, excess
        (n,) phases, evenly and in order, less than a turn; (n,) twice the logarithm of the odds against each.
    motion_px
        (n, 6) x, y, ax, ay, bx, by at each.
    held_px2, held_phase_rad
        (6, 6) covariance of those of one phase with the phase held, and which phase that is.
    minor_px2
        Mean square of a minor axis that the motions may have.
    waveform_mean
        (2,) means of sin ωt and cos ωt over the window.
    """

    phase_rad: FloatArray
    excess: FloatArray
    motion_px: FloatArray
    held_px2: FloatArray
    held_phase_rad: float
    minor_px2: float = 0.0
    waveform_mean: tuple[float, float] = (0.0, 0.0)

    def covariance(self, index: int) -> FloatArray:
        """(6, 6) covariance of one of the motions, its phase held.

        The image shows its own centroid, of which the mean position is short by the mean of the motion over the window.
        """
        c, s = (f(self.phase_rad[index] - self.held_phase_rad) for f in (np.cos, np.sin))
        turn = np.eye(6)
        turn[2:, 2:] = np.kron(np.array([[c, -s], [s, c]]), np.eye(2))
        to_centroid = np.eye(6)
        to_centroid[:2, 2:] = np.kron(np.array([self.waveform_mean]), np.eye(2))
        jacobian = np.linalg.solve(to_centroid, turn @ to_centroid)
        result: FloatArray = jacobian @ self.held_px2 @ jacobian.T
        return result


def phase_arc(tables: Sequence[PhaseTable]) -> tuple[AlternativeMotion, ...]:
    """Motions along an arc, the most likely one first and with an excess of 0.

    Parameters
    ----------
    tables
        One, or one for each direction of rotation.

    Returns
    -------
    tuple of AlternativeMotion
        Those within `LIGHT.rival_limit`; the covariance of each holds its part of the arc.
    """
    return relative_to_best([motion for table in tables for motion in _along_arc(table)])


def _along_arc(table: PhaseTable) -> list[AlternativeMotion]:
    phase_rad, excess, motion_px = table.phase_rad, table.excess, table.motion_px
    step, best = float(phase_rad[1] - phase_rad[0]), int(np.argmin(excess))
    value = motion_px[best]
    size2 = float(value[2:] @ value[2:])
    outward = np.concatenate((np.zeros(2), value[2:])) / np.sqrt(max(size2, 1e-24))
    turned = table.covariance(best)
    relative = np.sqrt(max(float(outward @ turned @ outward), 0.0) / max(size2, 1e-24))
    # Half its square is what the circle leaves its tangent by.
    sd = float(np.clip(np.sqrt(2 * relative), LIGHT.arc_sd_rad[0], LIGHT.arc_sd_rad[1]))
    count = max(round(LIGHT.arc_spacing * sd / step), 1)
    likelihood = np.exp(-excess / 2)
    slope = np.gradient(motion_px, step, axis=0)
    found = []
    # The most likely phase is in the middle of its part of the arc.
    for middle in range(best % count, len(phase_rad), count):
        part = likelihood[max(middle - count // 2, 0) : middle + (count + 1) // 2]
        against = -2 * float(np.log(max(float(part.sum()) / count, 1e-300)))
        motion = motion_px[middle]
        along = sd * slope[middle]
        covariance = table.covariance(middle) + np.outer(along, along)
        if table.minor_px2 > 0:
            vector = np.cos(phase_rad[middle]) * motion[2:4] + np.sin(phase_rad[middle]) * motion[4:]
            across = across_path(vector, float(phase_rad[middle]), table.waveform_mean)
            covariance += table.minor_px2 * np.outer(across, across)
        found.append(AlternativeMotion(motion[:2], motion[2:4], motion[4:], covariance, against))
    return found


def across_path(vector: FloatArray, phase_rad: float, waveform_mean: tuple[float, float]) -> FloatArray:
    """(6,) change of x, y, a, b by a minor axis of one pixel.

    It acts a quarter of a cycle later than the major one. Its mean over the window shifts the image, so that the mean
    position gives way by as much.

    Parameters
    ----------
    vector, phase_rad
        (2,) v and ψ of the motion v·sin(ωt + ψ).
    waveform_mean
        Means of sin ωt and cos ωt over the window.
    """
    c, s = np.cos(phase_rad), np.sin(phase_rad)
    n = perpendicular(vector)
    later = c * waveform_mean[1] - s * waveform_mean[0]
    return np.concatenate((-later * n, -s * n, c * n))


def relative_to_best(motions: Sequence[AlternativeMotion]) -> tuple[AlternativeMotion, ...]:
    """Motions with their excess over the most likely one, those within `LIGHT.rival_limit`, best first."""
    least = min(one.excess for one in motions)
    kept = [replace(one, excess=one.excess - least) for one in motions if one.excess - least < LIGHT.rival_limit]
    return tuple(sorted(kept, key=lambda one: one.excess))


def turned_motion(motion: FloatArray, turn_rad: float) -> FloatArray:
    """(6,) x, y, a, b with another phase."""
    c, s, (a, b) = np.cos(turn_rad), np.sin(turn_rad), (motion[2:4], motion[4:])
    return np.concatenate((motion[:2], c * a - s * b, s * a + c * b))


def condition_on_phase(value: FloatArray, covariance: FloatArray) -> FloatArray:
    """(6, 6) covariance with the common phase of a and b held."""
    by_phase = np.concatenate((np.zeros(2), -value[4:], value[2:4]))
    seen = covariance @ by_phase
    result: FloatArray = covariance - np.outer(seen, seen) / max(float(by_phase @ seen), 1e-12)
    return result


def mixture_moments(
    motions: Sequence[AlternativeMotion], about_px: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A mixture by its moments: what is said of a target whose phase hardly shows.

    Parameters
    ----------
    motions
        Along an arc.
    about_px
        (6,) x, y, a, b about which the signed motion's scatter is taken.

    Returns
    -------
    covariance_px2, axis_px, axis_covariance_px2
        (6, 6) scatter about that motion; (4,) x, y and the semi-axis, whatever the phase, on the side of that motion;
        (4, 4) its covariance.
    """
    weight = np.exp([-one.excess / 2 for one in motions])
    weight /= weight.sum()
    total = np.zeros((6, 6))
    axes, covariances = [], []
    side: FloatArray | None = None
    for share, one in zip(weight, motions, strict=True):
        motion = np.concatenate((one.centre_px, one.a_px, one.b_px))
        away = motion - about_px
        total += share * (one.covariance_px2 + np.outer(away, away))
        phase = major_phase_rad(one.a_px, one.b_px)
        to_axis = np.zeros((4, 6))
        to_axis[:2, :2] = np.eye(2)
        to_axis[2:, 2:4], to_axis[2:, 4:] = np.cos(phase) * np.eye(2), np.sin(phase) * np.eye(2)
        axis = to_axis @ motion
        if side is None:
            side = axis[2:]
        turn = np.diag([1.0, 1.0, *np.repeat(1.0 if float(axis[2:] @ side) >= 0 else -1.0, 2)])
        axes.append(turn @ axis)
        covariances.append(turn @ to_axis @ one.covariance_px2 @ to_axis.T @ turn)
    mean = weight @ np.array(axes)
    spread = np.array(axes) - mean
    return total, mean, np.tensordot(weight, np.array(covariances), 1) + (weight * spread.T) @ spread
