"""Which way the targets of a frame move against each other, from a single exposure that is no whole cycles.

Such an exposure shows of a standing motion on which side of its mean a point stood at the middle of the exposure
(`labdaemon.blur.phase.standing` has the mathematics). All points of one mode share the phase μ there, so that those on
the sides of +v₁ and +v₂ move that way together. Of the phase itself only sin μ ≥ 0 is seen: μ and π − μ look alike.
A target is given a sign where the phase that most of them share explains its picture, and the same phase with the other
sign does not. Orbits, targets at another phase and those too small for a sign to show are given none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from labdaemon.blur.axes import positive
from labdaemon.blur.motion import ExtraBlur, Start, Window, starts_for
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.phase.mirror import middle_phase, wrapped
from labdaemon.blur.phase.orbits import minor_axis
from labdaemon.blur.phase.standing import profile_phase
from labdaemon.blur.phase.steady import smear_spread
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_blur
from labdaemon.blur.smear.honesty import POOR_CHI2, REST_SIGMAS
from labdaemon.blur.smear.model import prepare
from labdaemon.blur.smear.windowed import Exposures

NEARLY_RAD = np.radians((1.0, 2.0, 4.0))
"""How far from the common phase the targets of a nearly standing motion may be: standard deviations to choose from."""
ASTRAY = 0.1
"""Part of the targets that may be at any phase."""
MOST = 0.75
"""Part of the targets with a phase of their own that must be at the common one for there to be one."""
SURE = 2 * np.log(100.0)
"""Twice the logarithm of the odds from which a sign is stated."""

_MIDDLE = 180
_GRID = np.radians(np.linspace(-90.0, 90.0, 2 * _MIDDLE + 1))


@dataclass(frozen=True, slots=True, eq=False)
class Clue:
    """What one target's picture says of its phase.

    Attributes
    ----------
    vector_px
        (2,) v of the standing motion v·sin μ that fits best, its largest component positive.
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
        (n, 2) v of each target's standing motion; where its sign is known, on the side on which the target stood at
        the middle of the exposure, else with the largest component positive. NaN where not measured.
    sign
        (n,) 1 or −1 to the v whose largest component is positive; 0 where unknown.
    evidence
        (n,) twice the logarithm of the odds of sign 1 against −1; 0 where the target is not at the common phase.
    middle_phase_rad, sd_middle_phase_rad
        Common phase μ at the middle of the exposure, 0 … π/2, π − μ looking alike; NaN where no phase is common.
    phase_rad
        The two phases ψ of v·sin(ωt + ψ), ωt the excitation's, that μ and π − μ stand for; empty without the opening
        phase or a common one.
    """

    vector_px: FloatArray
    sign: FloatArray
    evidence: FloatArray
    middle_phase_rad: float
    sd_middle_phase_rad: float
    phase_rad: tuple[float, ...] = ()


def relative_signs(
    sharps: Sequence[SharpTarget],
    patches: Sequence[Patch],
    window: Window,
    *,
    extra_blur: ExtraBlur | None = None,
    starts: Sequence[Start | None] | None = None,
) -> RelativeSigns:
    """Tell which way the targets of one frame move against each other.

    Parameters
    ----------
    sharps, patches
        Target and its part of the blurred frame, one by one.
    window
        When the shutter was open; its phase may be unknown. Whole cycles show no sign.
    extra_blur, starts
        As for `measure_frame`.

    Raises
    ------
    UsageError
        Sequences of different lengths.
    """
    begin = starts_for(sharps, patches, starts)
    clues = [
        clue_of(sharp, patch, window, extra_blur, start)
        for sharp, patch, start in zip(sharps, patches, begin, strict=True)
    ]
    return from_clues(clues, window)


def stated(evidence: float) -> int:
    """The sign that some evidence stands for: 1, −1, or 0 where it does not suffice."""
    return int(np.sign(evidence)) if abs(evidence) > SURE else 0


def clue_of(
    sharp: SharpTarget, patch: Patch, window: Window, extra_blur: ExtraBlur | None = None, start: Start | None = None
) -> Clue | None:
    """What a target's picture says of its phase; None where it cannot be measured."""
    if not sharp.usable:
        return None
    expected = np.asarray(start.centre_px if start is not None else sharp.centre_px, dtype=np.float64)
    setting = prepare(sharp, patch, expected)
    if setting is None:
        return None
    there = sharp.elsewhere(setting.start_px)
    exposures = Exposures.of(there, [setting], [window], [extra_blur or default_blur(sharp)])
    profile = profile_phase(exposures, smear_spread(exposures))
    scale = max(profile.best.chi2, 1.0)
    if scale > POOR_CHI2 and sharp.noise_known:
        return None
    minor = minor_axis(exposures, profile)
    curved = minor.square_px2 > REST_SIGMAS * np.hypot(minor.sd_square_px2, exposures.blurs[0].one_sided_px2)
    at = np.sin(profile.phase_rad + middle_phase(exposures))
    cost = PchipInterpolator(at, profile.cost)(np.clip(np.sin(_GRID), at[0], at[-1])) / scale
    vector = positive(profile.vector)
    if not np.array_equal(vector, profile.vector):
        cost = cost[::-1]
    return Clue(vector, cost - cost.min(), bool(curved))


