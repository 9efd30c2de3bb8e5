"""Image minus gauge: each capture at its place, mean and 95 % as in the table."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from labdaemon.report.gauge_chart import BOTTOM, TOP, gauge_svg
from labdaemon.report.gauge_comparison import GaugeComparison, summarise
from labdaemon.report.html import CaptureSection, PageSupplement, page


def reading(number: int, amplitude: float, difference: float | None, gauge: str = "laser<1>") -> GaugeComparison:
    image = None if difference is None else amplitude + difference
    return GaugeComparison(f"c{number}", gauge, "response", amplitude, 0.003, "", image, 0.004)


READINGS = [reading(k, 1.0 + k, 0.02 * (k - 2)) for k in range(5)]


def drawn(svg: str, tag: str) -> list[ElementTree.Element]:
    return [one for one in ElementTree.fromstring(svg).iter() if one.tag == tag]


def test_points_lie_where_their_difference_says_and_bars_are_its_sd() -> None:
    svg = gauge_svg(READINGS)
    assert svg is not None
    y = [float(one.get("cy", 0)) for one in drawn(svg, "circle")]
    middle = (TOP + BOTTOM) / 2
    assert y[2] == pytest.approx(middle, abs=0.1)
    assert y[0] - middle == pytest.approx(2 * (y[1] - middle), abs=0.2)
    assert y[4] < middle < y[0], "too large is above"
    per_mm = (y[1] - y[2]) / 0.02
    bar = re.search(r"M[\d.]+ ([\d.]+)V([\d.]+)", svg)
    assert bar is not None
    assert abs(float(bar[1]) - float(bar[2])) / 2 / per_mm == pytest.approx(0.005, rel=0.05)


def test_the_band_is_what_95_percent_keep() -> None:
    svg = gauge_svg(READINGS)
    assert svg is not None
    (band,) = drawn(svg, "rect")
    y = [float(one.get("cy", 0)) for one in drawn(svg, "circle")]
    assert summarise(READINGS)[0].p95_mm == pytest.approx(0.04)
    assert float(band.get("y", 0)) == pytest.approx(y[4], abs=0.2)
    assert float(band.get("height", 0)) == pytest.approx(y[0] - y[4], abs=0.3)


def test_each_gauge_has_its_own_look_and_none_compared_has_no_chart() -> None:
    svg = gauge_svg([*READINGS, *(reading(k, 2.0, 0.01, "other") for k in range(3))])
    assert svg is not None
    assert len({one.get("stroke") for one in drawn(svg, "g")}) == 2
    assert gauge_svg([reading(1, 1.0, None)]) is None


def test_the_page_shows_it_next_to_the_table() -> None:
    text = page("x", "", [CaptureSection("c1", [])], PageSupplement(gauges=READINGS))
    assert "Image minus gauge over amplitude" in text
    assert "Image minus gauge" not in page(
        "x", "", [CaptureSection("c1", [])], PageSupplement(gauges=[reading(1, 1, None)])
    )
