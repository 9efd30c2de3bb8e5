"""The page: whole, self-contained, and true to its rows."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.processing.tables import ENVELOPE_COLUMNS, write_csv
from labdaemon.report.accuracy import compare
from labdaemon.report.figures import MAGNIFY, envelope_svg, errors_svg
from labdaemon.report.folder_page import report_folder
from labdaemon.report.html import CaptureSection, page


def envelope(capture: str = "c1", count: int = 12, scale: float = 1.0) -> list[dict[str, Any]]:
    """A column of targets that sways, the third of them without numbers."""
    rows: list[dict[str, Any]] = []
    for index in range(count):
        row: dict[str, Any] = dict.fromkeys(ENVELOPE_COLUMNS, 0.01)
        z = 60.0 * index
        row |= {"capture": capture, "target": f"T{index}", "x_mm": 10.0, "y_mm": -100.0, "z_mm": z, "flags": []}
        row |= {"ax_mm": scale * math.sin(z / 400), "ay_mm": 0.2 * scale, "az_mm": 0.0}
        row |= {"bx_mm": 0.0, "by_mm": 0.0, "bz_mm": 0.0}
        if index == 2:
            row = dict.fromkeys(ENVELOPE_COLUMNS) | {"capture": capture, "target": "T2", "flags": ["occluded"]}
        rows.append(row)
    return rows


class Collector(HTMLParser):
    """Every tag's attributes, and whether tags are closed in order."""

    VOID = frozenset({"meta", "img", "br", "link"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.references += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_whole_and_fetches_nothing() -> None:
    rows = envelope()
    truth = [{key: value for key, value in row.items() if key != "flags"} for row in rows if row["target"] != "T2"]
    text = page(
        "A <b>title</b>", "sub", [CaptureSection("c1", rows, {"excitation": "5 Hz"}, (), compare("c1", rows, truth))]
    )
    collector = Collector()
    collector.feed(text)
    assert collector.open == []
    assert all(reference.startswith("data:") for reference in collector.references)
    assert not re.search(r"https?://|@import|url\(", text)
    assert "<script" not in text
    assert "A &lt;b&gt;title" in text
    assert "11 of 12" in text
    assert "occluded" in text


def test_every_figure_is_valid_xml() -> None:
    rows = envelope()
    for svg in (envelope_svg(rows), errors_svg({"c<1>": compare("c1", rows, rows[:2]).pairs})):
        ElementTree.fromstring(svg)


def test_paths_are_magnified_about_their_mean() -> None:
    svg = ElementTree.fromstring(envelope_svg(envelope(scale=2.0)))
    paths = [element.get("points", "") for element in svg.iter() if element.tag.endswith("polygon")]
    assert len(paths) == 2 * 11  # two views of every measured target
    points = [np.array([pair.split(",") for pair in path.split()], float) for path in paths]
    front = points[:11]
    centres = [path.mean(axis=0)[1] for path in front]
    mm_px = (centres[0] - centres[-1]) / (60.0 * 11)
    top = front[-1]
    assert np.ptp(top[:, 0]) / mm_px == pytest.approx(2 * MAGNIFY * 2.0 * math.sin(660 / 400), rel=0.01)


def test_one_plane_has_one_view() -> None:
    flat = [row | {"y_mm": 0.0, "ay_mm": 0.0} if row["x_mm"] is not None else row for row in envelope()]
    assert "y mm" not in envelope_svg(flat)
    assert "y mm" in envelope_svg(envelope())


def test_a_capture_without_numbers_says_so() -> None:
    rows = [dict.fromkeys(ENVELOPE_COLUMNS) | {"capture": "c", "target": "A", "flags": ["not_found"]}]
    assert "Nothing was measured" in envelope_svg(rows)
    assert "0 of 1" in page("t", "", [CaptureSection("c", rows)])


def test_a_folders_page_tells_what_its_capture_files_say(tmp_path: Path) -> None:
    (tmp_path / "captures" / "c1").mkdir(parents=True)
    (tmp_path / "captures" / "c1" / "capture.toml").write_text("frequency_hz = 8.0\nexposure_s = 1.0\n")
    write_csv(tmp_path / "results" / "envelope.csv", ENVELOPE_COLUMNS, envelope())
    path, accuracy = report_folder(tmp_path, title="night")
    assert path == tmp_path / "results" / "index.html"
    assert accuracy == []
    text = path.read_text()
    assert "excitation 8 Hz · exposure 1 s" in text
    assert not list(tmp_path.rglob("*.tmp"))


def test_no_results_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="labdaemon process"):
        report_folder(tmp_path, title="x")