def from_clues(clues: Sequence[Clue | None], window: Window) -> RelativeSigns:
    """Find the phase that the targets share, and each one's sign at it."""
    count = len(clues)
    vectors = np.array([np.full(2, np.nan) if clue is None else clue.vector_px for clue in clues]).reshape(count, 2)
    evidence = np.zeros(count)
    nothing = RelativeSigns(vectors, np.zeros(count), evidence, float("nan"), float("nan"))
    used = [i for i, clue in enumerate(clues) if clue is not None and not clue.is_orbit]
    if not used:
        return nothing
    likelihood = np.array([np.exp(-clue.cost / 2) for i in used if (clue := clues[i]) is not None])
    likelihood *= (len(_GRID) / likelihood.sum(axis=1))[:, None]  # 1 everywhere where nothing shows
    # (spreads, targets, μ = 0 … 90°) for either sign; then the chance of each spread and μ.
    near = np.stack([likelihood @ _spreading(float(sd)) for sd in NEARLY_RAD])
    plus, minus = near[:, :, _MIDDLE:], near[:, :, _MIDDLE::-1]
    at_phase = (1 - ASTRAY) * (plus + minus) / 2
    chance = np.sum(np.log(at_phase + ASTRAY), axis=1)
    chance = np.exp(chance - chance.max())
    chance /= chance.sum()
    belongs = np.einsum("sm,stm->t", chance, at_phase / (at_phase + ASTRAY))
    # Those whose own phase shows could have contradicted.
    could = np.min(plus[0] + minus[0], axis=1) < ASTRAY
    if np.any(could) and np.mean(belongs[could]) < MOST:
        return nothing
    odds = np.log(np.einsum("sm,stm->t", chance, plus / (at_phase + ASTRAY)) + 1e-300)
    odds -= np.log(np.einsum("sm,stm->t", chance, minus / (at_phase + ASTRAY)) + 1e-300)
    evidence[used] = np.where(belongs > 0.5, 2 * odds, 0.0)
    signs = np.array([float(stated(one)) for one in evidence])
    vectors[signs < 0] *= -1
    by_phase = chance.sum(axis=0)
    middle = float(by_phase @ _GRID[_MIDDLE:])
    sd = float(np.sqrt(by_phase @ (_GRID[_MIDDLE:] - middle) ** 2))
    phases: tuple[float, ...] = ()
    if window.phase_rad is not None:
        zero = window.phase_rad + np.pi * window.cycles
        phases = tuple(wrapped(mu - zero) for mu in (middle, np.pi - middle))
    return RelativeSigns(vectors, signs, evidence, middle, sd, phases)


def _spreading(sd_rad: float) -> FloatArray:
    """(361, 361) that spreads likelihoods over phases nearby; beyond ±90° they come back, sin μ being the same."""
    result = np.zeros((len(_GRID), len(_GRID)))
    for image in (_GRID, np.pi - _GRID, -np.pi - _GRID):
        result += np.exp(-(((_GRID[:, None] - image[None, :]) / sd_rad) ** 2) / 2)
    result /= result.sum(axis=1, keepdims=True)
    return result
