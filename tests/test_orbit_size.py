"""One size of a motion for everybody, and a headline by the targets without a doubt."""

from __future__ import annotations

import math
from typing import Any

import pytest

from labdaemon.orbit_size import is_doubtful, largest_motion, semi_axes, semi_major_axis, size_mm


def row(target: str, a: tuple[float, ...], b: tuple[float, ...] = (0.0, 0.0, 0.0), *flags: str) -> dict[str, Any]:
    pairs = [(f"a{axis}_mm", value) for axis, value in zip("xyz", a, strict=True)]
    pairs += [(f"b{axis}_mm", value) for axis, value in zip("xyz", b, strict=True)]
    return {"target": target, "flags": list(flags), **dict(pairs)}


def test_a_motion_that_lies_in_b_has_its_whole_size() -> None:
    assert size_mm(row("T", (0.1, 0.0, 0.0), (0.0, 0.0, 3.0))) == pytest.approx(3.0)
    assert size_mm(row("T", (3.0, 0.0, 0.0), (4.0, 0.0, 0.0))) == pytest.approx(5.0)
    assert semi_major_axis((1.0, 0.0), (0.0, 1.0)) == pytest.approx(1.0)


def test_the_axes_belong_to_the_size() -> None:
    major, minor = semi_axes((1.0, 2.0, 0.5), (-0.3, 1.0, 2.0))
    assert math.dist(major, (0, 0, 0)) == pytest.approx(semi_major_axis((1.0, 2.0, 0.5), (-0.3, 1.0, 2.0)))
    assert sum(x * y for x, y in zip(major, minor, strict=True)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_a_row_without_numbers_has_no_size(value: float | None) -> None:
    assert size_mm({"ax_mm": value, "ay_mm": 1.0, "az_mm": 1.0}) is None
    assert size_mm({}) is None


def test_doubtful_targets_are_counted_apart_and_lead_only_where_there_are_no_others() -> None:
    rows = [row("T1", (0.411, 0.0, 0.0)), row("R12", (0.0, 0.977, 0.0), (0.0,) * 3, "ambiguous")]
    rows.append(row("T2", (0.001, 0.0, 0.0), (0.0,) * 3, "at_rest"))
    rows.append({"target": "T9", "flags": ["not_found"], "ax_mm": None})
    assert largest_motion(rows).text() == "largest 0.411 mm at T1; 1 doubtful"
    assert largest_motion(rows[1:2]).text() == "all 1 doubtful, the largest of these 0.977 mm at R12"
    assert largest_motion([]).text() == ""


def test_captures_that_contradict_each_other_still_moved() -> None:
    """An interlock sees a structure that rings while a group is taken: each of its captures says that it moves."""
    row = {"target": "T", "ax_mm": 3.0, "ay_mm": 0.0, "az_mm": 0.0, "bx_mm": 0.0, "by_mm": 4.0, "bz_mm": 0.0}
    motion = largest_motion([row | {"flags": ["contradicts_group"]}, row | {"ax_mm": 50.0, "flags": ["ambiguous"]}])
    assert (motion.size_mm, motion.doubtful) == (4.0, 1)
    assert is_doubtful({"flags": ["contradicts_group", "poor_fit"]})
