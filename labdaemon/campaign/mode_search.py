"""Decides the open steps of a search for modes from the envelopes that the journal has.

A decision follows from the journal alone (the envelopes of the search's steps and the poles of the decision before), is
written to it before anything moves, and is never made twice.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

from labdaemon.campaign.excitations import FREQUENCY_DIGITS
from labdaemon.campaign.measurement_queue import MeasurementQueue
from labdaemon.campaign.steps import Plan, SearchPlan, Step
from labdaemon.capture.recorder import Recorder
from labdaemon.errors import LimitError
from labdaemon.events import DecisionData, GaugeMotion, ModeEstimate
from labdaemon.journal import records, transitions
from labdaemon.journal.decision_records import decisions_of
from labdaemon.journal.gauge_records import gauges_of
from labdaemon.journal.journal import Journal

if TYPE_CHECKING:
    from labdaemon.findings import ModalFit
    from labdaemon.findings.closed_loop import SweepDecision
    from labdaemon.findings.envelope_series import MeasuredStep
    from labdaemon.findings.response import FloatArray, ResponseSeries

LEAST_AMPLITUDE = 0.02
"""The table's amplitude is lowered to this part of the largest one at most."""

MOST_PENDING = 1
"""Captures that may still be measured when a step is decided."""

log: logging.Logger = logging.getLogger(__name__)


class StepChooser:
    """Chooses the open steps of the campaign in progress.

    Parameters
    ----------
    recorder
        The journal.
    queue
        Measures what was captured.
    """

    def __init__(self, recorder: Recorder, queue: MeasurementQueue) -> None:
        self._recorder, self._queue = recorder, queue

    async def decide(self, campaign: str, plan: Plan, step: Step) -> None:
        """Decide an open step, once the captures before it are measured that it hangs on; the journal has it then.

        The last capture may still be in the queue: while it is measured, the table settles at the next step.
        """
        await self._queue.enqueue_stored(campaign)
        await self._queue.drain(MOST_PENDING)
        decision = await self._recorder.in_background(_decide_now, self._recorder.journal, campaign, plan, step)
        if decision is None:
            await self._queue.drain()
            decision = await self._recorder.in_background(decide_step, self._recorder.journal, campaign, plan, step)
        assert decision is not None
        log.info("search %d, step %d: %s", decision.search, decision.step, decision.reason)
        await self._recorder.write(transitions.decide_step, campaign, decision)


def _decide_now(journal: Journal, campaign: str, plan: Plan, step: Step) -> DecisionData | None:
    """As `decide_step`, with whatever is not measured yet pending."""
    stored = {capture.step for capture in records.captures(journal, campaign, "stored") if not capture.is_sharp}
    pending = [one.index for one in plan.steps if one.phase == step.phase and one.index in stored]
    return decide_step(journal, campaign, plan, step, pending)


def decide_step(
    journal: Journal, campaign: str, plan: Plan, step: Step, pending: Sequence[int] = ()
) -> DecisionData | None:
    """What the journal's envelopes say about an open step.

    Parameters
    ----------
    plan
        With all decisions so far.
    step
        The first one of its search that is open.
    pending
        Steps of this search that count as captured and not measured yet.

    Returns
    -------
    DecisionData or None
        None where the pending steps may lead to another decision.
    """
    assert step.search is not None
    search = plan.searches[step.search]
    if search.source is not None:
        return _next_peak(search, step, list(decisions_of(journal, campaign).values()))
    if search.sweep is not None:
        return None if pending else _end_of_sweep(journal, campaign, search, plan, step)
    # Loaded where it is asked for: the table must be at rest before anything heavy is loaded.
    from labdaemon.findings.envelope_series import envelope_series

    before = [one for one in plan.steps if one.search == step.search and one.index < step.index]
    measured = measured_steps(journal, campaign, [one for one in before if one.index not in pending])
    series = envelope_series(measured).series if measured else None
    if series is None or not series.valid().any():
        if pending:
            return None
        reason = "no capture of this search has a target without a flag"
        return DecisionData(step=step.index, search=search.number, reason=reason, is_reached=False)
    decided = decisions_of(journal, campaign).values()
    earlier = [one for one in decided if one.search == search.number and one.step < step.index]
    waiting = [one for one in before if one.index in pending]
    return _next_step(search, step, series, earlier[-1] if earlier else None, waiting)


