"""A sweep that chooses its own frequencies: a coarse search, then steps where they give most information.

The first sweep is too coarse to show a resonance curve, but the flanks of a mode of 1 % damping reach far: with
amplitudes known to a few thousandths a rational model finds it from steps ten half-bandwidths apart. Whether the sweep
stepped over a mode is tested with every step: a mode that the model lacks leaves residuals beyond the noise, and then
the search begins anew, with one more step in the widest gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import stats

from labdaemon.findings.find_modes import SIGNIFICANCE, find_modes, unusable_pole
from labdaemon.findings.linearise import ModalProblem
from labdaemon.findings.modal_basis import ModalBasis, ModeForm
from labdaemon.findings.modal_fit import ModalFit, initial_parameters, refit, response_of
from labdaemon.findings.next_frequency import candidate_frequencies, next_frequency, with_expected_steps
from labdaemon.findings.phase_retrieval import fit_with_signs, with_residues
from labdaemon.findings.response import FloatArray, PhaseReference, ResponseSeries
from labdaemon.findings.signed_steps import with_signed_steps, without_signs

CLOSED_RATIO = 1.004
"""Ratio of neighbouring steps below which no mode hides between them."""
FIRST_RATIO = 1.10
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
    is_provisional
        Whether it hangs on steps that are captured and not measured yet: to be asked again when they are.
    """

    frequency_hz: float | None
    fit: ModalFit | None
    reason: str
    is_reached: bool = False
    is_provisional: bool = False


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
    pending: Sequence[tuple[float, float]] = (),
) -> SweepDecision:
    """The next frequency after the steps so far.

    A step that is captured and not measured yet counts with what the model expects of it, so that the table need not
    wait for the measurement. Only a step that gives most information is chosen so: what ends the sweep, or looks for
    another mode, is provisional until all steps are measured.

    Parameters
    ----------
    series
        All steps, the new ones last.
    known
        The fit of the last decision, to continue from; None: search.
    sd_mm, sd_table, table_mm
        Expected of the next step. The table's amplitude is a number, or a rule that gives it at each frequency: near a
        resonance a table moves less than it can.
    pending
        Frequency (Hz) and table amplitude (mm) of each step that is captured and not measured yet.
    """
    level = SIGNIFICANCE / goal.most_steps  # the question is asked after each step
    amplitudes = without_signs(series)  # poles are searched and continued by amplitudes
    fitted = _continue(amplitudes, known, goal)
    if fitted is None:
        fitted = find_modes(amplitudes, band_hz=goal.band_hz).fit
    if fitted is not None and fitted.modes and series.signed_steps().any():
        # Complex residues show in phases alone; taken for real they leave amplitudes unexplained.
        fitted, _ = with_signed_steps(fitted, series)
    provisional = partial(SweepDecision, fit=fitted, is_provisional=bool(pending))
    if series.steps + len(pending) >= goal.most_steps:
        return provisional(None, reason=f"{series.steps + len(pending)} steps are as many as were allowed")
    if fitted is None or not is_explained(fitted, level):
        return provisional(near_misfit(series, fitted), reason="the model does not explain all steps")
    if not fitted.modes:
        if len(series.frequency_hz) < 2 * len(first_sweep(goal.band_hz)):
            return provisional(widest_gap(series.frequency_hz), reason="no mode is seen yet")
        return provisional(None, reason="the band has no mode that shows")
    candidates = candidate_frequencies(fitted, goal.band_hz)
    expected = fitted
    if pending:
        frequency_hz, amplitude_mm = np.array(pending).T
        expected = with_expected_steps(fitted, frequency_hz, amplitude_mm, sd_mm=sd_mm, sd_table=sd_table)
    step = next_frequency(
        expected,
        candidates,
        sd_mm=sd_mm,
        sd_table=sd_table,
        table_mm=table_mm(fitted, candidates) if callable(table_mm) else table_mm,
        wanted=(goal.sd_frequency, goal.sd_damping),
    )
    if step is None:
        return provisional(None, reason="all modes are known as well as was wanted", is_reached=True)
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
