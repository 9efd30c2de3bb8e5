"""Flags with remedies, amplitude over frequency, gauges next to the photographs, uncertainty in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from labdaemon.flags import Flag
from labdaemon.report.frequency_chart import MAX_LINES, ChartPoint, frequency_svg
from labdaemon.report.gauge_comparison import read_gauges, summarise
from labdaemon.report.html import CaptureSection
from labdaemon.report.page_tables import MAX_FLAGGED, amplitude_chart, flagged_table, gauge_tables
from labdaemon.report.provenance import provenance
from labdaemon.report.remedies import REMEDIES, remedy
from labdaemon.report.uncertainty_budget import budget


def row(target: str, ax: float | None, *flags: str, sd: float = 0.01) -> dict[str, Any]:
    values: dict[str, Any] = {f"{name}{axis}_mm": 0.0 for name in ("", "a", "b") for axis in "xyz"}
    values |= {f"sd_{name}{axis}_mm": sd for name in ("", "a", "b") for axis in "xyz"}
    if ax is None:
        values = dict.fromkeys(values)
    return {**values, "target": target, "ax_mm": ax, "flags": list(flags)}


def test_every_flag_has_a_remedy():
    assert set(REMEDIES) == set(Flag)
    assert remedy("occluded").startswith("Something covers")
    assert remedy("flag_of_tomorrow") == ""


def test_flagged_targets_are_listed_with_what_to_do_and_rest_is_no_fault():
    captures = [CaptureSection("c1", [row("A", 1.0), row("B", None, "occluded"), row("C", 0.01, "at_rest")])]
    table = flagged_table(captures)
    assert table is not None
    assert [line[:4] for line in table.lines] == [("c1", "B", "–", "occluded")]
    assert flagged_table([CaptureSection("c1", [row("A", 1.0)])]) is None


def test_a_night_of_flags_is_cut_and_counted():
    captures = [CaptureSection("c", [row(f"T{k}", None, "not_found") for k in range(MAX_FLAGGED + 7)])]
    table = flagged_table(captures)
    assert table is not None
    assert len(table.lines) == MAX_FLAGGED + 1
    assert table.lines[-1][1] == "7 more"


def test_amplitude_is_per_table_amplitude_only_where_all_captures_have_it():
    known = [CaptureSection(f"c{f}", [row("A", f)], frequency_hz=f, table_mm=0.5) for f in (4.0, 5.0)]
    chart = amplitude_chart(known)
    assert chart is not None
    assert "amplitude per amplitude of the table" in chart
    mixed = [*known, CaptureSection("c6", [row("A", 6.0)], frequency_hz=6.0)]
    chart = amplitude_chart(mixed)
    assert chart is not None
    assert "amplitude mm" in chart
    assert amplitude_chart(known[:1]) is None
    assert amplitude_chart([CaptureSection("c", [row("A", 1.0)])]) is None


def test_the_chart_is_valid_shows_the_largest_and_escapes_names():
    points = {
        f"<T{k}>": [ChartPoint(5.0, k + 1.0, 0.1), ChartPoint(4.0, 0.5, float("nan"))] for k in range(MAX_LINES + 5)
    }
    svg = frequency_svg(points, is_ratio=False)
    assert svg is not None
    lines = [one for one in ElementTree.fromstring(svg).iter() if one.tag.endswith("polyline")]
    titles = [line.findtext("title") for line in lines]
    assert len(titles) == MAX_LINES
    assert titles[0] == f"<T{MAX_LINES + 4}>"
    assert "<T0>" not in titles


GAUGES = "capture,gauge,role,amplitude_mm,sd_amplitude_mm,reason\n"


def test_a_gauge_is_compared_with_the_targets_that_it_stands_for(tmp_path: Path):
    path = tmp_path / "gauges.csv"
    path.write_text(
        f"{GAUGES}c1,laser,response,1.00,0.002,\nc2,laser,response,2.00,0.002,\nc1,acc,table,,,no answer\n",
        encoding="utf-8",
    )
    envelopes = {
        "c1": [row("TOP1", 1.02), row("TOP2", 1.04), row("LOW", 9.0), row("TOP3", 5.0, "ambiguous")],
        "c2": [row("TOP1", 1.97)],
    }
    readings = read_gauges(path, envelopes, {"laser": ("TOP*",)})
    assert readings[0].image_mm == pytest.approx(1.03)
    assert readings[0].image_sd_mm == pytest.approx(0.01 / 2**0.5)
    assert readings[1].difference_mm == pytest.approx(-0.03)
    assert (readings[2].amplitude_mm, readings[2].reason, readings[2].difference_mm) == (None, "no answer", None)
    (summary,) = summarise(readings)
    assert (summary.gauge, summary.count) == ("laser", 2)
    assert summary.mean_mm == pytest.approx(0.0, abs=1e-12)
    assert summary.p95_mm == pytest.approx(0.03)
    tables = gauge_tables(readings)
    assert tables is not None
    assert tables[1] is not None
    assert tables[1].lines[0][:2] == ("laser", "2")


def test_gauges_that_stand_for_nothing_are_shown_alone(tmp_path: Path):
    path = tmp_path / "gauges.csv"
    path.write_text(f"{GAUGES}c1,acc,table,1.0,0.002,\n", encoding="utf-8")
    tables = gauge_tables(read_gauges(path, {"c1": [row("A", 1.0)]}, {}))
    assert tables is not None
    assert tables[1] is None
    assert read_gauges(tmp_path / "none.csv", {}, {}) == []
    assert gauge_tables([]) is None


def test_the_uncertainty_is_put_into_words():
    rows = [row("A", 1.0, sd=0.02), row("B", 2.0, sd=0.02), row("C", 0.01, "at_rest"), row("D", None, "occluded")]
    text = " ".join(budget(rows))
    assert "0.0200 mm in the median" in text
    assert "2 readings without a flag" in text
    assert "1 readings are below the detection limit" in text
    assert "1 occluded" in text
    assert "One camera" not in text
    flat = [one | {"sd_y_mm": None} for one in rows]
    assert "One camera" in " ".join(budget(flat))
    assert budget([]) == []
    still = {name: 0.0 for name in rows[0] if name[0] in "ab" and name.endswith("_mm")}
    assert "Amplitude" not in " ".join(budget([row | still for row in rows])), "no amplitude to compare an sd with"


def test_the_origin_names_calibration_and_the_digest_of_every_photograph(tmp_path: Path):
    (tmp_path / "sharp").mkdir()
    (tmp_path / "sharp" / "left.dng").write_bytes(b"raw")
    (tmp_path / "sharp" / ".left.dng.part").write_bytes(b"no")
    (tmp_path / "rig.toml").write_text("[cameras.left]\nfocal_px = [3937.7, 3937.7]\n", encoding="utf-8")
    about = provenance(tmp_path)
    assert dict(about.facts)["camera left"] == "focal length px 3937.7, 3937.7"
    assert [name for name, _ in about.frames] == ["sharp/left.dng"]
    assert len(about.frames[0][1]) == 64
    (tmp_path / "rig.toml").write_text("[cameras", encoding="utf-8")
    assert "rig.toml" in dict(provenance(tmp_path).facts)  # its digest, although it cannot be read
