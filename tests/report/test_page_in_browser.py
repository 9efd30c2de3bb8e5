"""The page of results as a browser shows it: on a phone, in the dark, on paper, and in the view that turns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labdaemon.report.frequency_chart import MAX_LINES
from labdaemon.report.html import CaptureSection, page
from labdaemon.testing.browser import Browser

pytestmark = pytest.mark.slow

Open = Callable[..., Browser]
BLANK = """(() => {
  const canvas = document.querySelector("canvas"), data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let sum = 0;
  for (let k = 0; k < data.length; k += 4) sum = (sum * 31 + data[k] + data[k + 1] + data[k + 3]) % 1000003;
  return sum;
})()"""  # noqa: E501
"""A number that changes with what is drawn; 0 for an empty canvas."""
WIDE = "document.documentElement.scrollWidth - innerWidth"


def row(target: str, z: float, ax: float, *flags: str) -> dict[str, Any]:
    numbers = {f"{name}{axis}_mm": 0.01 for name in ("", "a", "b", "sd_a", "sd_") for axis in "xyz"}
    return numbers | {"target": target, "z_mm": z, "x_mm": z / 5, "ax_mm": ax, "flags": [*flags]}


@pytest.fixture
def browser(tmp_path: Path, open_browser: Open) -> Browser:
    """A page of three captures with long names, flags and a chart, open in a browser."""
    captures = [
        CaptureSection(
            f"0000{k}-a-capture-with-a-long-name-{f:g}hz-01",
            [row(f"T{n:02d}", 60.0 * n, 1.0 + k + n / 5, *(["poor_fit"] if n == 3 else [])) for n in range(12)],
            {"excitation": f"{f:g} Hz", "table": "1 mm", "opened": "2026-05-04T10:11:12.123456Z"},
            frequency_hz=f,
            table_mm=1.0,
            is_phase_known=k == 2,
        )
        for k, f in enumerate((5.0, 8.0, 12.0))
    ]
    path = tmp_path / "index.html"
    path.write_text(page("A campaign", "of a test", captures), encoding="utf-8")
    opened = open_browser(f"file://{path}")
    opened.wait_for("document.readyState === 'complete' && !!document.querySelector('#space option')")
    return opened


def resize(browser: Browser, width: int, *, is_phone: bool) -> None:
    browser.call("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=is_phone)
    browser.wait_for(f"innerWidth === {width} || {WIDE} > 0")


def test_no_width_scrolls_sideways_and_charts_stay_readable(browser: Browser) -> None:
    for width, is_phone in ((360, True), (390, True), (768, True), (1400, False)):
        resize(browser, width, is_phone=is_phone)
        browser.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert browser.evaluate(WIDE) <= 0, width
        heights = browser.evaluate(
            "[...document.querySelectorAll('svg text')].map((t) => t.getBoundingClientRect().height)"
        )
        assert min(heights) >= 9, "letters of 9 pixels and more"


def test_the_view_turns_by_keys_and_shows_another_capture(browser: Browser) -> None:
    browser.evaluate(
        "document.querySelector('.play').textContent === 'Pause' && document.querySelector('.play').click()"
    )
    before = browser.evaluate(BLANK)
    assert before != 0
    press = "document.querySelector('canvas').dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}))"
    browser.evaluate(press)
    turned = browser.evaluate(BLANK)
    assert turned != before
    choose = (
        "(() => { const pick = document.querySelector('#space select'); pick.value = 0; "
        "pick.dispatchEvent(new Event('change')); })()"
    )
    browser.evaluate(choose)
    assert browser.evaluate(BLANK) != turned
    assert "not known" in browser.evaluate("document.querySelector('.note').textContent")


def test_light_dark_and_paper(browser: Browser) -> None:
    ground = "getComputedStyle(document.body).backgroundColor"
    seen = {}
    for scheme in ("light", "dark"):
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        seen[scheme] = browser.evaluate(ground)
    assert seen["light"] == "rgb(255, 255, 255)"
    assert seen["dark"] != seen["light"]
    browser.call("Emulation.setEmulatedMedia", media="print", features=[])
    assert browser.evaluate("getComputedStyle(document.querySelector('#space')).display") == "none"
    assert browser.evaluate("document.querySelectorAll('figure svg').length") == 4, (
        "the views of three captures, and the chart"
    )
    assert browser.evaluate("document.querySelectorAll('.chart polyline').length") == MAX_LINES


def test_nothing_is_fetched(browser: Browser) -> None:
    assert browser.evaluate("performance.getEntriesByType('resource').length") == 0
