from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import (
    ModeSearch,
    candidate_frequencies,
    is_settled,
    joined,
    next_frequency,
    refit,
    remaining_transient,
)


def test_candidates_lie_around_the_modes_and_in_the_band(swept: ModeSearch) -> None:
    assert swept.fit is not None
    candidates = candidate_frequencies(swept.fit, (5.4, 18.0))
    assert candidates.min() >= 5.4
    assert np.all(np.diff(candidates) > 0)
    assert len(candidate_frequencies(swept.fit, (1.0, 2.0))) == 0


def test_the_best_step_improves_the_poles_as_promised(swept: ModeSearch, structure: ShearStructure) -> None:
    """The determinant after the step has grown by what was predicted."""
    assert swept.fit is not None
    candidates = candidate_frequencies(swept.fit, (4.0, 18.0))
    step = next_frequency(swept.fit, candidates, sd_mm=0.005, sd_table=0.002, table_mm=0.3)
    assert step is not None
    assert step.gain > 0
    frequency = np.array([step.frequency_hz])
    more = Instrument(table_mm=0.3, largest_mm=1e9).measure(structure, frequency, np.random.default_rng(3))
    after = refit(swept.fit, joined(swept.fit.problem.series, more))
    poles = slice(0, 4)
    before_log, after_log = (np.linalg.slogdet(one.covariance.shared[poles, poles])[1] for one in (swept.fit, after))
    assert before_log - after_log == pytest.approx(step.gain, abs=0.3)


def test_a_frequency_is_best_known_from_its_flanks(swept: ModeSearch) -> None:
    assert swept.fit is not None
    at = swept.fit.parameters
    candidates = at.frequency_hz[0] * (1 + at.damping[0] * np.linspace(-4, 4, 33))
    step = next_frequency(swept.fit, candidates, sd_mm=0.005, sd_table=0.002, table_mm=0.3, wanted=(1e-9, 1e9))
    assert step is not None
    offset = abs(step.frequency_hz / at.frequency_hz[0] - 1) / at.damping[0]
    assert 0.4 < offset < 2.1


def test_nothing_is_wanted_any_more(swept: ModeSearch) -> None:
    assert swept.fit is not None
    step = next_frequency(swept.fit, np.array([5.0]), sd_mm=0.005, sd_table=0.002, table_mm=0.3, wanted=(1.0, 1.0))
    assert step is None


def test_no_candidates_no_step(swept: ModeSearch) -> None:
    assert swept.fit is not None
    assert next_frequency(swept.fit, np.zeros(0), sd_mm=0.005, sd_table=0.002, table_mm=0.3) is None


@given(st.floats(1e-5, 0.1), st.floats(0.002, 0.1), st.floats(1 / 3, 3.0))
def test_settled_holds_with_the_damping_wrong_by_three(change: float, damping: float, wrong: float) -> None:
    """With the estimate of ζ up to three times too large, what is called settled has settled."""
    limit = 3 * remaining_transient(change, damping * wrong)
    assert is_settled(change, damping * wrong, limit * 1.001)
    true_transient = change / (2 * np.pi * damping)
    assert true_transient <= limit / 3 * 1.01


def test_transient_of_the_rule() -> None:
    """A change of 0.001 a cycle at ζ = 1 % leaves 1.6 %."""
    assert remaining_transient(0.001, 0.01, factor=1.0) == pytest.approx(0.0159, rel=0.01)
    assert not is_settled(0.001, 0.01, 0.01)


def test_joined_keeps_names(structure: ShearStructure) -> None:
    one = Instrument().measure(structure, np.array([5.0, 6.0]), np.random.default_rng(1))
    named = replace(one, targets=tuple(f"T{i}" for i in range(one.amplitude.shape[1])))
    assert joined(named, named).targets == named.targets
    assert joined(named, named).steps == 4
