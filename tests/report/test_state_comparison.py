"""Two states on one page: the verdict, and both envelopes on one scale."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.bench.campaign_folder import write_campaign
from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.cli.main import cli
from labdaemon.errors import DataError
from labdaemon.findings.response import FloatArray
from labdaemon.processing import CaptureFacts
from labdaemon.report.folder_page import report_folder
from labdaemon.report.state_comparison import MAX_FIGURES, State, _common, state_svg

STRUCTURE = ShearStructure(per_column=4)
NAMES = tuple(f"{side}{i + 1}" for side in "LR" for i in range(4))
STEPS_HZ = np.array([5.2, 8.0, 15.0])


def write(folder: Path, structure: ShearStructure, seed: int, steps_hz: FloatArray = STEPS_HZ) -> Path:
    series = Instrument().measure(structure, steps_hz, np.random.default_rng(seed))
    return write_campaign(folder, replace(series, targets=NAMES), structure.positions_mm())


def row(target: str, x: float, ax: float, *flags: str) -> dict[str, Any]:
    numbers = {f"{name}{axis}_mm": 0.0 for name in ("", "a", "b") for axis in "xyz"}
    return numbers | {"target": target, "x_mm": x, "z_mm": 100.0 * x, "ax_mm": ax, "flags": [*flags]}


def widths(svg: str) -> list[float]:
    """Horizontal half-axes of the orbits of the front view, baseline first; the legend's are left out."""
    orbits = [one for one in ElementTree.fromstring(svg).iter() if one.tag == "ellipse" and one.get("transform")]
    return [float(one.get("rx", 0)) for one in orbits]


def test_the_page_shows_a_storey_that_lost_stiffness(tmp_path: Path) -> None:
    before = write(tmp_path / "before", STRUCTURE, 1)
    after = write(tmp_path / "after", STRUCTURE.with_stiffness(1, 0.8), 2)
    result = CliRunner().invoke(cli, ["report", str(after), "--compare", str(before)], catch_exceptions=False)
    assert result.exit_code == 0
    text = (after / "results" / "index.html").read_text()
    assert "<h2>Change since before</h2>" in text
    assert "The structure changed" in text
    assert text.count("Baseline and present state") == len(STEPS_HZ)


def test_the_page_lists_pairs_of_modes(tmp_path: Path) -> None:
    sweep = STRUCTURE.modes()[0][0] * (1 + 0.01 * np.array([-8, -2, -1, -0.4, 0.4, 1, 2, 8]))
    before, after = (write(tmp_path / name, STRUCTURE, seed, sweep) for name, seed in (("before", 1), ("after", 2)))
    path, _ = report_folder(after, title="x", baseline=before)
    assert "<td>1.0000" in path.read_text() or "<td>0.9999" in path.read_text()


def test_two_campaigns_of_one_state_do_not_differ(tmp_path: Path) -> None:
    before, after = (write(tmp_path / name, STRUCTURE, seed) for name, seed in (("before", 1), ("after", 2)))
    path, _ = report_folder(after, title="x", baseline=before)
    assert "No change beyond noise" in path.read_text()


def test_nothing_in_common_is_said(tmp_path: Path) -> None:
    after = write(tmp_path / "after", STRUCTURE, 1)
    with pytest.raises(DataError, match="labdaemon process"):
        report_folder(after, title="x", baseline=tmp_path / "nowhere")


def test_both_states_have_one_scale_and_the_baseline_the_tables_amplitude_of_now() -> None:
    then, now = [row("A", 0.0, 1.0), row("B", 5.0, 0.5)], [row("A", 0.0, 3.0), row("B", 5.0, 1.0)]
    one, two, three, four = widths(state_svg(then, now, 2.0))
    assert one / three == pytest.approx(2.0 / 3.0, rel=0.01)
    assert two / four == pytest.approx(1.0, rel=0.01)


def test_doubtful_readings_are_not_drawn() -> None:
    svg = state_svg([row("A", 0.0, 1.0)], [row("A", 0.0, 1.0), row("B", 5.0, 90.0, "poor_fit")])
    assert len(widths(svg)) == 2
    assert "was not measured" in state_svg([row("A", 0.0, 1.0, "occluded")], [row("A", 0.0, 1.0)])


def test_captures_of_one_frequency_are_pairs() -> None:
    def state(table: float | None, *frequencies: float) -> State:
        names = [f"c{k}" for k in range(len(frequencies))]
        facts = {name: CaptureFacts(f, table) for name, f in zip(names, frequencies, strict=True)}
        return State({name: [row("A", 0.0, 1.0)] for name in [*names, "no-frequency"]}, facts)

    pairs = _common(state(0.5, 12.0, 5.0), state(2.0, 5.005, 8.0, 12.0))
    assert [(one[0], one[3]) for one in pairs] == [(5.005, 4.0), (12.0, 4.0)]
    assert _common(state(None, 5.0), state(2.0, 5.0))[0][3] == 1.0
    assert len(_common(state(1.0, *range(1, 10)), state(1.0, *range(1, 10)))) > MAX_FIGURES
    assert math.isclose(pairs[0][0], 5.005)
