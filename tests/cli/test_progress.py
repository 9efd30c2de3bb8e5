"""What people read of events: amplitudes of orbits, durations, odd payloads."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.cli.progress import Progress, duration, event_line, status_lines
from labdaemon.orbit_size import size_mm

AXIS = st.floats(-10, 10)


@settings(max_examples=50, deadline=None)
@given(a=st.tuples(AXIS, AXIS, AXIS), b=st.tuples(AXIS, AXIS, AXIS))
def test_amplitude_is_the_farthest_point_of_the_sampled_orbit(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    phase = np.linspace(0, 2 * math.pi, 4001)[:, None]
    farthest = np.linalg.norm(np.sin(phase) * np.array(a) + np.cos(phase) * np.array(b), axis=1).max()
    row = {f"{name}{axis}_mm": value for name, v in (("a", a), ("b", b)) for axis, value in zip("xyz", v, strict=True)}
    assert size_mm(row) == pytest.approx(farthest, rel=1e-5, abs=1e-6)


def test_one_camera_has_no_normal_component() -> None:
    assert size_mm({"ax_mm": 3.0, "ay_mm": 0.0, "az_mm": 4.0, "bx_mm": None}) == 5.0
    assert size_mm({"ax_mm": None}) is None


@pytest.mark.parametrize(
    ("seconds", "text"), [(None, "–"), (0, "0:00"), (59.6, "1:00"), (3599, "59:59"), (3723, "1:02:03"), (-5, "0:00")]
)
def test_durations(seconds: float | None, text: str) -> None:
    assert duration(seconds) == text


def test_a_bare_status_is_enough() -> None:
    assert status_lines({"state": "idle"}) == ["state      idle"]
    assert status_lines({}) == ["state      unknown"]


@pytest.mark.parametrize(
    "kind", ["campaign.failed", "step.skipped", "fault", "envelope", "capture.completed", "step.started", "later.kind"]
)
def test_events_with_nothing_in_them_still_print(kind: str) -> None:
    assert event_line({"kind": kind, "data": {}, "campaign": None, "seq": 1})


def test_plain_output_leaves_the_heartbeat_out(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress() as progress:
        progress.show({"kind": "status", "at": "2026-05-04T10:11:12Z", "campaign": None, "data": {"state": "idle"}})
        progress.show(
            {"kind": "campaign.aborted", "at": "2026-05-04T10:11:12Z", "campaign": "c", "data": {"reason": "asked to"}}
        )
    assert capsys.readouterr().out == "10:11:12 aborted    campaign c: asked to\n"


def test_on_a_terminal_one_line_lives_below_what_happened(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "100")
    status = {"state": "running", "captures": 3, "captures_total": 6, "faults": 2, "left_s": 75, "doing": "settling"}
    status |= {"frequency_hz": 12.0, "amplitude_mm": 0.5, "largest_mm": 6.1}
    with Progress() as progress:
        progress.show({"kind": "status", "at": "2026-05-04T10:11:12Z", "campaign": "c", "data": status})
        progress.show({"kind": "campaign.paused", "at": "2026-05-04T10:11:12Z", "campaign": "c", "data": {}})
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().out)
    assert "10:11:12 paused     campaign c\n" in shown
    assert "3/6 · 2 faults · 12 Hz, 0.5 mm · settling · 1:15 left · largest 6.100 mm" in shown


class Seconds:
    """A clock under the test's hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


HEARTBEAT = {"kind": "status", "at": "2026-05-04T10:11:12Z", "campaign": None, "data": {"state": "running"}}


def test_a_silent_daemon_is_reported_once_and_so_is_its_return(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Seconds()
    with Progress(monotonic=clock) as progress:
        progress.show(HEARTBEAT)
        for _ in range(6):
            clock.now_s += 1.0
            progress.check_silence()
        progress.show(HEARTBEAT)
    silent, note_heartbeat = capsys.readouterr().out.splitlines()
    assert "SILENT     no heartbeat for 3 s" in silent
    assert "HEARD      the daemon again, after 6 s" in note_heartbeat


def test_the_live_line_of_a_silent_daemon_shows_its_age(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "100")
    clock = Seconds()
    with Progress(monotonic=clock) as progress:
        progress.show(HEARTBEAT)
        clock.now_s += 75.0
        progress.check_silence()
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().out)
    assert "SILENT for 1:15, last known: running" in shown


def test_a_doubtful_target_does_not_lead() -> None:
    rows = [{"target": "T1", "ax_mm": 0.411, "ay_mm": 0.0, "az_mm": 0.0, "flags": []}]
    rows.append({"target": "R12", "ax_mm": 0.0, "ay_mm": 0.977, "az_mm": 0.0, "flags": ["ambiguous"]})
    line = event_line({"kind": "envelope", "data": {"capture": "c", "targets": rows}})
    assert line == "envelope   c: 2 of 2 targets, 1 flagged, largest 0.411 mm at T1; 1 doubtful"
    status = {"state": "idle", "largest_mm": 0.411, "largest_target": "T1", "doubtful": 1, "captures_manual": 2}
    assert status_lines(status)[1:] == [
        "manual     2 captures outside the plan", "largest    0.411 mm at T1; 1 doubtful",
    ]  # fmt: skip


def test_what_a_starting_daemon_waits_for_is_named_once() -> None:
    status = {
        "state": "starting",
        "waiting_for": {"left": "left: no camera with serial number 7 on USB", "data folder": "/data: is not there"},
    }
    lines = status_lines(status)
    assert "waits for  left: no camera with serial number 7 on USB" in lines
    assert "waits for  data folder: /data: is not there" in lines


@pytest.mark.parametrize(
    ("table", "expected"),
    [("rest", "table      rest"), ("unconfirmed", "table      unconfirmed; USE THE EMERGENCY STOP IF IT MOVES")],
)
def test_a_table_that_no_device_confirms_names_the_emergency_stop(table: str, expected: str) -> None:
    assert expected in status_lines({"state": "idle", "table": table})
