"""Which way the targets of a frame move against each other, from a single exposure that is no whole cycles.

Such an exposure shows of an in-phase motion on which side of its mean a point stood at the middle of the exposure
(`labdaemon.blur.phase.in_phase` has the mathematics). All points of one mode share the phase μ there, so that those on
the sides of +v₁ and +v₂ move that way together. Of the phase itself only sin μ ≥ 0 is seen: μ and π − μ are
indistinguishable. A target is given a sign where the phase that most of them share explains its image, and the same
phase with the other sign does not. Orbits, targets at another phase and those too small for a sign to show are given
none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from labdaemon.blur.motion import Defocus, ExposureWindow, InitialGuess, match_guesses
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.phase.harmonic_fit import smear_moment
from labdaemon.blur.phase.in_phase import profile_phase
from labdaemon.blur.phase.orbits import estimate_minor_axis
from labdaemon.blur.phase.time_reversal import mid_exposure_phase, wrap_angle
from labdaemon.blur.settings import SIGNS, UNCERTAINTY
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_defocus
from labdaemon.blur.smear.fit_problem import prepare_fit
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.blur.smear.texture_frames import with_clean_texture
from labdaemon.blur.unsolvable import solved
from labdaemon.orbit_axes import orient_positive

PHASE_SPREADS_RAD = np.radians(SIGNS.phase_spreads_deg)
"""How far from the common phase the targets of a nearly in-phase motion may be: standard deviations to choose from."""

_MIDDLE = 180
_GRID = np.radians(np.linspace(-90.0, 90.0, 2 * _MIDDLE + 1))


@dataclass(frozen=True, slots=True, eq=False)
class PhaseLikelihood:
    """What one target's image says of its phase.

    Attributes
    ----------
    vector_px
        (2,) v of the in-phase motion v·sin μ that fits best, its largest component positive.
    cost
        (361,) what μ = −90° … 90° at the middle of the exposure costs, less the least.
    is_orbit
        Whether its minor axis shows.
    """

    vector_px: FloatArray
    cost: FloatArray
    is_orbit: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RelativeSigns:
    """Signs of a frame's targets.

    Attributes
    ----------
    vector_px
        (n, 2) v of each target's in-phase motion; where its sign is known, on the side on which the target stood at
        the middle of the exposure, else with the largest component positive. NaN where not measured.
    sign
        (n,) 1 or −1 to the v whose largest component is positive; 0 where unknown.
    evidence
        (n,) twice the logarithm of the odds of sign 1 against −1; 0 where the target is not at the common phase.
    mid_exposure_phase_rad, sd_mid_exposure_phase_rad
        Common phase μ at the middle of the exposure, 0 … π/2 (π − μ gives the same image); NaN without a common phase.
    phase_rad
        The two phases ψ of v·sin(ωt + ψ), ωt the excitation's, that μ and π − μ stand for; empty without the opening
        phase or a common one.
    """

    vector_px: FloatArray
    sign: FloatArray
    evidence: FloatArray
    mid_exposure_phase_rad: float
    sd_mid_exposure_phase_rad: float
    phase_rad: tuple[float, ...] = ()


def find_relative_signs(
    sharps: Sequence[SharpTarget],
    patches: Sequence[Patch],
    window: ExposureWindow,
    *,
    defocus: Defocus | None = None,
    initial_guesses: Sequence[InitialGuess | None] | None = None,
) -> RelativeSigns:
    """Tell which way the targets of one frame move against each other.

    Parameters
    ----------
    sharps, patches
        Target and its part of the blurred frame, one by one.
    window
        When the shutter was open; its phase may be unknown. Whole cycles show no sign.
    defocus, initial_guesses
        As for `measure_frame`.

    Raises
    ------
    UsageError
        Sequences of different lengths.
    """
    guesses = match_guesses(sharps, patches, initial_guesses)
    likelihoods = [
        solved(phase_likelihood)(sharp, patch, window, defocus, initial_guess)
        for sharp, patch, initial_guess in zip(sharps, patches, guesses, strict=True)
    ]
    return combine_likelihoods(likelihoods, window)


def decide_sign(evidence: float) -> int:
    """The sign that some evidence stands for: 1, −1, or 0 where it does not suffice."""
    return int(np.sign(evidence)) if abs(evidence) > SIGNS.log_odds_limit else 0


def phase_likelihood(
    sharp: SharpTarget,
    patch: Patch,
    window: ExposureWindow,
    defocus: Defocus | None = None,
    initial_guess: InitialGuess | None = None,
) -> PhaseLikelihood | None:
    """What a target's image says of its phase; None where it cannot be measured."""
    if not sharp.usable:
        return None
    expected = np.asarray(initial_guess.centre_px if initial_guess is not None else sharp.centre_px, dtype=np.float64)
    problem = prepare_fit(sharp, patch, expected)
    if problem is None:
        return None
    there = sharp.with_scale_uncertainty(problem.initial_centre_px)
    frames = FrameSet.from_problems(there, [problem], [window], [defocus or default_defocus(sharp)])
    frame_set = with_clean_texture(frames)
    profile = profile_phase(frame_set, smear_moment(frame_set))
    scale = max(profile.best.chi2, 1.0)
    if scale > UNCERTAINTY.poor_chi2 and sharp.noise_known:
        return None
    minor = estimate_minor_axis(frame_set, profile)
    curved = minor.square_px2 > UNCERTAINTY.rest_sds * np.hypot(minor.sd_square_px2, frame_set.blurs[0].anisotropy_px2)
    at = np.sin(profile.phase_rad + mid_exposure_phase(frame_set))
    cost = PchipInterpolator(at, profile.cost)(np.clip(np.sin(_GRID), at[0], at[-1])) / scale
    vector = orient_positive(profile.vector)
    if not np.array_equal(vector, profile.vector):
        cost = cost[::-1]
    return PhaseLikelihood(vector, cost - cost.min(), bool(curved))


