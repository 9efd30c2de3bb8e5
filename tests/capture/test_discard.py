"""A stored capture that is given up: its frames are set aside, never lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.discard import discard_stored
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import SimulatedClock
from labdaemon.events import CaptureData
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import CaptureRecord, FrameRecord

CAPTURE = CaptureRecord(
    "c", "a-01", 3, 0, "a", False, "s1", None, "intended", 5.0, 1.0, 0.5, None, {}, None, None, ("left", "right"), {},
    None,
)  # fmt: skip


class Lab:
    """A journal and a stored capture of two frames."""

    def __init__(self, data: Path) -> None:
        self.data, self.clock = data, SimulatedClock()
        self.journal = Journal(data, self.clock, synchronous="OFF")
        self.recorder = Recorder(self.journal, InlineExecutor("journal", lambda: 0.0))

    def stored(self, capture: CaptureRecord, folder: str) -> CaptureRecord:
        transitions.intend_capture(self.journal, capture)
        place = self.data / "campaigns" / "c" / folder
        place.mkdir(parents=True)
        for camera in ("left", "right"):
            path = place / f"{camera}.dng"
            path.write_bytes(camera.encode())
            local = str(path.relative_to(self.data))
            record = FrameRecord("c", capture.name, camera, local, f"{camera}/1.DNG", "t", 4, "ab", "stored")
            transitions.store_frame(self.journal, record)
        (place / "capture.toml").write_text("frequency_hz = 5.0\n")
        transitions.complete_capture(self.journal, "c", CaptureData(capture=capture.name))
        return capture

    def discard(self, capture: CaptureRecord) -> None:
        self.clock.run(discard_stored(self.recorder, self.data, capture, "wrong size"))


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    lab = Lab(tmp_path)
    yield lab
    lab.journal.close()


def test_frames_are_set_aside_and_the_journal_says_why(lab: Lab) -> None:
    lab.discard(lab.stored(CAPTURE, "captures/a-01"))
    [found] = records.captures(lab.journal, "c", "discarded")
    assert found.reason == "wrong size"
    frames = records.frames(lab.journal, "c", "a-01")
    assert [frame.state for frame in frames] == ["set_aside", "set_aside"]
    assert [(lab.data / frame.path).read_bytes() for frame in frames] == [b"left", b"right"]
    assert all("set_aside" in frame.path and ".." not in frame.path for frame in frames)
    assert not (lab.data / "campaigns/c/captures/a-01").exists(), "process would stumble over it"


def test_what_a_person_has_put_there_stays(lab: Lab) -> None:
    capture = lab.stored(CAPTURE, "captures/a-01")
    note = lab.data / "campaigns/c/captures/a-01/note.txt"
    note.write_text("looks wrong")
    lab.discard(capture)
    assert note.read_text() == "looks wrong"


def test_a_frame_that_a_crash_has_moved_already_is_no_error(lab: Lab) -> None:
    capture = lab.stored(CAPTURE, "captures/a-01")
    (lab.data / "campaigns/c/captures/a-01/left.dng").unlink()
    lab.discard(capture)
    assert len(records.captures(lab.journal, "c", "discarded")) == 1


def test_a_sharp_set_keeps_its_folder(lab: Lab) -> None:
    lab.discard(lab.stored(replace(CAPTURE, name="s-01", is_sharp=True), "sharp/s1"))
    assert (lab.data / "campaigns/c/sharp/s1").is_dir()
