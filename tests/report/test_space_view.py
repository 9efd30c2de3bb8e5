"""Data of the view in space, and the script that draws it, in a browser where there is one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labdaemon.report.html import CaptureSection, page
from labdaemon.report.space_view import SpaceCapture, space_json


def row(target: str, z: float, ax: float | None, flags: tuple[str, ...] = ()) -> dict[str, object]:
    vector = {f"{name}{axis}_mm": 0.0 for name in ("", "a", "b", "sd_", "sd_a", "sd_b") for axis in "xyz"}
    return {**vector, "target": target, "z_mm": z, "ax_mm": ax, "flags": list(flags)}


def test_a_target_is_its_name_place_motion_and_amplitude():
    (capture,) = json.loads(space_json([SpaceCapture("c1", [row("A", 10.0, 2.00004)], True, 5.0)]))
    assert capture["targets"] == [["A", 0.0, 0.0, 10.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0]]
    assert (capture["name"], capture["frequency"], capture["phase"]) == ("c1", 5.0, True)


def test_doubtful_targets_are_marked_and_do_not_choose_the_magnification():
    rows = [row("A", 0.0, 1.0), row("B", 500.0, 1.0), row("C", 250.0, 80.0, ("ambiguous",))]
    (capture,) = json.loads(space_json([SpaceCapture("c", rows)]))
    assert [target[-1] for target in capture["targets"]] == [0, 0, 1]
    assert capture["magnify"] == 50.0


def test_what_was_not_measured_is_left_out():
    assert space_json([SpaceCapture("c", [row("A", 0.0, None)])]) == "[]"
    assert space_json([]) == "[]"


@pytest.mark.parametrize("name", ["</script><script>alert(1)</script>", "<!--", "a\u2028b"])
def test_a_name_cannot_end_the_element(name: str):
    text = space_json([SpaceCapture(name, [row(name, 0.0, 1.0)])])
    assert "<" not in text
    assert json.loads(text)[0]["name"] == name


@pytest.mark.slow
@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_draws_it_and_says_what_is_shown(tmp_path: Path, open_browser: Callable[..., Any], width: int):
    rows = [row("A", 0.0, 1.0), row("B", 500.0, 2.0)]
    small = [row("A", 0.0, 0.1), row("B", 500.0, 0.2)]
    sections = [CaptureSection("small", small, frequency_hz=4.0), CaptureSection("large", rows, is_phase_known=True)]
    path = tmp_path / "index.html"
    path.write_text(page("t", "", sections), encoding="utf-8")
    browser = open_browser(path.as_uri(), (width, 800))
    browser.wait_for("document.readyState === 'complete' && !document.querySelector('#space').hidden")
    assert browser.evaluate("document.querySelector('#space select').innerText").split("\n")[0] == "small · 4 Hz"
    note = browser.evaluate("document.querySelector('.note').textContent")
    assert note == "Motion × 20, largest 2.00 mm. The phase between targets is measured."
    drawn = "(() => { const c = document.querySelector('canvas'); return c.getContext('2d').getImageData(0, 0, c.width,"
    drawn += " c.height).data.some((one) => one > 0); })()"
    assert browser.evaluate(drawn)
    browser.evaluate("document.querySelector('[data-tilt=\"1.5708\"]').click()")  # the plan
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")  # no sideways scroll on a phone
