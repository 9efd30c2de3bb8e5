"""Data of the view in space: mean positions and motion of all targets, for `templates/space.js` to draw.

The script turns, magnifies and, where the captures show the phase, animates what is given here. Numbers are rounded to
0.1 µm, which keeps a page of 100 captures of 60 targets below 1 MB.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labdaemon.orbit_size import is_doubtful
from labdaemon.report.accuracy import row_axes
from labdaemon.report.figures import magnification

DECIMALS = 4


@dataclass(frozen=True, slots=True)
class SpaceCapture:
    """A capture to draw: its name, rows of `envelope.csv`, and whether a and b have the phase of the excitation."""

    name: str
    rows: Sequence[Mapping[str, Any]]
    is_phase_known: bool = False
    frequency_hz: float | None = None


def space_json(captures: Sequence[SpaceCapture]) -> str:
    """JSON for the script, safe inside a ``<script>`` element; "[]" where nothing was measured.

    One object per capture: ``name``, ``frequency``, ``phase``, ``magnify``, and ``targets`` of
    ``[name, x, y, z, ax, ay, az, bx, by, bz, amplitude, doubtful]``, millimetres.
    """
    shown = [one for capture in captures if (one := space_object(capture)) is not None]
    text = json.dumps(shown, separators=(",", ":"), allow_nan=False)
    # "</" could end the element, "<!--" begins a state in which it cannot end.
    return text.replace("<", "\\u003c")


def space_object(capture: SpaceCapture) -> dict[str, Any] | None:
    """One capture as `space_json` gives it; None where nothing was measured."""
    targets = [_target(row) for row in capture.rows if row_axes(row) is not None and row.get("x_mm") is not None]
    if not targets:
        return None
    places, sure = [row[1:4] for row in targets], [row[10] for row in targets if not row[11]]
    return {
        "name": capture.name,
        "frequency": capture.frequency_hz,
        "phase": capture.is_phase_known,
        "magnify": magnification(places, sure),
        "targets": targets,
    }


def _target(row: Mapping[str, Any]) -> list[Any]:
    axes = row_axes(row)
    assert axes is not None
    amplitude = float(np.linalg.norm(axes[0]))
    numbers = [row.get(f"{name}{axis}_mm") or 0.0 for name in ("", "a", "b") for axis in "xyz"]
    return [str(row["target"]), *(_rounded(value) for value in (*numbers, amplitude)), int(is_doubtful(row))]


def _rounded(value: float) -> float:
    return round(float(value), DECIMALS) + 0.0
