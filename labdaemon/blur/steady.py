"""A steady motion through known windows, one frame or several: standing where that explains it, an orbit else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from labdaemon.blur.honesty import REST_SIGMAS, honest_covariance
from labdaemon.blur.orbits import across, minor_axis, solve_orbit
from labdaemon.blur.pixels import FloatArray
from labdaemon.blur.solve import Solution
from labdaemon.blur.standing import PhaseProfile, profile_phase
from labdaemon.blur.windowed import FRAME, Exposures, orbit_motion, phase_motion, timing_covariance

CLOSE = 4.0  # difference of squared residuals below which another solution fits as well
APART = 9.0  # and the height between two of them from which they are two
BROAD_RAD = 0.25  # deviation of the phase up to which the linear covariance holds
FINE = 256  # phases over which the chances are summed


@dataclass(frozen=True, slots=True, eq=False)
class Steady:
    """What was found.

    Attributes
    ----------
    value, covariance
        (6,) x, y, ax, ay, bx, by in terms of the excitation's phase (of the first opening, where that is unknown);
        (6, 6). Of a single frame a and b are one of two mirror images in time.
    size_px, sd_size_px
        sqrt(|a|² + |b|²), which shows whether or not the phase does.
    solution
        The fit behind it.
    profile
        The standing motion that fits best.
    is_orbit
        Whether a and b are an orbit's, and not a standing motion's.
    rival
        Whether another solution, clearly apart, fits as well.
    one_sided_px2
        How far the extra blur may be from the same in all directions.
    """

    value: FloatArray
    covariance: FloatArray
    size_px: float
    sd_size_px: float
    solution: Solution
    profile: PhaseProfile
    is_orbit: bool
    rival: bool
    one_sided_px2: float = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether it cannot be told from rest: an amplitude shows by its square."""
        limit = float(np.hypot(2 * self.size_px * self.sd_size_px, self.one_sided_px2))
        return self.size_px**2 < REST_SIGMAS * limit


def fit_steady(exposures: Exposures, *, orbit: bool = True) -> Steady:
    """Fit a standing motion, and an orbit where its minor axis shows.

    Parameters
    ----------
    exposures
        The target in its frames.
    orbit
        False forces straight motion.
    """
    spread = _spread(exposures)
    profile = profile_phase(exposures, spread)
    minor = minor_axis(exposures, profile)
    one_sided = max(blur.one_sided_px2 for blur in exposures.blurs)
    unsure = float(np.hypot(minor.sd_square_px2, one_sided))
    if orbit and minor.square_px2 > REST_SIGMAS * unsure:
        best, other = solve_orbit(exposures, spread, profile, float(np.sqrt(minor.square_px2)))
        covariance = honest_covariance(exposures.sharp, best, exposures.planes)
        covariance = covariance + timing_covariance(best, exposures, orbit_motion)
        pick = _picking(exposures, len(best.p), 4)
        rival = other is not None and other.cost - best.cost < CLOSE * max(best.chi2, 1.0)
        value, covariance = pick @ best.p, pick @ covariance @ pick.T
        size, sd = _size(value[2:], covariance[2:, 2:])
        return Steady(value, covariance, size, sd, best, profile, True, rival, one_sided)
    value, covariance, sd = _standing(exposures, profile)
    n, c, s = across(profile.vector), np.cos(profile.phase), np.sin(profile.phase)
    quarter_later = np.concatenate((np.zeros(2), -s * n, c * n))
    size = float(np.hypot(*profile.vector))
    covariance = covariance + minor.mean_square(size) * np.outer(quarter_later, quarter_later)
    return Steady(value, covariance, size, sd, profile.best, profile, False, _two_valleys(profile), one_sided)


