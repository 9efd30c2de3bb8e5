"""The page: whole, self-contained, and true to its rows."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from labdaemon.errors import DataError
from labdaemon.processing.tables import ENVELOPE_COLUMNS, write_csv
from labdaemon.report.accuracy import compare
from labdaemon.report.figures import envelope_svg, errors_svg, magnification
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

    VOID = frozenset({"meta", "img", "br", "link", "input"})

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
    assert "A &lt;b&gt;title" in text
    assert "11 of 12" in text
    assert "occluded" in text


def test_every_figure_is_valid_xml() -> None:
    rows = envelope()
    for svg in (envelope_svg(rows), errors_svg({"c<1>": compare("c1", rows, rows[:2]).pairs})):
        ElementTree.fromstring(svg)


def ellipses(svg: str) -> list[tuple[float, float, float, float]]:
    """Centre x and y, and half the width and height, of every path that is drawn."""
    found = []
    for element in ElementTree.fromstring(svg).iter():
        if element.tag.endswith("ellipse"):
            numbers = [float(part) for part in re.findall(r"-?[\d.]+", element.get("transform", ""))]
            rx, ry, angle = float(element.get("rx", 0)), float(element.get("ry", 0)), math.radians(numbers[2])
            width = math.hypot(rx * math.cos(angle), ry * math.sin(angle))
            height = math.hypot(rx * math.sin(angle), ry * math.cos(angle))
            found.append((numbers[0], numbers[1], width, height))
    return found


def test_paths_are_magnified_about_their_mean() -> None:
    rows = envelope(scale=2.0)
    paths = ellipses(envelope_svg(rows))
    assert len(paths) == 3 * 11  # three views of every measured target
    front, top = paths[:11], paths[10]
    px_mm = (front[0][1] - front[-1][1]) / (60.0 * 11)
    places = [[row["x_mm"], row["y_mm"], row["z_mm"]] for row in rows if row["x_mm"] is not None]
    largest = math.hypot(2.0 * math.sin(660 / 400), 0.4)
    magnify = magnification(places, [largest])
    assert top[2] / px_mm == pytest.approx(magnify * 2.0 * math.sin(660 / 400), rel=0.02)


@pytest.mark.parametrize("largest", [0.01, 0.3, 2.0, 45.0])
def test_the_largest_motion_is_readable_whatever_its_size(largest: float) -> None:
    factor = magnification([[0, 0, 0], [0, 0, 660]], [largest, largest / 3])
    assert 660 / 25 < factor * largest <= 66
    assert float(f"{factor:.0e}") == factor  # a round number
    assert magnification([[0, 0, 0]], [1.0]) == magnification([[0, 0, 0], [1, 1, 1]], []) == 1.0


def test_an_orbits_shadow_is_an_ellipse_of_the_right_size() -> None:
    rows = [
        dict.fromkeys(ENVELOPE_COLUMNS, 0.0) | {"target": f"T{k}", "z_mm": 300.0 * k, "flags": []} for k in range(2)
    ]
    for row in rows:
        row |= {"ax_mm": 3.0, "by_mm": 1.0}
    rows[1]["y_mm"] = 200.0
    paths = ellipses(envelope_svg(rows))
    front, side, plan = paths[0], paths[2], paths[4]
    assert side[2] / front[2] == pytest.approx(1 / 3, rel=0.03)
    assert plan[3] / plan[2] == pytest.approx(1 / 3, rel=0.03)


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
