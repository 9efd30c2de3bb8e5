"""How many cycles an exposure of unknown length saw, by what several targets of the frame show together.

Over whole cycles the blur of a sinusoid is the arcsine law. An exposure of Θ radians that is no whole number of cycles
shows by a skew and a change of the law's shape (``waveform_series``), the more the longer the path. One target hardly
separates n cycles and a part from others; several do together, since Θ is common to all. Phases are not taken for
common: every target has its own.

1. At each target's whole-cycle solution one look at the image gives its equations for the series' coefficients q.
   They turn into the cost of every (Θ, μ) without another look.
2. The sum over the targets of what Θ costs at their likeliest phases decides whether whole cycles are excluded. Where
   they are not, its posterior says how far amplitudes may be wrong.
3. Where they are, the valleys of the sum are followed with the exact transfer function, and the lowest is the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.waveform_series import ORDERS, amplitude_error, free_window_transfer, window_series
from labdaemon.blur.phase.window_evidence import WaveformEvidence
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve

CYCLES = np.arange(1.5, 40.0, 0.04)
"""Cycles that are tried. Fewer are no exposure of a blur measurement, more are as good as whole ones."""
PHASES_RAD = np.linspace(-np.pi / 2, np.pi / 2, 41)
"""Phases at the middle of the exposure; the other half of the circle has the same images."""
WHOLE_PROBABILITY = 0.5
"""Probability beforehand that an exposure is of whole cycles; all other cycles are evenly likely in the logarithm."""
EXCLUDED = 30.0
"""Twice the logarithm of the odds from which whole cycles are excluded: noise alone reaches it once in a million."""
LINEAR_ERROR = 0.2
"""Part of the gain by which the linear cost of a valley may be wrong. Trial: 0.1 at 2.3 cycles."""
VALLEYS, SAME_VALLEY = 5, 0.2
"""Valleys that are followed, and cycles within which two are one."""
FIRST_SD, LAST_SD = 0.12, 0.03
"""Standard deviation, cycles, that holds each target near a valley in the first and in the second pass. Numerics."""
RIVAL = 16.0
"""Cost above the best from which another valley is excluded. Statistics: four standard deviations."""
FIRST_STEPS, LAST_STEPS = 4, 8
"""Iterations of the two passes. Numerics."""
UNFINISHED = 100.0
"""Cost above the best after the first pass from which a valley is not followed further. Trial."""


@dataclass(frozen=True, slots=True)
class UnknownWindow:
    """What the targets of a frame say of its exposure.

    Attributes
    ----------
    cycles, sd_cycles
        Estimate and standard deviation; None where whole cycles are not excluded.
    relative_sd
        Standard deviation of every amplitude, over the amplitude, that is left because the exposure is unknown.
    """

    cycles: float | None
    sd_cycles: float
    relative_sd: float

    @property
    def window(self) -> ExposureWindow | None:
        """The exposure of a motion at 1 Hz, of unknown phase."""
        return None if self.cycles is None else ExposureWindow(1.0, self.cycles, None, sd_exposure_s=self.sd_cycles)


def estimate_window(evidence: Sequence[WaveformEvidence], expected: tuple[float, float] | None = None) -> UnknownWindow:
    """The exposure that explains several targets of a frame.

    Parameters
    ----------
    evidence
        Of targets with long straight paths; none leaves what is expected.
    expected
        Cycles and their standard deviation, where frequency and exposure are roughly known.

    Returns
    -------
    UnknownWindow
        Without cycles where whole cycles are not excluded.
    """
    costs, joint = _joint_cost(evidence)
    prior, whole_probability = _cycles_prior(expected)
    low = float(joint.min())
    part = prior * np.exp(-(joint - low) / 2)
    odds = 2 * np.log(part.sum() / max(whole_probability, 1e-12)) - low
    if odds > EXCLUDED:
        joint = joint if expected is None else joint + ((CYCLES - expected[0]) / expected[1]) ** 2
        found = _follow(evidence, costs, joint)
        if found is not None:
            return found
    whole = whole_probability * np.exp(min(low / 2, 0.0)) if odds <= EXCLUDED else 0.0
    probability = part / (part.sum() + whole)
    square = np.mean(amplitude_error(2 * np.pi * CYCLES[:, None], PHASES_RAD[None]) ** 2, axis=1)
    return UnknownWindow(None, 0.0, float(np.sqrt(probability @ square)))


def window_gain(evidence: Sequence[WaveformEvidence]) -> float:
    """By how many squared standard deviations the best exposure explains the images better than whole cycles."""
    return -float(_joint_cost(evidence)[1].min())


def _joint_cost(evidence: Sequence[WaveformEvidence]) -> tuple[FloatArray, FloatArray]:
    """(targets, cycles, phases) cost of each target, and (cycles,) of all, each at any phase, all equally likely."""
    costs = np.array([_series_cost(one) for one in evidence]).reshape(-1, len(CYCLES), len(PHASES_RAD))
    least = costs.min(axis=2)
    joint = np.sum(least - 2 * np.log(np.mean(np.exp(-(costs - least[..., None]) / 2), axis=2)), axis=0)
    return costs, joint


def _cycles_prior(expected: tuple[float, float] | None) -> tuple[FloatArray, float]:
    """Probabilities beforehand of each of `CYCLES`, and of whole cycles."""
    if expected is None:
        return (1 - WHOLE_PROBABILITY) / CYCLES / np.sum(1 / CYCLES), WHOLE_PROBABILITY
    cycles, sd = expected[0], max(expected[1], float(CYCLES[1] - CYCLES[0]))
    prior = np.exp(-(((CYCLES - cycles) / sd) ** 2) / 2) + 1e-9
    whole = WHOLE_PROBABILITY * float(np.exp(-(((cycles - round(cycles)) / sd) ** 2) / 2))
    return (1 - whole) * prior / prior.sum(), whole


def _series_cost(one: WaveformEvidence) -> FloatArray:
    """(cycles, phases) cost against whole cycles, to second order."""
    q = window_series(2 * np.pi * CYCLES[:, None], PHASES_RAD[None])
    information, score = one.information[:ORDERS, :ORDERS], one.score[:ORDERS]
    result: FloatArray = (np.sum((q @ information) * q, axis=-1) - 2 * (q @ score)) / one.scale
    return result


def _follow(evidence: Sequence[WaveformEvidence], costs: FloatArray, joint: FloatArray) -> UnknownWindow | None:
    """The lowest valley with the exact transfer function; None where none explains the images."""
    limit = joint.min() + LINEAR_ERROR * abs(float(joint.min())) + EXCLUDED
    padded = np.pad(joint, 1, constant_values=np.inf)
    minima = np.flatnonzero((joint <= padded[:-2]) & (joint <= padded[2:]) & (joint < limit))
    chosen: list[int] = []
    for index in minima[np.argsort(joint[minima])]:
        if len(chosen) < VALLEYS and all(abs(CYCLES[index] - CYCLES[other]) > SAME_VALLEY for other in chosen):
            chosen.append(int(index))
    starts = [
        [_start(one, float(CYCLES[index]), cost[index]) for one, cost in zip(evidence, costs, strict=True)]
        for index in chosen
    ]
    rough = [
        _Valley.through(evidence, start, float(CYCLES[index]), FIRST_SD, FIRST_STEPS)
        for index, start in zip(chosen, starts, strict=True)
    ]
    lowest = min(one.cost for one in rough)
    valleys = [
        _Valley.through(evidence, [one.p for one in valley.solutions], valley.cycles, LAST_SD, LAST_STEPS)
        for valley in rough
        if valley.cost < lowest + UNFINISHED
    ]
    valleys.sort(key=lambda one: one.cost)
    best = valleys[0]
    if np.median([one.chi2 for one in best.solutions]) > UNCERTAINTY.poor_chi2:
        return None
    close = [one for one in valleys if one.cost - best.cost < RIVAL]
    odds = [float(np.exp(-(one.cost - best.cost) / 2)) for one in close]
    change = [one.relative_change(best) for one in close]
    return UnknownWindow(best.cycles, best.sd_cycles, float(np.sqrt(np.average(np.square(change), weights=odds))))


def _start(one: WaveformEvidence, cycles: float, cost: FloatArray) -> FloatArray:
    """Parameters to follow a valley from: the best phase there, and the path that the linear equations go with it."""
    mu = float(PHASES_RAD[int(np.argmin(cost))])
    p = one.solution.p
    factor = 1 + float(amplitude_error(np.array(2 * np.pi * cycles), np.array(mu)))
    v = p[-2:] / max(factor, 0.5)
    place = p[:2] - v * np.sinc(cycles) * np.sin(mu)
    return np.concatenate((place, p[2:-2], v, [mu, 2 * np.pi * cycles]))


@dataclass(frozen=True, slots=True, eq=False)
class _Valley:
    """All targets near one number of cycles."""

    solutions: list[Solution]
    cycles: float
    sd_cycles: float
    cost: float

    @classmethod
    def through(
        cls,
        evidence: Sequence[WaveformEvidence],
        starts: Sequence[FloatArray],
        cycles: float,
        sd_cycles: float,
        steps: int,
    ) -> _Valley:
        """Fit each target with its cycles held near a value; then the cycles that all agree on.

        Without the hold a target's cost is a parabola of Θ, whose slope at its solution is what the hold pulls there.
        """
        theta, sd = 2 * np.pi * cycles, 2 * np.pi * sd_cycles
        solutions = [_solve(one, start, theta, sd, steps) for one, start in zip(evidence, starts, strict=True)]
        scale = np.array([max(one.chi2, 1.0) for one in solutions])
        at = np.array([float(one.p[-1]) for one in solutions])
        own = np.array([max(1 / float(one.covariance[-1, -1]) - 1 / sd**2, 0.0) for one in solutions]) / scale
        hold = (at - theta) / sd**2 / scale
        information = float(np.sum(own)) + 1e-12
        best = float(np.clip(np.sum(own * at + hold) / information, theta - 2 * sd, theta + 2 * sd))
        free = np.array([one.cost for one in solutions]) / scale - ((at - theta) / sd) ** 2 / scale
        cost = free + own * (best - at) ** 2 - 2 * hold * (best - at)
        return cls(solutions, best / (2 * np.pi), information**-0.5 / (2 * np.pi), float(np.sum(cost)))

    def relative_change(self, other: _Valley) -> float:
        """Root mean square of the difference between the amplitudes, over the amplitudes."""
        pairs = zip(self.solutions, other.solutions, strict=True)
        ratios = [float(np.hypot(*a.p[-4:-2]) / np.hypot(*b.p[-4:-2])) - 1 for a, b in pairs]
        return float(np.sqrt(np.mean(np.square(ratios))))


def _solve(one: WaveformEvidence, start: FloatArray, theta_rad: float, sd_rad: float, steps: int) -> Solution:
    frame_set = one.frame_set
    model = frame_set.forward_model(lambda basis, weight: free_window_transfer, 3.0)
    prior = frame_set.prior(4)
    prior.mean[-1], prior.precision[-1, -1] = theta_rad, sd_rad**-2
    kept = one.solution.weight  # so that costs can be compared

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        p[-1] = np.clip(p[-1], theta_rad - 4 * sd_rad, theta_rad + 4 * sd_rad)
        return p

    return solve(
        frame_set.planes,
        lambda _: kept,
        model,
        start,
        prior,
        bound=bound,
        max_iterations=steps,
        light=one.solution.light,
    )
