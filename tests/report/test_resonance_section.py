"""Resonances on the page: the modes that the envelopes show, and curves that pass through the readings."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from labdaemon.bench.campaign_folder import write_campaign
from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.report.folder_page import report_folder
from labdaemon.report.frequency_chart import MAX_LINES, ChartPoint, frequency_svg
from labdaemon.report.resonance_section import resonance_section

STRUCTURE = ShearStructure(per_column=3)
NAMES = tuple(f"{side}{i + 1}" for side in "LR" for i in range(3))
FIRST_HZ = float(STRUCTURE.modes()[0][0])


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frequency = FIRST_HZ * np.linspace(0.92, 1.08, 11)
    series = Instrument().measure(STRUCTURE, frequency, np.random.default_rng(5))
    folder = tmp_path_factory.mktemp("resonance")
    return write_campaign(folder, replace(series, targets=NAMES), STRUCTURE.positions_mm())


def test_the_page_shows_the_mode_and_its_curve(campaign: Path) -> None:
    path, _ = report_folder(campaign, title="sweep")
    text = path.read_text()
    assert "lines: the fitted modes" in text
    found = re.search(r"<td>1</td><td>([\d.]+)</td>", text)
    assert found is not None
    assert float(found[1]) == pytest.approx(FIRST_HZ, rel=1e-3)


def test_curves_are_the_structures_own_response(campaign: Path) -> None:
    section = resonance_section(campaign, campaign / "results")
    assert section.grid is not None
    assert len(section.grid.lines) == 1
    assert section.transmissibility is not None
    highest = {line[0]: float(line[1]) for line in section.transmissibility.lines}
    assert max(highest, key=highest.__getitem__) in {"L3", "R3"}, "the top moves most"
    for place, name in enumerate(NAMES):
        frequency, amplitude = np.array(section.curves[name]).T
        true = np.linalg.norm(STRUCTURE.response(frequency)[:, place], axis=1)
        assert amplitude == pytest.approx(true, rel=0.02, abs=0.05)
        assert np.all(np.diff(frequency) > 0)


def test_a_folder_without_frequencies_says_why(tmp_path: Path) -> None:
    assert resonance_section(tmp_path, tmp_path / "results").notes[0].endswith("run: labdaemon process FOLDER")


def test_lines_are_few_and_differ_in_colour_dash_and_mark() -> None:
    targets = {f"T{k}": [ChartPoint(f, 1.0 + k, 0.01) for f in (4.0, 5.0)] for k in range(MAX_LINES + 3)}
    svg = frequency_svg(targets, is_ratio=False)
    assert svg is not None
    lines = [one for one in ElementTree.fromstring(svg).iter() if one.tag == "polyline"]
    assert len({(one.get("stroke"), one.get("stroke-dasharray")) for one in lines}) == len(lines) == MAX_LINES


def test_amplitudes_of_many_decades_are_on_a_logarithmic_axis() -> None:
    def heights(values: tuple[float, ...]) -> list[float]:
        points = [ChartPoint(4.0 + k, value, 0.0) for k, value in enumerate(values)]
        svg = frequency_svg({"A": points}, is_ratio=False)
        assert svg is not None
        line = next(one for one in ElementTree.fromstring(svg).iter() if one.tag == "polyline")
        return [float(pair.split(",")[1]) for pair in line.get("points", "").split()]

    low, middle, high = heights((0.1, 1.0, 10.0))
    assert low - middle == pytest.approx(middle - high, abs=0.2)
    low, middle, high = heights((1.0, 2.0, 3.0))
    assert low - middle == pytest.approx(middle - high, abs=0.2)
