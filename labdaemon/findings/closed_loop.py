"""A sweep that chooses its own frequencies: a coarse search, then steps where they give most information.

The first sweep is too coarse to show a resonance curve, but the flanks of a mode of 1 % damping reach far: with
amplitudes known to a few thousandths a rational model finds it from steps ten half-bandwidths apart. Whether the sweep
stepped over a mode is tested with every step: a mode that the model lacks leaves residuals beyond the noise, and then
the search begins anew, with one more step in the widest gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labdaemon.findings.find_modes import SIGNIFICANCE, find_modes, unusable_pole
from labdaemon.findings.linearise import ModalProblem
from labdaemon.findings.modal_basis import ModalBasis, ModeForm
from labdaemon.findings.modal_fit import ModalFit, initial_parameters, refit, response_of
from labdaemon.findings.next_frequency import candidate_frequencies, next_frequency
from labdaemon.findings.phase_retrieval import fit_with_signs, with_residues
from labdaemon.findings.response import FloatArray, PhaseReference, ResponseSeries
from labdaemon.findings.signed_steps import without_signs

CLOSED_RATIO = 1.004
"""Ratio of neighbouring steps below which no mode hides between them."""
FIRST_RATIO = 1.07
"""Ratio of neighbouring frequencies of the first sweep."""


@dataclass(frozen=True, slots=True)
class ResonanceGoal:
    """What a closed-loop sweep is to reach.

    Attributes
    ----------
    band_hz
        Where modes are searched.
    sd_frequency, sd_damping
        Relative standard deviations wanted of each natural frequency and damping.
    most_steps
        At which it ends in any case.
    """

    band_hz: tuple[float, float]
    sd_frequency: float = 2e-5
    sd_damping: float = 0.008
    most_steps: int = 160


@dataclass(frozen=True, slots=True, eq=False)
class SweepDecision:
    """What to do next.

    Attributes
    ----------
    frequency_hz
        The next step; None: the sweep is complete.
    fit
        The model as it is now; None before there is one.
    reason
        Why, in a few words.
    is_reached
        Whether it is complete because all modes are known as well as was wanted.
    """

    frequency_hz: float | None
    fit: ModalFit | None
    reason: str
    is_reached: bool = False


def first_sweep(band_hz: tuple[float, float], ratio: float = FIRST_RATIO) -> FloatArray:
    """Frequencies of the first search, logarithmic over the band, its ends included."""
    count = max(int(np.ceil(np.log(band_hz[1] / band_hz[0]) / np.log(ratio))) + 1, 8)
    return np.geomspace(*band_hz, count)


def decide(
    series: ResponseSeries,
    known: ModalFit | None,
    goal: ResonanceGoal,
    *,
    sd_mm: float,
    sd_table: float,
    table_mm: float | Callable[[ModalFit, FloatArray], FloatArray],
) -> SweepDecision:
    """The next frequency after the steps so far.

    Parameters
    ----------
    series
        All steps, the new ones last.
    known
        The fit of the last decision, to continue from; None: search.
    sd_mm, sd_table, table_mm
        Expected of the next step. The table's amplitude is a number, or a rule that gives it at each frequency: near a
        resonance a table moves less than it can.
    """
    level = SIGNIFICANCE / goal.most_steps  # the question is asked after each step
    series = without_signs(series)  # where only some steps show phase, amplitudes are what the search goes by
    fitted = _continue(series, known, goal)
    if fitted is None:
        found = find_modes(series, band_hz=goal.band_hz)
        fitted = found.fit
    if series.steps >= goal.most_steps:
        return SweepDecision(None, fitted, f"{series.steps} steps are as many as were allowed")
    if fitted is None or not is_explained(fitted, level):
        return SweepDecision(near_misfit(series, fitted), fitted, "the model does not explain all steps")
    if not fitted.modes:
        if len(series.frequency_hz) < 2 * len(first_sweep(goal.band_hz)):
            return SweepDecision(widest_gap(series.frequency_hz), fitted, "no mode is seen yet")
        return SweepDecision(None, fitted, "the band has no mode that shows")
    candidates = candidate_frequencies(fitted, goal.band_hz)
    step = next_frequency(
        fitted,
        candidates,
        sd_mm=sd_mm,
        sd_table=sd_table,
        table_mm=table_mm(fitted, candidates) if callable(table_mm) else table_mm,
        wanted=(goal.sd_frequency, goal.sd_damping),
    )
    if step is None:
        return SweepDecision(None, fitted, "all modes are known as well as was wanted", is_reached=True)
    return SweepDecision(step.frequency_hz, fitted, "here a step gives most information")


def fit_poles(series: ResponseSeries, frequency_hz: FloatArray, damping: FloatArray, residual_terms: int) -> ModalFit:
    """A fit that begins at these poles, so that a search can be taken up where another program left it.

    Parameters
    ----------
    frequency_hz, damping
        (M,) where the poles are nearly.
    """
    is_real, series = series.phase is PhaseReference.TARGET, without_signs(series)
    problem = ModalProblem.of(
        series, ModalBasis.over(series.frequency_hz, ModeForm.BASE_EXCITATION, residual_terms), is_real
    )
    return fit_with_signs(problem, with_residues(problem, initial_parameters(problem, frequency_hz, damping)))


def largest_response(fitted: ModalFit, frequency_hz: FloatArray) -> FloatArray:
    """(F,) largest semi-amplitude of any target over the table's, as the model predicts it."""
    result: FloatArray = np.max(np.linalg.norm(response_of(fitted, frequency_hz), axis=2), axis=1)
    return result


