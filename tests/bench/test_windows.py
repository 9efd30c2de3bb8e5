"""The bench of part cycles: dots as the simulator draws them, exposures that nothing states, and known windows."""

import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.bench import windows
from labdaemon.bench.dots import PX_PER_MM, DotBench
from labdaemon.bench.windows import KnownTrials, UnknownTrials, run_known, run_unknown


def test_a_dot_is_the_same_for_the_same_seed_and_darkens_where_it_moves() -> None:
    first, second = (DotBench(3, 0.004).blurred(0.5, 0, 2.4, 0.3, direction_rad=0.2) for _ in range(2))
    np.testing.assert_array_equal(first.values, second.values)
    other = DotBench(4, 0.004).blurred(0.5, 0, 2.4, 0.3, direction_rad=0.2)
    assert np.abs(first.values - other.values).max() > 0
    still = DotBench(3, 0.004).blurred(0.0, 0, 1.0, 0.0, direction_rad=0.0)
    assert still.values.min() < 0.5 * still.values.max()


def test_an_unknown_exposure_is_found_and_its_bias_goes() -> None:
    trials = run_unknown(2.5, 1, seed=4, amplitudes_mm=(1.0, 1.6))
    assert trials.found[0] == pytest.approx(2.5, abs=0.1)
    assert np.abs(trials.estimated).max() < 0.01
    assert trials.estimated.shape == trials.whole.shape == trials.pulls.shape == (2,)


def test_a_harmonic_without_a_gauge_loses_its_bias() -> None:
    trials = run_unknown(5.0, 1, seed=3, amplitudes_mm=(1.0, 1.6), third=0.05)
    assert trials.found[0] == pytest.approx(0.05, abs=0.01)
    assert np.abs(trials.whole).max() > 3e-3 > np.abs(trials.estimated).max()


def test_one_opening_shows_the_amplitude_within_its_sd() -> None:
    known = run_known(1.5, 5.37, 2, 0.008, seed=2, openings=1)
    assert known.flagged == 0
    assert known.phase_pulls.shape == (0,)
    assert np.abs(known.amplitude_pulls).max() < 3
    assert np.all(known.error_mm < 4 * known.bound_mm)


def test_signed_vectors_through_known_windows_are_near_the_bound() -> None:
    known = run_known(0.8, 5.5, 1, 0.004, seed=2)
    assert known.flagged == 0
    assert known.error_mm.shape == known.bound_mm.shape == (1,)
    assert 0 < known.error_mm[0] < 5 * known.bound_mm[0]
    assert 0.005 < known.bound_mm[0] * PX_PER_MM / 0.8 < 0.5
    assert known.amplitude_pulls.shape == known.phase_pulls.shape == (1,)


def test_valleys_that_are_narrower_than_the_phases_tried_are_followed_through_short_windows() -> None:
    known = run_known(0.8, 0.3, 1, 0.004, seed=94)
    assert known.flagged == 0
    assert known.error_mm[0] < 5 * known.bound_mm[0]


def test_the_command_prints_a_line_for_each_case(monkeypatch: pytest.MonkeyPatch) -> None:
    one, nothing = np.array([0.01]), np.array([np.nan])
    monkeypatch.setattr(windows, "run_unknown", lambda cycles, *_, **__: UnknownTrials(cycles, nothing, one, one, one))
    monkeypatch.setattr(windows, "run_known", lambda size, *_, **__: KnownTrials(size, one, one, one, one, 0))
    lines = CliRunner().invoke(windows.command, catch_exceptions=False).output.splitlines()
    assert len(lines) == 6 + len(windows.CYCLES) + len(windows.PHASES_DEG) + len(windows.KNOWN_MM)
    assert "whole" in lines[2]
