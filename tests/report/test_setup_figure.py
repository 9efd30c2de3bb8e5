"""The set-up: every target and control target at its place, in views of one scale."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from labdaemon.processing.tables import ENVELOPE_COLUMNS, write_csv
from labdaemon.report.folder_page import report_folder
from labdaemon.report.setup_figure import MAX_NAMES, setup_svg

TARGETS = {f"T<{k}>": (0.0, 0.0, 100.0 * k) for k in range(4)}
CONTROL = {"1": (-200.0, 0.0, 0.0), "2": (200.0, 0.0, 0.0), "3": (200.0, 150.0, 300.0), "4": (-200.0, 150.0, 300.0)}


def marks(svg: str) -> list[tuple[str, float, float]]:
    """Name and place of what is drawn at a place."""
    found = []
    for one in ElementTree.fromstring(svg).iter():
        title = one.findtext("title") if one.tag == "path" else None
        if title is not None:
            x, y = re.findall(r"-?[\d.]+", one.get("d", ""))[:2]
            found.append((title, float(x), float(y)))
    return found


def test_places_are_true_in_both_views() -> None:
    svg = setup_svg(TARGETS, CONTROL)
    assert svg is not None
    drawn = marks(svg)
    assert len(drawn) == 2 * (len(TARGETS) + len(CONTROL))
    front = {name: (x, y) for name, x, y in drawn[:8]}
    plan = {name: (x, y) for name, x, y in drawn[8:]}
    scale = (front["2"][0] - front["1"][0]) / 400.0
    assert (front["T<0>"][1] - front["T<3>"][1]) / 300.0 == pytest.approx(scale, rel=0.01)
    assert (plan["2"][1] - plan["3"][1]) / 150.0 == pytest.approx(scale, rel=0.01)
    assert front["2"][0] - front["T<0>"][0] == pytest.approx(200 * scale, abs=0.2)


def test_one_plane_has_one_view_and_many_have_no_names() -> None:
    flat = {name: (x, 0.0, z) for name, (x, _, z) in CONTROL.items()}
    svg = setup_svg(TARGETS, flat)
    assert svg is not None
    assert len(marks(svg)) == len(TARGETS) + len(flat)
    crowd = setup_svg({}, {f"C{k}": (10.0 * k, 0.0, 0.0) for k in range(MAX_NAMES + 1)})
    assert crowd is not None
    assert ">C7<" not in crowd.replace("<title>C7</title>", "")
    assert setup_svg(TARGETS, {}) is None


def test_the_page_shows_the_survey_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(
        "[cameras.left]\nimage_size = [200, 150]\nfocal_px = [400.0, 400.0]\nprincipal_point_px = [100.0, 75.0]\n"
        '[targets]\ndiameter_mm = 8.0\n[control]\nfamily = "apriltag-36h11"\nsize_mm = 36.0\n'
    )
    points = "".join(f"{name},{x},{y},{z},0.1\n" for name, (x, y, z) in CONTROL.items())
    (tmp_path / "control.csv").write_text("name,x_mm,y_mm,z_mm,sd_mm\n" + points)
    row = dict.fromkeys(ENVELOPE_COLUMNS, 1.0) | {"capture": "c1", "target": "A", "flags": [], "sign": None}
    write_csv(tmp_path / "results" / "envelope.csv", ENVELOPE_COLUMNS, [row])
    path, _ = report_folder(tmp_path, title="x")
    text = path.read_text()
    assert "control targets (4)" in text
    assert ">targets (1)<" in text
