from __future__ import annotations

import numpy as np
import pytest

from labdaemon.correlation_text import correlation_text, covariance_of


def covariance(seed: int = 1, rank: int = 12) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(9, rank)) * np.geomspace(0.001, 0.1, 9)[:, None]
    return root @ root.T


def test_a_covariance_comes_back() -> None:
    one = covariance()
    sd = np.sqrt(np.diag(one))
    text = correlation_text(one)
    assert text is not None
    assert len(text) < 300
    again = covariance_of(sd, text)
    assert again / np.outer(sd, sd) == pytest.approx(one / np.outer(sd, sd), abs=6e-5)


def test_rounding_leaves_no_negative_eigenvalue() -> None:
    """Of rank three: six eigenvalues are zero, and rounding alone would make some of them negative."""
    one = covariance(rank=3)
    again = covariance_of(np.sqrt(np.diag(one)), correlation_text(one))
    assert np.linalg.eigvalsh(again / np.sqrt(np.outer(np.diag(again), np.diag(again)))).min() > -1e-12
    assert np.diag(again) == pytest.approx(np.diag(one))


def test_what_has_no_sd_has_no_correlation() -> None:
    one = covariance()
    one[[1, 4, 7]] = np.nan
    one[:, [1, 4, 7]] = np.nan
    text = correlation_text(one)
    assert text is not None
    assert text.split().count("nan") == 3 + 3 * 6
    again = covariance_of(np.sqrt(np.diag(one)), text)
    assert np.isnan(again[1]).all()
    assert again[0, 8] == pytest.approx(one[0, 8], rel=0.01)
    assert correlation_text(np.full((9, 9), np.nan)) is None


@pytest.mark.parametrize("text", [None, "", "a b", "0.5", 0.01, "0.1 " * 35])
def test_without_correlations_the_covariance_is_diagonal(text: object) -> None:
    sd = np.linspace(0.1, 0.9, 9)
    assert covariance_of(sd, text) == pytest.approx(np.diag(sd**2))


def test_an_exact_number_is_correlated_with_none() -> None:
    one = covariance()
    one[2] = one[:, 2] = 0.0
    text = correlation_text(one)
    assert text is not None
    assert text.split()[1] == "0.0000"
