"""Which way the targets of a frame move against each other, from a single exposure that is no whole cycles.

Such an exposure shows of a standing motion on which side of its mean a point stood at the middle of the exposure
(`labdaemon.blur.standing` has the mathematics). All points of one mode share the phase μ there, so that those on the
sides of +v₁ and +v₂ move that way together. Of the phase itself only sin μ ≥ 0 is seen: μ and π − μ look alike.
A target is given a sign where the phase that most of them share explains its picture, and the same phase with the other
sign does not. Orbits, targets at another phase and those too small for a sign to show are given none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import logsumexp

from labdaemon.blur.axes import positive
from labdaemon.blur.defocus import default_blur
from labdaemon.blur.honesty import POOR_CHI2, REST_SIGMAS
from labdaemon.blur.model import prepare
from labdaemon.blur.motion import ExtraBlur, Start, Window
from labdaemon.blur.orbits import minor_axis
from labdaemon.blur.pixels import FloatArray, Patch
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.standing import middle_phase, profile_phase
from labdaemon.blur.steady import smear_spread
from labdaemon.blur.windowed import Exposures
from labdaemon.errors import UsageError

NEARLY_RAD = np.radians(5.0)
"""How far from the common phase the targets of a nearly standing motion may be (standard deviation)."""
OTHER_PHASE = 12.0
"""Cost from which a target is not at the common phase."""
MOST = 0.6
"""Part of the targets that could contradict a common phase, and must not, for there to be one."""
SURE = 14.0
"""Twice the logarithm of the odds from which a sign is stated."""

_GRID = np.radians(np.arange(-90.0, 91.0))


@dataclass(frozen=True, slots=True, eq=False)
class Clue:
    """What one target's picture says of its phase.

    Attributes
    ----------
    vector_px
        (2,) v of the standing motion v·sin μ that fits best, its largest component positive.
    cost
        (181,) what μ = −90° … 90° at the middle of the exposure costs, less the least.
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
        (n,) twice the logarithm of the odds of sign 1 against −1; 0 where the common phase does not explain the target.
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
    if len(sharps) != len(patches) or (starts is not None and len(starts) != len(sharps)):
        raise UsageError("give one patch (and one start, if any) for each sharp target")
    begin: Sequence[Start | None] = starts if starts is not None else [None] * len(sharps)
    clues = [
        clue_of(sharp, patch, window, extra_blur, start)
        for sharp, patch, start in zip(sharps, patches, begin, strict=True)
    ]
    return from_clues(clues, window)


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
    exposures = Exposures.of(sharp, [setting], [window], [extra_blur or default_blur(sharp)])
    profile = profile_phase(exposures, smear_spread(exposures))
    scale = max(profile.best.chi2, 1.0)
    if scale > POOR_CHI2 and sharp.noise_known:
        return None
    minor = minor_axis(exposures, profile)
    curved = minor.square_px2 > REST_SIGMAS * np.hypot(minor.sd_square_px2, exposures.blurs[0].one_sided_px2)
    at = profile.phase_rad + middle_phase(exposures)
    cost = PchipInterpolator(at, profile.cost)(np.clip(_GRID, at[0], at[-1])) / scale
    vector = positive(profile.vector)
    if not np.array_equal(vector, profile.vector):
        cost = cost[::-1]
    return Clue(vector, cost - cost.min(), bool(curved))


def from_clues(clues: Sequence[Clue | None], window: Window) -> RelativeSigns:
    """Find the phase that the targets share, and each one's sign at it."""
    count = len(clues)
    vectors, signs, evidence = np.full((count, 2), np.nan), np.zeros(count), np.zeros(count)
    straight = {i: _nearly(clue.cost) for i, clue in enumerate(clues) if clue is not None and not clue.is_orbit}
    for i, clue in enumerate(clues):
        if clue is not None:
            vectors[i] = clue.vector_px
    # Either sign of each, for μ = 0 … 90°.
    either = {i: np.minimum(cost[90:], cost[90::-1]) for i, cost in straight.items()}
    if not either:
        return RelativeSigns(vectors, signs, evidence, np.nan, np.nan)
    total = np.sum([np.minimum(cost, OTHER_PHASE) for cost in either.values()], axis=0)
    common = int(np.argmin(total))
    could = [cost[common] < OTHER_PHASE for cost in either.values() if cost.max() > OTHER_PHASE]
    if could and np.mean(could) < MOST:
        return RelativeSigns(vectors, signs, evidence, np.nan, np.nan)
    chance = np.exp(-(total - total.min()) / 2)
    chance /= chance.sum()
    middle = float(chance @ _GRID[90:])
    sd = float(np.sqrt(chance @ (_GRID[90:] - middle) ** 2))
    for i, cost in straight.items():
        if either[i][common] < OTHER_PHASE:
            evidence[i] = 2 * (logsumexp(-cost[90:] / 2, b=chance) - logsumexp(-cost[90::-1] / 2, b=chance))
            signs[i] = np.sign(evidence[i]) if abs(evidence[i]) > SURE else 0.0
            vectors[i] *= -1.0 if signs[i] < 0 else 1.0
    phases: tuple[float, ...] = ()
    if window.phase_rad is not None:
        zero = window.phase_rad + np.pi * window.cycles
        phases = tuple(float((mu - zero + np.pi) % (2 * np.pi) - np.pi) for mu in (middle, np.pi - middle))
    return RelativeSigns(vectors, signs, evidence, middle, sd, phases)


def _nearly(cost: FloatArray) -> FloatArray:
    """(181,) cost when the target's own phase may differ a little from the common one."""
    # sin μ, and with it the picture, is the same on both sides of ±90°.
    around = np.concatenate((cost[90:0:-1], cost, cost[-2:-92:-1]))
    step = np.arange(len(cost))[:, None] + 90 - np.arange(len(around))[None, :]
    result: FloatArray = np.min(around + (np.radians(step) / NEARLY_RAD) ** 2, axis=1)
    return result
