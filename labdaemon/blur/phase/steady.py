"""A steady motion through known windows, one frame or several: standing where that explains it, an orbit else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.chances import APART, CLOSE, Standing, summed_up, two_valleys, vectors_of
from labdaemon.blur.phase.orbits import DIFFERENT, across, minor_axis, solve_orbit
from labdaemon.blur.phase.standing import PhaseProfile, profile_phase
from labdaemon.blur.phase.turning import all_turnings, at_phase
from labdaemon.blur.smear.honesty import REST_SIGMAS, honest_covariance
from labdaemon.blur.smear.windowed import FRAME, Exposures, orbit_motion, phase_motion, timing_covariance
from labdaemon.blur.solver.normal import Solution

EVEN = 2.0  # difference of squared residuals up to which an image in time is as good, whatever the deviations
UNSURE_RAD = 0.1  # deviation of an orbit's phase from which all phases are tried


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
    standing
        The standing motion that a and b are; None where they are an orbit's.
    held_covariance
        (6, 6) of an orbit's value with its phase held.
    beside_px2
        Mean square of a minor axis that a standing motion may have.
    is_loose
        Whether the phase hardly shows.
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
    standing: Standing | None
    held_covariance: FloatArray
    beside_px2: float
    is_loose: bool
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
    spread = smear_spread(exposures)
    profile = profile_phase(exposures, spread)
    minor = minor_axis(exposures, profile)
    one_sided = max(blur.one_sided_px2 for blur in exposures.blurs)
    unsure = float(np.hypot(minor.sd_square_px2, one_sided))
    if orbit and minor.square_px2 > REST_SIGMAS * unsure:
        best, other, image = solve_orbit(exposures, spread, profile, float(np.sqrt(minor.square_px2)))
        covariance = honest_covariance(exposures.sharp, best, exposures.planes)
        covariance = covariance + timing_covariance(best, exposures, orbit_motion)
        pick = _picking(exposures, len(best.p), 4)
        value, covariance = pick @ best.p, pick @ covariance @ pick.T
        held = at_phase(value, covariance)
        size, sd = _size(value[2:], held[2:, 2:])
        loose, alone = False, len(exposures.windows) == 1
        # A single frame has its image in time. The other sense of turning is in the deviations instead of a flag.
        linear = covariance
        near = other is not None and _worse(best, other) < CLOSE
        if not alone and (near or _sd_phase(value, covariance) > UNSURE_RAD):
            covariance, loose = all_turnings(exposures, profile, best, value, covariance)
        rival = alone
        if image is not None:
            away = pick @ image.p - value
            rival = rival or _rivals(_worse(best, image), away, linear, away, covariance)
        steady = Steady(value, covariance, size, sd, best, profile, None, held, 0.0, loose, rival)
        return replace(steady, one_sided_px2=one_sided)
    best = profile.best
    covariance = honest_covariance(exposures.sharp, best, exposures.planes)
    covariance = covariance + timing_covariance(best, exposures, phase_motion)
    pick = _picking(exposures, len(best.p), 3)
    linear = pick @ covariance @ pick.T
    standing = summed_up(profile, pick @ best.p, linear)
    size, sd = _size(standing.axis[2:], standing.axis_covariance[2:, 2:])
    beside = minor.mean_square(size)
    n, c, s = across(profile.vector), np.cos(profile.phase), np.sin(profile.phase)
    quarter_later = np.concatenate((np.zeros(2), -s * n, c * n))
    covariance = standing.covariance + beside * np.outer(quarter_later, quarter_later)
    rival, image = two_valleys(profile), profile.image
    if image is not None:
        vectors = vectors_of((pick @ image.p)[None])[0] - standing.value
        rival = rival or _rivals(_worse(best, image), pick @ (image.p - best.p), linear, vectors, covariance)
    held = np.zeros((6, 6))
    steady = Steady(
        standing.value, covariance, size, sd, best, profile, standing, held, beside, standing.is_loose, rival
    )
    return replace(steady, one_sided_px2=one_sided)


def _worse(best: Solution, other: Solution) -> float:
    """By how many squared deviations another solution fits less well."""
    return (other.cost - best.cost) / max(best.chi2, 1.0)


def _rivals(worse: float, away: FloatArray, linear: FloatArray, vectors: FloatArray, covariance: FloatArray) -> bool:
    """Whether an image in time fits as well, from a valley of its own, and the deviations do not say so.

    Parameters
    ----------
    worse
        Its squared residuals beyond the best solution's.
    away, linear
        From one to the other in the fit's own terms, place first, and their linear covariance there: half-way it must
        cost more than APART.
    vectors, covariance
        From one to the other as x, y, a, b, and the covariance that is reported.
    """
    if worse > CLOSE or _distance2(away, linear) < 4 * APART:
        return False
    return worse < EVEN or _distance2(vectors, covariance) > DIFFERENT


def _distance2(away: FloatArray, covariance: FloatArray) -> float:
    motion = away[2:]
    return float(motion @ np.linalg.pinv(covariance[2:, 2:], hermitian=True) @ motion)


def _sd_phase(value: FloatArray, covariance: FloatArray) -> float:
    """Linear deviation of the common phase of a and b."""
    by_phase = np.concatenate((-value[4:], value[2:4]))
    return float(
        np.sqrt(max(float(by_phase @ covariance[2:, 2:] @ by_phase), 0.0)) / max(float(by_phase @ by_phase), 1e-12)
    )


def _size(vector: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Length of a vector and its deviation."""
    size = float(np.linalg.norm(vector))
    along = vector / max(size, 1e-12)
    return size, float(np.sqrt(max(float(along @ covariance @ along), 0.0)))


def smear_spread(exposures: Exposures) -> FloatArray:
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
