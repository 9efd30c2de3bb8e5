from __future__ import annotations

import numpy as np

from labdaemon.findings.max_statistic import max_test


def test_the_rate_holds_over_correlated_statistics_and_groups() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(12, 4)) * 0.5
    covariance = np.eye(12) + root @ root.T
    rows = np.vstack([np.eye(12), rng.normal(size=(8, 12))])
    groups = ["a"] * 12 + ["b"] * 8
    draws = rng.multivariate_normal(np.zeros(12), covariance, 300)
    alarms = sum(max_test(rows, draw, covariance, groups, seed=3).is_changed for draw in draws)
    assert 4 <= alarms <= 27  # 5 % of 300, ± 3 sd


def test_a_large_difference_is_found_in_its_place() -> None:
    values = np.zeros(6)
    values[4] = 8.0
    found = max_test(np.eye(6), values, np.eye(6), ["a"] * 3 + ["b"] * 3)
    assert found.is_changed
    assert found.p_value < 1e-10
    assert np.flatnonzero(np.abs(found.z) > found.critical).tolist() == [4]


def test_what_has_no_variance_counts_as_no_difference() -> None:
    covariance = np.diag([1.0, 0.0])
    found = max_test(np.eye(2), np.array([0.1, 5.0]), covariance, ["a", "a"])
    assert found.z[1] == 0.0
    assert not found.is_changed


def test_nothing_to_test() -> None:
    assert max_test(np.zeros((0, 2)), np.zeros(2), np.eye(2), []).p_value == 1.0
