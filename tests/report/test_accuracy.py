"""Errors against a truth that is known, on numbers made by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.report.accuracy import compare, read_truth, row_axes, semi_amplitude_sd_mm


def row(target: str, x: float, a: tuple[float, float, float] | None, flags: tuple[str, ...] = ()) -> dict[str, Any]:
    """A row of `envelope.csv` on a line of targets."""
    numbers = (
        dict.fromkeys(("ax_mm", "ay_mm", "az_mm"), None)
        if a is None
        else dict(zip(("ax_mm", "ay_mm", "az_mm"), a, strict=True))
    )
    place = {"x_mm": None if a is None else x, "y_mm": 0.0, "z_mm": 0.0}
    rest = {"bx_mm": None, "by_mm": None, "bz_mm": None, "sd_ax_mm": 0.01, "sd_ay_mm": 0.02, "sd_az_mm": None}
    return {"target": target, **place, **numbers, **rest, "flags": list(flags)}


def truth(target: str, x: float, a: tuple[float, float, float]) -> dict[str, Any]:
    return {"target": target, "x_mm": x, "y_mm": 0.0, "z_mm": 0.0, "ax": a[0], "ay": a[1], "az": a[2]}


def test_errors_of_moving_unflagged_targets_only() -> None:
    true = [truth(f"t{i}", 50.0 * i, (length, 0.0, 0.0)) for i, length in enumerate((1.0, 2.0, 0.1, 3.0, 4.0))]
    rows = [
        row("A", 1.0, (1.01, 0.0, 0.0)),  # named otherwise, but there
        row("t1", 50.0, (0.0, 1.97, 0.0), ("at_rest",)),
        row("t2", 100.0, (0.5, 0.0, 0.0)),  # below the floor
        row("t3", 150.0, (9.0, 0.0, 0.0), ("poor_fit",)),
        row("t4", 200.0, None, ("occluded",)),
    ]
    found = compare("c1", rows, true)
    assert (found.targets, found.unflagged, found.compared) == (5, 3, 2)
    assert found.mean_mm == pytest.approx(-0.01)
    assert found.sd_mm == pytest.approx(0.02 * math.sqrt(2))
    assert found.p95_mm == pytest.approx(np.quantile([0.01, 0.03], 0.95))
    assert [pair.flags for pair in found.pairs] == [(), ("at_rest",), (), ("poor_fit",), ("occluded",)]


def test_a_target_that_is_nowhere_is_not_found() -> None:
    found = compare("c1", [row("B", 500.0, (1.0, 0.0, 0.0))], [truth("A", 0.0, (1.0, 0.0, 0.0))])
    assert (found.unflagged, found.compared, found.pairs[0].flags) == (0, 0, ("not_found",))
    assert math.isnan(found.mean_mm)


AXIS = st.tuples(*(st.floats(-5, 5),) * 3)


@settings(max_examples=40, deadline=None)
@given(a=AXIS, b=AXIS)
def test_row_axes_are_those_of_the_sampled_orbit(a: Any, b: Any) -> None:
    names = [f"{kind}{axis}_mm" for kind in "ab" for axis in "xyz"]
    axes = row_axes(dict(zip(names, (*a, *b), strict=True)))
    assert axes is not None
    phase = np.linspace(0, 2 * math.pi, 8001)[:, None]
    lengths = np.linalg.norm(np.sin(phase) * np.array(a) + np.cos(phase) * np.array(b), axis=1)
    assert np.linalg.norm(axes[0]) == pytest.approx(lengths.max(), abs=1e-5)
    assert np.linalg.norm(axes[1]) == pytest.approx(lengths.min(), abs=5e-3)
    assert abs(axes[0] @ axes[1]) < 1e-9 * max(1.0, lengths.max() ** 2)


def test_sd_of_the_length_is_that_along_the_motion() -> None:
    assert semi_amplitude_sd_mm(row("A", 0.0, (0.0, 2.0, 0.0))) == pytest.approx(0.02)
    assert semi_amplitude_sd_mm(row("A", 0.0, (3.0, 4.0, 0.0))) == pytest.approx(math.hypot(0.6 * 0.01, 0.8 * 0.02))
    assert semi_amplitude_sd_mm(row("A", 0.0, None)) is None


def test_truth_files(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    path.write_text("capture,target,x_mm,y_mm,z_mm,ax,ay,az,bx,by,bz\nc1,A,1,2,3,4,5,6,7,8,9\nc2,A,0,0,0,0,0,0,0,0,0\n")
    assert read_truth(path)["c1"][0]["by"] == 8.0
    path.write_text("name,x\nA,1\n")
    with pytest.raises(DataError, match=r"truth\.csv"):
        read_truth(path)
    with pytest.raises(DataError, match="no truth"):
        read_truth(tmp_path / "missing.csv")
