"""Files on a camera before they are fetched, and what was fetched before it is believed."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.devices import CardFile
from labdaemon.capture.inspect_file import check_fetched, describe, inspect
from labdaemon.capture.rig import DeviceHandle
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DataError, DeviceRefused
from labdaemon.imaging.raw_content import Kind
from labdrivers.sim.dng import write_dng


def dng() -> bytes:
    memory = io.BytesIO()
    write_dng(memory, np.arange(64 * 48, dtype=np.uint16).reshape(48, 64), "RGGB")
    return memory.getvalue()


JPEG = b"\xff\xd8\xff\xe0" + b"\0" * 200


class PlainCamera:
    """A driver that cannot look into files."""

    name = "left"


class InspectingCamera(PlainCamera):
    """A driver that can; a test says what the card holds now."""

    def __init__(self, content: bytes | None, now: dict[str, Any] | None = None, *, reads: bool = True) -> None:
        self._content, self._now, self._reads = content, now or {}, reads

    def describe(self, file: CardFile) -> CardFile | None:
        if self._content is None:
            return None
        known = {"name": file.name, "size_bytes": len(self._content), "captured_at": file.captured_at}
        return CardFile(file.handle, format=file.format, **(known | self._now))

    def read(self, file: CardFile, offset: int, size: int) -> bytes:
        if not self._reads:
            raise DeviceRefused("sends files only whole", device=self.name)
        assert self._content is not None
        return self._content[offset : offset + size]


def file(name: str = "DSC_0001.DNG", form: int = 0) -> CardFile:
    return CardFile(7, name, 1, "20260504T101112", form)


def kind_of(camera: PlainCamera, one: CardFile) -> Kind:
    handle: Any = DeviceHandle(camera, InlineExecutor("left", lambda: 0.0))  # type: ignore[type-var]
    return SimulatedClock().run(inspect(handle, one))[0]


@pytest.mark.parametrize(("name", "form", "kind"), [
    ("DSC_0001.NEF", 0, Kind.RAW), ("DSC_0001.JPG", 0, Kind.OTHER), ("FOLDER", 0x3001, Kind.OTHER), ("X", 0, Kind.RAW),
])  # fmt: skip
def test_without_a_look_format_and_name_decide(name: str, form: int, kind: Kind) -> None:
    assert kind_of(PlainCamera(), file(name, form)) is kind


@pytest.mark.parametrize(("name", "content", "kind"), [
    ("DSC_0001.DNG", dng(), Kind.RAW),
    ("DSC_0001.JPG", dng(), Kind.RAW),
    ("DSC_0001.DNG", JPEG, Kind.OTHER),
    ("DSC_0001.DNG", dng()[:-500], Kind.UNFINISHED),
    ("DSC_0001.DNG", b"", Kind.UNFINISHED),
    ("DSC_0001.NEF", b"a maker's own kind of file, unknown", Kind.RAW),
    ("DSC_0001.DAT", b"a maker's own kind of file, unknown", Kind.OTHER),
    ("DUST.NDF", dng(), Kind.OTHER),
    ("DSC_0001.DNG", None, Kind.OTHER),
])  # fmt: skip
def test_content_decides_before_the_name(name: str, content: bytes | None, kind: Kind) -> None:
    assert kind_of(InspectingCamera(content), file(name)) is kind


def test_a_handle_that_was_used_again_is_another_file() -> None:
    assert kind_of(InspectingCamera(dng(), {"name": "DSC_0002.DNG"}), file()) is Kind.OTHER
    assert kind_of(InspectingCamera(dng(), {"captured_at": "20260504T101113"}), file()) is Kind.OTHER


def test_a_camera_that_sends_files_only_whole_is_believed_by_name() -> None:
    assert kind_of(InspectingCamera(JPEG, reads=False), file()) is Kind.RAW


def test_a_folder_is_not_even_asked_for() -> None:
    assert kind_of(InspectingCamera(None, {"name": "never asked"}), file("DCIM", 0x3001)) is Kind.OTHER


@pytest.mark.parametrize("content", [dng(), None])
def test_a_file_is_described_anew(content: bytes | None) -> None:
    handle: Any = DeviceHandle(InspectingCamera(content), InlineExecutor("left", lambda: 0.0))  # type: ignore[type-var]
    now = SimulatedClock().run(describe(handle, file()))
    assert (now.size_bytes if now is not None else None) == (len(content) if content is not None else None)
    plain: Any = DeviceHandle(PlainCamera(), InlineExecutor("left", lambda: 0.0))  # type: ignore[type-var]
    assert SimulatedClock().run(describe(plain, file())) == file()


@pytest.mark.parametrize(("content", "error", "words"), [
    (dng()[:-500], DataError, "fetch it again"), (JPEG, DeviceRefused, "set its image quality to RAW"),
])  # fmt: skip
def test_what_was_fetched_is_looked_at(tmp_path: Path, content: bytes, error: type[Exception], words: str) -> None:
    path = tmp_path / "left.dng"
    path.write_bytes(content)
    camera: Any = InspectingCamera(content)
    with pytest.raises(error, match=words):
        check_fetched(camera, file(), path)
    path.write_bytes(dng())
    check_fetched(camera, file(), path)
    plain: Any = PlainCamera()
    path.write_bytes(content)
    check_fetched(plain, file(), path)