def combine_likelihoods(likelihoods: Sequence[PhaseLikelihood | None], window: ExposureWindow) -> RelativeSigns:
    """Find the phase that the targets share, and each one's sign at it."""
    count = len(likelihoods)
    vectors = np.array(
        [np.full(2, np.nan) if likelihood is None else likelihood.vector_px for likelihood in likelihoods]
    ).reshape(count, 2)
    evidence = np.zeros(count)
    nothing = RelativeSigns(vectors, np.zeros(count), evidence, float("nan"), float("nan"))
    used = [i for i, likelihood in enumerate(likelihoods) if likelihood is not None and not likelihood.is_orbit]
    if not used:
        return nothing
    density = np.array([np.exp(-likelihood.cost / 2) for i in used if (likelihood := likelihoods[i]) is not None])
    density *= (len(_GRID) / density.sum(axis=1))[:, None]  # 1 everywhere where nothing shows
    # (spreads, targets, μ = 0 … 90°) for either sign; then the probability of each spread and μ.
    near = np.stack([density @ _phase_kernel(float(sd)) for sd in PHASE_SPREADS_RAD])
    plus, minus = near[:, :, _MIDDLE:], near[:, :, _MIDDLE::-1]
    at_phase = (1 - SIGNS.outlier_share) * (plus + minus) / 2
    probability = np.sum(np.log(at_phase + SIGNS.outlier_share), axis=1)
    probability = np.exp(probability - probability.max())
    probability /= probability.sum()
    belongs = np.einsum("sm,stm->t", probability, at_phase / (at_phase + SIGNS.outlier_share))
    # Those whose own phase shows could have contradicted.
    could = np.min(plus[0] + minus[0], axis=1) < SIGNS.outlier_share
    if np.any(could) and np.mean(belongs[could]) < SIGNS.common_phase_share:
        return nothing
    odds = np.log(np.einsum("sm,stm->t", probability, plus / (at_phase + SIGNS.outlier_share)) + 1e-300)
    odds -= np.log(np.einsum("sm,stm->t", probability, minus / (at_phase + SIGNS.outlier_share)) + 1e-300)
    evidence[used] = np.where(belongs > 0.5, 2 * odds, 0.0)
    signs = np.array([float(decide_sign(one)) for one in evidence])
    vectors[signs < 0] *= -1
    by_phase = probability.sum(axis=0)
    middle = float(by_phase @ _GRID[_MIDDLE:])
    sd = float(np.sqrt(by_phase @ (_GRID[_MIDDLE:] - middle) ** 2))
    phases: tuple[float, ...] = ()
    if window.phase_rad is not None:
        zero = window.phase_rad + np.pi * window.cycles
        phases = tuple(wrap_angle(mu - zero) for mu in (middle, np.pi - middle))
    return RelativeSigns(vectors, signs, evidence, middle, sd, phases)


def _phase_kernel(sd_rad: float) -> FloatArray:
    """(361, 361) that spreads likelihoods over phases nearby; beyond ±90° they come back, sin μ being the same."""
    result = np.zeros((len(_GRID), len(_GRID)))
    for image in (_GRID, np.pi - _GRID, -np.pi - _GRID):
        result += np.exp(-(((_GRID[:, None] - image[None, :]) / sd_rad) ** 2) / 2)
    result /= result.sum(axis=1, keepdims=True)
    return result
