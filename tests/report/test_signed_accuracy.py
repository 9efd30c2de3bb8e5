"""Errors of signed motion: vectors and phases against a truth, flagged and small motions left out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.report.signed_accuracy import compare_signed, signed_lines


def row(name: str, amplitude: float, phase_rad: float, *flags: str) -> dict[str, Any]:
    direction = np.array([0.8, 0.0, 0.6])
    a, b = amplitude * np.cos(phase_rad) * direction, amplitude * np.sin(phase_rad) * direction
    numbers = {
        f"{part}{axis}_mm": float(v)
        for part, vector in (("a", a), ("b", b))
        for axis, v in zip("xyz", vector, strict=True)
    }
    return {"target": name, **numbers, "flags": list(flags)}


@given(st.floats(0.3, 5.0), st.floats(-3.0, 3.0), st.floats(-0.4, 0.4))
def test_a_phase_error_is_what_it_is(amplitude: float, phase: float, error: float) -> None:
    found = compare_signed("one", [row("T", amplitude, phase + error)], [row("T", amplitude, phase)])
    assert found.median_deg == pytest.approx(abs(math.degrees(error)), abs=1e-6)
    assert found.p95_mm == pytest.approx(2 * amplitude * abs(math.sin(error / 2)), abs=1e-9)
    assert (found.compared, found.flagged, found.wrong) == (1, 0, 0)


def test_a_twin_is_counted_and_flags_shelter_nothing_else() -> None:
    truth = [row("A", 1.0, 0.5), row("B", 1.0, 0.5), row("C", 1.0, 0.5), row("D", 0.01, 0.0)]
    empty = {"target": "C", "ax_mm": None, "flags": ["not_found"]}
    rows = [row("A", 1.0, 0.5 + math.pi), row("B", 1.0, 2.5, "ambiguous"), empty, row("D", 0.01, 2.0)]
    found = compare_signed("one", rows, truth)
    assert (found.compared, found.flagged, found.wrong) == (1, 2, 1)
    [about, head, line] = signed_lines([found])
    assert about.startswith("Signed a and b")
    assert head.split()[0] == line.split()[0].replace("one", "capture")


def test_nothing_compared_has_no_numbers() -> None:
    assert signed_lines([]) == []
    found = compare_signed("one", [], [])
    assert math.isnan(found.p95_mm)
    assert "–" in signed_lines([found])[2]