def _end_of_sweep(journal: Journal, campaign: str, search: SearchPlan, plan: Plan, end: Step) -> DecisionData:
    """Modes in the response of a sweep whose steps have all been taken."""
    from labdaemon.campaign.sweep_peaks import modes_of_sweep, response_motion

    measured: list[MeasuredStep] = []
    gauges: dict[int, GaugeMotion] = {}
    for step in plan.steps:
        if step.phase != search.sweep or step.index >= end.index:
            continue
        found = measured_steps(journal, campaign, [step])
        captures = records.captures(journal, campaign, "measured", step=step.index)
        seen = response_motion(gauges_of(journal, campaign, captures[-1].name)) if captures else None
        if found and seen is not None:
            gauges[len(measured)] = seen
        measured += found[:1]
    modes, reason = modes_of_sweep(measured, gauges, search.band_hz)
    return DecisionData(
        step=end.index,
        search=search.number,
        reason=reason,
        measured=len(measured),
        modes=modes,
        is_reached=bool(modes),
    )


def _next_peak(search: SearchPlan, step: Step, decided: Sequence[DecisionData]) -> DecisionData:
    """The next natural frequency of those that an earlier search has found."""
    ends = [one for one in decided if one.search == search.source and one.frequency_hz is None]
    modes = ends[-1].modes if ends else ()
    place = sum(one.search == search.number and one.step < step.index for one in decided)
    about = DecisionData(step=step.index, search=search.number)
    if not modes:
        return about.model_copy(update={"is_reached": False, "reason": "the search before it found no mode"})
    if place >= len(modes) or not step.shots:
        reason = f"{place} of {len(modes)} modes were visited"
        return about.model_copy(update={"is_reached": place >= len(modes), "reason": reason})
    frequency_hz = round(modes[place].frequency_hz, FREQUENCY_DIGITS)
    try:
        search.make_step(step, frequency_hz, search.amplitude_mm, search.hold_s)
    except LimitError as exc:
        return about.model_copy(update={"is_reached": False, "reason": f"the next mode is beyond a limit: {exc}"})
    excitation = {"frequency_hz": frequency_hz, "amplitude_mm": search.amplitude_mm, "hold_s": search.hold_s}
    return about.model_copy(update={**excitation, "reason": f"mode {place + 1} of {len(modes)}"})


def measured_steps(journal: Journal, campaign: str, steps: Sequence[Step]) -> list[MeasuredStep]:
    """Envelopes of these steps that the journal has, in the order of the steps."""
    from labdaemon.envelope import TargetEnvelope
    from labdaemon.findings.envelope_series import MeasuredStep
    from labdaemon.processing import table_motion

    found: list[MeasuredStep] = []
    for step in steps:
        captures = records.captures(journal, campaign, "measured", step=step.index)
        last = {capture.grouped or capture.name: capture for capture in captures}
        for name, capture in last.items():
            rows = records.envelope_rows(journal, campaign, name)
            if not rows or capture.frequency_hz is None:
                continue
            gauges = {one.gauge: one.model_dump() for one in gauges_of(journal, campaign, capture.name)}
            table = table_motion({"gauges": gauges, "excitation_amplitude_mm": capture.amplitude_mm})
            targets = {str(row["target"]): TargetEnvelope.from_row(row) for row in rows}
            if table is None:
                continue
            relative_sd = table.sd_mm / table.amplitude_mm
            phase = (table.phase_rad, table.sd_phase_rad)
            found.append(MeasuredStep(capture.frequency_hz, targets, table.amplitude_mm, relative_sd, *phase))
    return found


