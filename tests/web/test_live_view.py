"""What the live page shows of events: the report's own numbers, and frames drawn by a process of their own."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labdaemon.orbit_size import is_doubtful, size_mm
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, write_csv
from labdaemon.report.space_view import SpaceCapture, space_object
from labdaemon.testing.served import FakeDaemon, event_document
from labdaemon.web.live_view import LiveView
from labdaemon.web.web_server import WebServer

Start, Ask = Callable[..., WebServer], Callable[..., Any]

ROW: dict[str, Any] = {f"{name}{axis}_mm": 0.0 for name in ("", "a", "b") for axis in "xyz"}
ROWS = [
    ROW | {"target": "A", "ax_mm": 3.0, "ay_mm": 1.0, "bx_mm": -0.5, "by_mm": 2.0, "flags": [], "z_mm": 500.0},
    ROW | {"target": "B", "ax_mm": 9.0, "flags": ["contradicts_group", "at_rest"]},
    ROW | {"target": "C", "ax_mm": 40.0, "flags": ["occluded"]},
    dict.fromkeys(ROW) | {"target": "D", "flags": ["not_found"]},
]


def test_an_envelope_is_shown_by_the_rules_of_the_report() -> None:
    shown = LiveView().view(event_document(7, "envelope", capture="c1", frequency_hz=5.0, targets=ROWS))
    assert shown["space"] == space_object(SpaceCapture("c1", ROWS, False, 5.0))
    for target, row in zip(shown["space"]["targets"], ROWS, strict=False):
        assert target[10] == pytest.approx(size_mm(row), abs=1e-4)
        assert target[11] == is_doubtful(row)
    assert [row[:2] for row in shown["rows"]][3] == ("D", "–")
    assert shown["about"] == "c1"
    assert json.loads(json.dumps(shown))["seq"] == 7


@pytest.mark.parametrize(
    ("about", "is_known"),
    [
        ({"capture": "c1", "light": [1.0, 0.0], "light_phase_rad": 0.0}, True),
        ({"capture": "c1", "light": [1.0, 0.0], "light_phase_rad": None}, False),
        ({"capture": "c1-2", "group": "c1", "phase_rad": 1.0, "frequency_hz": 5.0, "exposure_s": 0.25}, True),
        ({"capture": "c1-2", "group": "c1", "phase_rad": 1.0, "frequency_hz": 5.0, "exposure_s": 0.2}, False),
        ({"capture": "c1", "phase_rad": 1.0, "frequency_hz": 5.0, "exposure_s": 0.25}, False),
    ],
)
def test_the_phase_is_known_where_the_captures_show_it(about: dict[str, Any], is_known: bool) -> None:
    view = LiveView()
    view.view(event_document(1, "capture.completed", **about))
    shown = view.view(event_document(2, "envelope", capture="c1", targets=ROWS))
    assert shown["space"]["phase"] is is_known


def test_nothing_measured_has_rows_and_no_drawing() -> None:
    shown = LiveView().view(event_document(1, "envelope", capture="c", targets=ROWS[3:]))
    assert shown["space"] is None
    assert len(shown["rows"]) == 1


async def test_events_come_as_they_are_shown(serve: Start, ask: Ask, daemon: FakeDaemon) -> None:
    daemon.outbox.add("capture.completed", capture="c1", frames=[{"camera": "left", "path": "x"}])
    daemon.outbox.add("envelope", capture="c1", targets=ROWS)
    server = serve()
    found = json.loads((await ask(server, "/live/latest")).body)
    assert found["last"] == 2
    assert [one["kind"] for one in found["events"]] == ["capture.completed", "envelope"]
    assert found["events"][0]["cameras"] == ["left"]
    assert (await ask(server, "/live/events?after=x")).status == 400


async def test_the_last_frame_is_drawn_with_its_vectors(
    serve: Start, ask: Ask, daemon: FakeDaemon, tmp_path: Path
) -> None:
    folder = tmp_path / "campaigns" / "0001-x"
    frame = folder / "captures" / "c1" / "left.png"
    frame.parent.mkdir(parents=True)
    cv2.imwrite(str(frame), np.full((300, 400), 20000, np.uint16))
    row = dict.fromkeys(MEASUREMENT_COLUMNS) | {"capture": "c1", "camera": "left", "target": "A", "flags": []}
    row |= {"x_px": 200.0, "y_px": 150.0, "ax_px": 8.0, "ay_px": 1.0, "bx_px": 0.0, "by_px": 0.0}
    write_csv(folder / "results" / "measurements.csv", MEASUREMENT_COLUMNS, [row])
    write_csv(folder / "results" / "envelope.csv", ENVELOPE_COLUMNS, [])
    server = serve()
    assert (await ask(server, "/live/frame/left.jpg")).status == 404
    daemon.data = str(tmp_path)
    path = str(frame.relative_to(tmp_path))
    daemon.outbox.add("capture.completed", capture="c1", frames=[{"camera": "left", "path": path}])
    bare = await ask(server, "/live/frame/left.jpg")
    assert bare.headers["content-type"] == "image/jpeg"
    daemon.outbox.add("envelope", capture="c1", targets=ROWS)
    measured = await ask(server, "/live/frame/left.jpg")
    images = [cv2.imdecode(np.frombuffer(one.body, np.uint8), cv2.IMREAD_COLOR).astype(int) for one in (bare, measured)]
    changed = np.abs(images[1] - images[0]).max(axis=2)[40:] > 60
    assert changed.any(), "the vectors"
    assert (await ask(server, "/live/frame/right.jpg")).status == 404
    assert (await ask(server, "/live/frame/..%2f..%2frig.jpg")).status == 404


async def test_a_frame_that_cannot_be_drawn_is_said(serve: Start, ask: Ask, daemon: FakeDaemon, tmp_path: Path) -> None:
    daemon.data = str(tmp_path)
    daemon.outbox.add("capture.completed", capture="c1", frames=[{"camera": "left", "path": "campaigns/a/left.dng"}])
    answer = await ask(serve(), "/live/frame/left.jpg")
    assert answer.status == 503
    assert b"no such file" in answer.body