def _size(vector: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Length of a vector and its deviation."""
    size = float(np.linalg.norm(vector))
    along = vector / max(size, 1e-12)
    return size, float(np.sqrt(max(along @ covariance @ along, 0.0)))


def _spread(exposures: Exposures) -> FloatArray:
    """(2, 2) aaᵀ + bbᵀ as the smears' moments have it."""
    moments = [s.blob.moment_px2 for s in exposures.settings if s.blob is not None]
    if not moments:
        return 4.0 * np.eye(2)
    defocus = float(np.mean([blur.mean_px2 for blur in exposures.blurs]))
    spread: FloatArray = 2 * (np.mean(moments, axis=0) - exposures.sharp.form.moment_px2 - defocus * np.eye(2))
    return spread


def _picking(exposures: Exposures, size: int, motion: int) -> FloatArray:
    """(2 + motion, size) that takes the mean place and the motion from all parameters."""
    count = len(exposures.settings)
    pick = np.zeros((2 + motion, size))
    for index in range(count):
        pick[0, FRAME * index] = pick[1, FRAME * index + 1] = 1 / count
    pick[2:, size - motion :] = np.eye(motion)
    return pick


def _standing(exposures: Exposures, profile: PhaseProfile) -> tuple[FloatArray, FloatArray, float]:
    """(6,) and (6, 6) of a standing motion, and the deviation of its amplitude.

    Where the phase hardly shows, the covariance is not the linear one but that of all phases by their chances.
    """
    best = profile.best
    covariance = honest_covariance(exposures.sharp, best, exposures.planes)
    covariance = covariance + timing_covariance(best, exposures, phase_motion)
    pick = _picking(exposures, len(best.p), 3)
    small, p = pick @ covariance @ pick.T, pick @ best.p
    value = vectors_of(p[None])[0]
    phases, chance, others = chances(profile)
    scatter = float(chance @ (1 - np.cos(phases - profile.phase))) * 2
    if small[4, 4] < BROAD_RAD**2 and scatter < BROAD_RAD**2:
        jacobian = np.zeros((6, 5))
        c, s, v = np.cos(p[4]), np.sin(p[4]), p[2:4]
        jacobian[:2, :2] = np.eye(2)
        jacobian[2:, 2:] = np.vstack((np.column_stack((c * np.eye(2), -s * v)), np.column_stack((s * np.eye(2), c * v))))
        return value, jacobian @ small @ jacobian.T, _size(p[2:4], small[2:4, 2:4])[1]
    held = small[:4, :4] - np.outer(small[:4, 4], small[4, :4]) / max(small[4, 4], 1e-12)
    away = vectors_of(others) - value
    total = (chance * away.T) @ away
    for weight, phase in zip(chance, phases, strict=True):
        c, s = np.cos(phase), np.sin(phase)
        jacobian = np.zeros((6, 4))
        jacobian[:2, :2] = np.eye(2)
        jacobian[2:, 2:] = np.vstack((c * np.eye(2), s * np.eye(2)))
        total += weight * jacobian @ held @ jacobian.T
    lengths = np.hypot(others[:, 2], others[:, 3])
    scatter = float(chance @ (lengths - chance @ lengths) ** 2)
    return value, total, float(np.hypot(_size(p[2:4], held[2:4, 2:4])[1], np.sqrt(scatter)))


def vectors_of(standing: FloatArray) -> FloatArray:
    """(n, 6) x, y, ax, ay, bx, by of (n, 5) x, y, vx, vy, ψ."""
    c, s = np.cos(standing[:, 4:]), np.sin(standing[:, 4:])
    return np.concatenate((standing[:, :2], c * standing[:, 2:4], s * standing[:, 2:4]), axis=1)


def chances(profile: PhaseProfile) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phases finely, the chance of each (which sum to 1), and (m, 5) x, y, vx, vy, ψ there."""
    at, table = profile.phase_rad, np.column_stack((profile.cost, profile.place_px, profile.vector_px))
    if profile.periodic:
        at, table = np.append(at, at[0] + 2 * np.pi), np.vstack((table, table[:1]))
    phases = np.linspace(at[0], at[-1], FINE + 1)[: FINE if profile.periodic else None]
    values = CubicSpline(at, table, bc_type="periodic" if profile.periodic else "natural")(phases)
    chance = np.exp(-(values[:, 0] - values[:, 0].min()) / (2 * max(profile.best.chi2, 1.0)))
    return phases, chance / chance.sum(), np.column_stack((values[:, 1:], phases))


def _two_valleys(profile: PhaseProfile) -> bool:
    """Whether two phases with a height between them cost the same; a profile that is low all round has but one."""
    if not profile.periodic:
        return False
    scale = max(profile.best.chi2, 1.0)
    cost = (profile.cost - profile.cost.min()) / scale
    cost = np.roll(cost, -int(np.argmin(cost)))
    # Highest place on either way round from the lowest to each.
    wall = np.minimum(np.maximum.accumulate(cost), np.maximum.accumulate(cost[::-1])[::-1])
    return bool(np.any((cost < CLOSE) & (wall > APART)))
