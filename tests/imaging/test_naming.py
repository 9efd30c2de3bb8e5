from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.imaging.naming import match_names, names_by_place

GRID = np.array([(x, z) for z in (400.0, 300.0, 200.0) for x in (-100.0, 0.0, 100.0, 200.0)])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-0.08, 0.08))
def test_numbered_by_rows_whatever_the_order_and_a_slight_slope(seed: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(GRID))
    places = GRID[order] + rng.uniform(-8, 8, GRID.shape)
    names = names_by_place(places[:, 0], places[:, 1] + slope * places[:, 0])
    assert [names[k] for k in np.argsort(order)] == [f"T{k:02d}" for k in range(1, 13)]


def test_names_of_none_and_of_one() -> None:
    assert names_by_place(np.empty(0), np.empty(0)) == []
    assert names_by_place(np.array([3.0]), np.array([4.0]), prefix="P") == ["P01"]
    assert names_by_place(np.arange(120.0), np.zeros(120))[-1] == "T120"


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_named_by_projection_though_all_are_off_alike_some_missing_and_some_strange(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"N{k}" for k in range(len(GRID))]
    shift = rng.uniform(-20, 20, 2)
    seen = rng.permutation(len(GRID))[:9]
    found = np.vstack([GRID[seen] + shift + rng.uniform(-6, 6, (9, 2)), [[900.0, 900.0], [-800.0, 0.0]]])
    assert match_names(GRID, names, found) == [*(names[k] for k in seen), "", ""]


def test_no_match_beyond_the_limit_and_none_without_either_side() -> None:
    assert match_names(np.array([[0.0, 0.0]]), ["A"], np.array([[30.0, 0.0]]), within_px=10.0) == [""]
    assert match_names(np.empty((0, 2)), [], np.array([[1.0, 2.0]])) == [""]
    assert match_names(np.array([[1.0, 2.0]]), ["A"], np.empty((0, 2))) == []


def test_each_name_is_given_once() -> None:
    found = np.array([[0.0, 0.0], [3.0, 0.0]])
    assert sorted(match_names(np.array([[1.0, 0.0]]), ["A"], found, within_px=10.0)) == ["", "A"]
    assert pytest.approx(1) == len(match_names(np.array([[1.0, 0.0]]), ["A"], found[:1]))
