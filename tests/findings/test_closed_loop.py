from __future__ import annotations

import numpy as np
import pytest

from labdaemon.bench.findings import resonance_goals
from labdaemon.bench.findings_trials import ComparisonTrials, bound_of, judge_resonance, uniform_steps
from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModalFit, ModeSearch, joined
from labdaemon.findings.closed_loop import ResonanceGoal, decide, first_sweep, near_misfit, widest_gap

GOAL = ResonanceGoal((4.0, 18.0), sd_frequency=3e-5, sd_damping=0.01, most_steps=50)


def test_the_first_sweep_covers_the_band() -> None:
    frequency = first_sweep((4.0, 18.0))
    assert frequency[0] == pytest.approx(4.0)
    assert frequency[-1] == pytest.approx(18.0)
    assert np.all(frequency[1:] / frequency[:-1] <= 1.1001)
    assert len(first_sweep((4.0, 4.1))) == 8


def test_a_sweep_ends_when_all_is_known(structure: ShearStructure) -> None:
    rng, instrument = np.random.default_rng(21), Instrument()
    series = instrument.measure(structure, first_sweep(GOAL.band_hz), rng)
    fitted: ModalFit | None = None
    reasons = []
    while True:
        decision = decide(series, fitted, GOAL, sd_mm=0.005, sd_table=0.002, table_mm=0.25)
        fitted, reasons = decision.fit, [*reasons, decision.reason]
        if decision.frequency_hz is None:
            break
        assert GOAL.band_hz[0] <= decision.frequency_hz <= GOAL.band_hz[1]
        series = joined(series, instrument.measure(structure, np.array([decision.frequency_hz]), rng))
    assert reasons[-1] == "all modes are known as well as was wanted"
    assert fitted is not None
    assert series.steps < 45
    natural = structure.modes()[0][:2]
    found = np.sort(fitted.parameters.frequency_hz)
    assert found == pytest.approx(natural, rel=1.5e-4)


def test_a_step_that_is_still_measured_counts_as_expected(swept: ModeSearch) -> None:
    assert swept.fit is not None
    series, goal = swept.fit.problem.series, ResonanceGoal((4.0, 18.0), sd_frequency=3e-6, sd_damping=1e-3)
    first = decide(series, swept.fit, goal, sd_mm=0.005, sd_table=0.002, table_mm=0.25)
    assert first.frequency_hz is not None
    assert not first.is_provisional
    pending = [(first.frequency_hz, 0.25)]
    second = decide(series, swept.fit, goal, sd_mm=0.005, sd_table=0.002, table_mm=0.25, pending=pending)
    assert not second.is_provisional
    assert second.frequency_hz != first.frequency_hz, "what it shows is expected already"


def test_what_ends_a_sweep_waits_for_the_last_envelopes(swept: ModeSearch) -> None:
    assert swept.fit is not None
    series = swept.fit.problem.series
    for goal in (
        ResonanceGoal((4.0, 18.0), sd_frequency=0.1, sd_damping=0.5),
        ResonanceGoal((4.0, 18.0), most_steps=8),
    ):
        last = decide(series, swept.fit, goal, sd_mm=0.005, sd_table=0.002, table_mm=0.25, pending=[(6.0, 0.25)])
        assert last.frequency_hz is None
        assert last.is_provisional
        assert not decide(series, swept.fit, goal, sd_mm=0.005, sd_table=0.002, table_mm=0.25).is_provisional


def test_a_limit_of_steps_ends_it(structure: ShearStructure) -> None:
    series = Instrument().measure(structure, first_sweep((4.0, 8.0)), np.random.default_rng(1))
    goal = ResonanceGoal((4.0, 8.0), most_steps=series.steps)
    decision = decide(series, None, goal, sd_mm=0.005, sd_table=0.002, table_mm=0.25)
    assert decision.frequency_hz is None
    assert "as many as were allowed" in decision.reason


def test_a_missed_mode_shows_as_misfit(swept: ModeSearch, structure: ShearStructure) -> None:
    """The model of the first two modes meets steps around the third."""
    assert swept.fit is not None
    more = Instrument().measure(structure, np.array([22.0, 23.5, 24.0, 26.0]), np.random.default_rng(2))
    series = joined(swept.fit.problem.series, more)
    decision = decide(series, swept.fit, ResonanceGoal((4.0, 30.0)), sd_mm=0.005, sd_table=0.002, table_mm=0.25)
    assert decision.frequency_hz is not None
    assert decision.reason in ("the model does not explain all steps", "here a step gives most information")


def test_steps_go_into_the_widest_gap() -> None:
    assert widest_gap(np.array([4.0, 5.0, 9.0, 10.0])) == pytest.approx(np.sqrt(45.0))
    series = Instrument().measure(ShearStructure(per_column=2), np.array([4.0, 5.0, 9.0]), np.random.default_rng(1))
    assert near_misfit(series, None) == pytest.approx(np.sqrt(45.0))


def test_bench_judges_a_fit(swept: ModeSearch, structure: ShearStructure) -> None:
    assert swept.fit is not None
    trial = judge_resonance(swept.fit.problem.series, swept.fit, structure)
    assert not trial.found, "two of four modes"
    sd_hz, sd_damping = bound_of(structure, swept.fit.problem.series)
    assert np.all(sd_hz[:2] < 1e-3)
    assert np.all(sd_damping[:2] < 0.1)
    goals = {one.name: one for one in resonance_goals([trial], [0.1])}
    assert not goals["structures whose modes were all found, part"].is_met


def test_a_uniform_sweep_needs_more_for_more() -> None:
    structure = ShearStructure(per_column=2)
    coarse = uniform_steps(structure, ResonanceGoal((4.0, 34.0), 2e-4, 0.05), dense=90)
    assert uniform_steps(structure, ResonanceGoal((4.0, 34.0), 5e-5, 0.05), dense=90) > coarse


def test_bench_compares_moved_cameras() -> None:
    trials = ComparisonTrials.of(3, per_column=4)
    found = trials.compare(trials.structure, np.random.default_rng(1), is_moved=True)
    assert found.p_value > 0.001
    assert len(found.modes) == 4