def _next_step(
    search: SearchPlan,
    step: Step,
    series: ResponseSeries,
    earlier: DecisionData | None,
    waiting: Sequence[Step],
) -> DecisionData | None:
    import numpy as np

    from labdaemon.findings.closed_loop import ResonanceGoal, decide, fit_poles

    known = None
    if earlier is not None and earlier.modes and earlier.residual_terms is not None:
        frequency = np.array([one.frequency_hz for one in earlier.modes])
        damping = np.array([one.damping for one in earlier.modes])
        known = fit_poles(series, frequency, damping, earlier.residual_terms)
    goal = ResonanceGoal(search.band_hz, search.sd_frequency, search.sd_damping, search.most_steps)
    sd_mm, sd_table = float(np.median(series.sd_real[series.valid()])), float(np.median(series.sd_table))

    def table_mm(fitted: ModalFit, frequency_hz: FloatArray) -> FloatArray:
        return _table_mm(search, fitted, frequency_hz)

    pending = [(one.frequency_hz or 0.0, one.amplitude_mm or 0.0) for one in waiting]
    found = decide(series, known, goal, sd_mm=sd_mm, sd_table=sd_table, table_mm=table_mm, pending=pending)
    if found.is_provisional:
        return None
    about = DecisionData(
        step=step.index,
        search=search.number,
        reason=found.reason,
        measured=series.steps,
        pending=tuple(one.index for one in waiting),
        modes=_estimates(found.fit, search),
        residual_terms=None if found.fit is None else found.fit.problem.basis.residual_terms,
    )
    if found.frequency_hz is None:
        return about.model_copy(update={"is_reached": found.is_reached})
    if not step.shots:  # there is no step left
        reason = f"{search.most_steps} steps are as many as were allowed, and {found.reason}"
        return about.model_copy(update={"is_reached": False, "reason": reason})
    frequency_hz = round(found.frequency_hz, FREQUENCY_DIGITS)
    amplitude_mm = search.amplitude_mm
    if found.fit is not None and found.fit.modes:
        amplitude_mm = float(f"{_table_mm(search, found.fit, np.array([frequency_hz]))[0]:.4g}")
    hold_s = _hold_s(search, found, frequency_hz, amplitude_mm, (sd_mm, sd_table))
    try:
        search.make_step(step, frequency_hz, amplitude_mm, hold_s)
    except LimitError as exc:
        return about.model_copy(update={"is_reached": False, "reason": f"the next step is beyond a limit: {exc}"})
    return about.model_copy(update={"frequency_hz": frequency_hz, "amplitude_mm": amplitude_mm, "hold_s": hold_s})


def _table_mm(search: SearchPlan, fitted: ModalFit, frequency_hz: FloatArray) -> FloatArray:
    """(F,) amplitudes of the table at which no target is predicted to move more than was wanted."""
    import numpy as np

    from labdaemon.findings.closed_loop import largest_response

    if search.largest_mm is None:
        return np.full(len(frequency_hz), search.amplitude_mm)
    wanted = search.largest_mm / np.maximum(largest_response(fitted, frequency_hz), 1e-9)
    result: FloatArray = np.clip(wanted, LEAST_AMPLITUDE * search.amplitude_mm, search.amplitude_mm)
    return result


def _hold_s(
    search: SearchPlan, found: SweepDecision, frequency_hz: float, amplitude_mm: float, sds: tuple[float, float]
) -> float:
    """How long the transient of the nearest mode must be waited for, once the step counts as settled."""
    import numpy as np

    from labdaemon.findings.closed_loop import largest_response
    from labdaemon.findings.next_frequency import UNKNOWN_DAMPING
    from labdaemon.findings.transient import settling_hold_s

    change, (sd_mm, sd_table), fitted = search.settle.max_change_per_cycle, sds, found.fit
    if fitted is None or not fitted.modes:
        return round(settling_hold_s(change, search.settle.damping_ratio, frequency_hz, sd_table), 2)
    motion_mm = amplitude_mm * float(largest_response(fitted, np.array([frequency_hz]))[0])
    sd_relative = float(np.hypot(sd_table, sd_mm / max(motion_mm, sd_mm)))
    at = fitted.parameters
    nearest = int(np.argmin(np.abs(at.log_frequency - np.log(frequency_hz))))
    factor = min(1 + 3 * float(fitted.sd_log_damping[nearest]), UNKNOWN_DAMPING)
    damping, natural_hz = float(at.damping[nearest]), float(at.frequency_hz[nearest])
    return round(settling_hold_s(change, damping, natural_hz, sd_relative, factor), 2)


def _estimates(fitted: ModalFit | None, search: SearchPlan) -> tuple[ModeEstimate, ...]:
    """The model's modes that are determined, in ascending frequency."""
    from labdaemon.findings.find_modes import unusable_pole

    if fitted is None:
        return ()
    at = fitted.parameters
    found = [
        ModeEstimate(
            frequency_hz=float(at.frequency_hz[k]),
            sd_frequency_hz=float(at.frequency_hz[k] * fitted.sd_log_frequency[k]),
            damping=float(at.damping[k]),
            sd_damping=float(at.damping[k] * fitted.sd_log_damping[k]),
        )
        for k in range(fitted.modes)
        if not unusable_pole(fitted, k, search.band_hz)
    ]
    return tuple(sorted(found, key=lambda one: one.frequency_hz))
