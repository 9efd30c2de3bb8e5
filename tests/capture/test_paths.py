"""Where a capture's files lie, and what stands next to them."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.capture import paths
from labdaemon.capture.devices import CardFile
from labdaemon.journal.records import NO_STEP, UNKNOWN_EXPOSURE_S, CaptureRecord

DATA = Path("/data")
CAPTURE = CaptureRecord(
    "0001-night", "s-01", 3, 0, "s", False, "s1", None, "intended", 5.0, 1.0, 0.5, None, {}, None, None,
    ("left", "right"), {}, None,
)  # fmt: skip


def file(name: str) -> CardFile:
    return CardFile(1, name, 100, "2026-05-04T10:00:00")


def test_captures_and_sharp_sets_have_folders_of_their_own() -> None:
    assert paths.capture_folder(DATA, CAPTURE) == DATA / "campaigns/0001-night/captures/s-01"
    sharp = replace(CAPTURE, is_sharp=True)
    assert paths.capture_folder(DATA, sharp) == DATA / "campaigns/0001-night/sharp/s1"
    assert paths.capture_folder(DATA, replace(sharp, sharp=None)) == DATA / "campaigns/0001-night/sharp"


@pytest.mark.parametrize(("shot", "name", "expected"), [
    (0, "DSC_0001.NEF", "left.nef"), (1, "DSC_0002.NEF", "left-2.nef"), (2, "x.CR3", "left-3.cr3"),
    (0, "noending", "left.raw"), (0, "a.b/c", "left.raw"), (0, "a.toolongx", "left.raw"), (0, "a.ü", "left.raw"),
])  # fmt: skip
def test_sharp_frames_are_numbered_and_keep_their_ending(shot: int, name: str, expected: str) -> None:
    sharp = replace(CAPTURE, is_sharp=True, sharp=None, shot=shot)
    assert paths.frame_path(DATA, sharp, "left", file(name)).name == expected


def test_a_blurred_frame_is_named_by_its_camera_alone() -> None:
    assert paths.frame_path(DATA, replace(CAPTURE, shot=4), "left", file("D.NEF")).name == "left.nef"


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.text(max_size=200))
def test_a_cards_name_never_leads_out_of_its_folder(name: str) -> None:
    for campaign, capture in (("0001-night", "s-01"), ("", "")):
        path = paths.set_aside_path(DATA, campaign, capture, "left", name)
        root = DATA / "campaigns/0001-night" if campaign else DATA
        assert path.parent == root / "set_aside" / (capture or "unexpected")
        assert len(path.name) <= len("left-") + paths.LONGEST_NAME
        assert path.name.isascii()


def test_the_note_states_what_is_known_and_nothing_else() -> None:
    note = tomllib.loads(paths.capture_toml(CAPTURE))
    assert note == {
        "frequency_hz": 5.0, "exposure_s": 0.5, "sharp": "s1", "excitation_amplitude_mm": 1.0, "step": 3, "label": "s",
    }  # fmt: skip
    unknown = replace(
        CAPTURE, step=NO_STEP, sharp=None, frequency_hz=None, amplitude_mm=None, exposure_s=UNKNOWN_EXPOSURE_S, label=""
    )
    assert tomllib.loads(paths.capture_toml(unknown)) == {"label": ""}


@settings(max_examples=30, deadline=None, derandomize=True)
@given(phase=st.floats(-50, 50), hz=st.floats(0.5, 50), lags=st.lists(st.floats(0, 0.2), min_size=1, max_size=4))
def test_each_bodys_phase_is_its_lag_behind_the_mean(phase: float, hz: float, lags: list[float]) -> None:
    """The mean of the bodies' phases is the capture's, and two bodies differ by what the table did between them."""
    opening = {f"c{number}": lag for number, lag in enumerate(lags)}
    note = tomllib.loads(paths.capture_toml(replace(CAPTURE, frequency_hz=hz, phase_rad=phase, opening_s=opening)))
    assert 0.0 <= note["phase_rad"] < 2 * math.pi
    assert note["sd_phase_rad"] == 0.0
    for name, lag in opening.items():
        own = note["cameras"][name]["phase_rad"]
        assert 0.0 <= own < 2 * math.pi
        expected = phase + 2 * math.pi * hz * (lag - sum(lags) / len(lags))
        assert math.cos(own - expected) == pytest.approx(1.0, abs=1e-6)


def test_a_stated_phase_stays_when_the_opening_was_seen() -> None:
    seen = paths.with_opening(CAPTURE, "t", {"left": 0.1}, 2.0, 0.05)
    assert (seen.state, seen.opened_at, seen.phase_rad, seen.sd_phase_rad) == ("fired", "t", 2.0, 0.05)
    stated = paths.with_opening(replace(CAPTURE, phase_rad=1.0, sd_phase_rad=None), "t", {}, 2.0, 0.05)
    assert (stated.phase_rad, stated.sd_phase_rad) == (1.0, 0.0)
    unseen = paths.with_opening(CAPTURE, "t", {}, None, 0.05)
    assert (unseen.phase_rad, unseen.sd_phase_rad) == (None, None)
