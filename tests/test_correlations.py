from __future__ import annotations

import numpy as np
import pytest

from labdaemon.correlations import CORRELATIONS, MOTION, POSITION, correlations_in, correlations_of, covariance_of


def covariance(seed: int = 1, rank: int = 12) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(9, rank)) * np.geomspace(0.001, 0.1, 9)[:, None]
    return root @ root.T


def test_the_columns() -> None:
    assert len(CORRELATIONS) == 3 + 15
    assert (CORRELATIONS[0], CORRELATIONS[3], CORRELATIONS[-1]) == ("cor_x_y", "cor_ax_ay", "cor_by_bz")


def test_covariances_of_position_and_motion_come_back() -> None:
    one = covariance()
    sd = np.sqrt(np.diag(one))
    again = covariance_of(sd, correlations_in({**correlations_of(one), "capture": "c1"}))
    for block in (POSITION, MOTION):
        both = np.outer(sd[block], sd[block])
        assert again[block, block] / both == pytest.approx(one[block, block] / both, abs=6e-5)
    assert again[POSITION, MOTION] == pytest.approx(np.zeros((3, 6)), abs=1e-12)


def test_rounding_leaves_no_negative_eigenvalue() -> None:
    """Of rank two: most eigenvalues are zero, and rounding alone would make some of them negative."""
    one = covariance(rank=2)
    sd = np.sqrt(np.diag(one))
    again = covariance_of(sd, correlations_in(correlations_of(one)))
    assert np.linalg.eigvalsh(again / np.outer(sd, sd)).min() > -1e-12
    assert np.diag(again) == pytest.approx(np.diag(one))


def test_what_has_no_sd_has_no_correlation() -> None:
    one = covariance()
    one[[1, 4, 7]] = np.nan
    one[:, [1, 4, 7]] = np.nan
    found = correlations_of(one)
    assert [name for name, value in found.items() if value is not None] == [
        name for name in CORRELATIONS if "y" not in name
    ]
    again = covariance_of(np.sqrt(np.diag(one)), correlations_in(found))
    assert np.isnan(again[1]).all()
    assert again[3, 8] == pytest.approx(one[3, 8], rel=0.01)
    assert set(correlations_of(np.full((9, 9), np.nan)).values()) == {None}


def test_without_correlations_the_covariance_is_diagonal() -> None:
    sd = np.linspace(0.1, 0.9, 9)
    assert covariance_of(sd, {}) == pytest.approx(np.diag(sd**2))


def test_an_exact_number_is_correlated_with_none() -> None:
    one = covariance()
    one[4] = one[:, 4] = 0.0
    assert correlations_of(one)["cor_ax_ay"] == 0.0