def _continue(series: ResponseSeries, known: ModalFit | None, goal: ResonanceGoal) -> ModalFit | None:
    """The known modes fitted to all steps; None where they no longer explain them."""
    if known is None or not known.modes:
        return None
    fitted = refit(known, series)
    is_sound = not any(unusable_pole(fitted, index, goal.band_hz) for index in range(fitted.modes))
    return fitted if is_sound and is_explained(fitted, SIGNIFICANCE / goal.most_steps) else None


def is_explained(fitted: ModalFit, level: float = SIGNIFICANCE) -> bool:
    """Whether the residuals are no larger than the noise.

    Parameters
    ----------
    level
        Probability of a false answer: a sweep that asks after each step divides it by their number, or it ends in
        looking for modes that are not there.
    """
    return fitted.freedom <= 0 or bool(stats.chi2.sf(fitted.chi2, fitted.freedom) > level)


def near_misfit(series: ResponseSeries, fitted: ModalFit | None) -> float:
    """Middle of the wider gap next to the step that the model explains worst: there it lacks something.

    Gaps that are closed already give way to the widest one.
    """
    ordered = np.unique(series.frequency_hz)
    if fitted is None or len(ordered) < 3:
        return widest_gap(series.frequency_hz)
    system = fitted.problem.linearise(fitted.parameters)
    rows = system.residual.reshape(len(system.residual), series.steps, -1)
    worst = series.frequency_hz[int(np.argmax(np.sum(rows**2, axis=(0, 2))))]
    place = int(np.searchsorted(ordered, worst))
    gaps = [(ordered[k + 1] / ordered[k], k) for k in (place - 1, place) if 0 <= k < len(ordered) - 1]
    ratio, k = max(gaps)
    return float(np.sqrt(ordered[k] * ordered[k + 1])) if ratio > CLOSED_RATIO else widest_gap(series.frequency_hz)


def widest_gap(frequency_hz: FloatArray) -> float:
    """Geometric middle of the widest gap between steps."""
    ordered = np.unique(frequency_hz)
    place = int(np.argmax(np.diff(np.log(ordered))))
    return float(np.sqrt(ordered[place] * ordered[place + 1]))
