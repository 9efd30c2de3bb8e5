"""ErrorStatistics of merit of errors made up to have known ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from labdaemon.bench.bound import BoundTable
from labdaemon.bench.pairs import MotionComparison
from labdaemon.bench.statistics import figures, median_phase_error_deg


def pairs_with(
    errors: np.ndarray, amplitude: float = 1.0, sd: float = 0.01, flags: frozenset[str] = frozenset()
) -> list[MotionComparison]:
    zero = np.zeros(3)
    direction = np.array([0.6, 0.0, 0.8])
    return [
        MotionComparison(8.0, amplitude * direction, zero, (amplitude + e) * direction, zero, sd, flags, (e / sd,))
        for e in errors
    ]


def test_mean_spread_pulls_and_bound() -> None:
    errors = np.random.default_rng(1).normal(0.002, 0.01, 4000)
    bounds = BoundTable(np.array([0.1, 12.0]), {8.0: np.array([0.005, 0.005])}, {8.0: np.array([0.01, 0.01])})
    f = figures(pairs_with(errors), bounds)
    assert f.mean_mm == pytest.approx(0.002, abs=5e-4)
    assert f.sd_mm == pytest.approx(0.01, rel=0.05)
    assert f.p95_mm == pytest.approx(float(np.quantile(np.abs(errors), 0.95)))
    assert f.pull_rms == pytest.approx(math.hypot(1.0, 0.2), rel=0.05)
    assert f.bound_ratio == pytest.approx(2.0 * math.hypot(1.0, 0.2), rel=0.05)
    assert f.bound_mm == pytest.approx(0.005)
    assert f.ideal_p95_mm == pytest.approx(1.96 * 0.005, rel=1e-3)
    assert f.ideal_direction_p95_deg == pytest.approx(1.96 * math.degrees(math.atan(0.01)), rel=1e-3)
    assert f.relative_p95 == pytest.approx(f.p95_mm)
    assert f.direction_p95_deg == pytest.approx(0.0, abs=1e-6)


def test_what_is_taken_back_is_counted_but_not_averaged() -> None:
    good, bad = pairs_with(np.full(3, 0.01)), pairs_with(np.full(1, 5.0), flags=frozenset({"occluded"}))
    f = figures(good + bad)
    assert (f.targets, f.compared) == (4, 3)
    assert f.mean_mm == pytest.approx(0.01)
    assert math.isnan(f.bound_ratio)


def test_small_amplitudes_are_not_held_against_the_bound() -> None:
    bounds = BoundTable(np.array([0.1, 12.0]), {8.0: np.array([0.005, 0.005])}, {8.0: np.array([0.01, 0.01])})
    f = figures(pairs_with(np.full(4, 0.02), amplitude=0.15), bounds)
    assert math.isnan(f.bound_ratio)
    assert f.p95_mm == pytest.approx(0.02)


def test_nothing_gives_nothing() -> None:
    f = figures([])
    assert f.targets == 0
    assert math.isnan(f.mean_mm)
    assert math.isnan(median_phase_error_deg([]))
