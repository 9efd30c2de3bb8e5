"""Directories that loop, point away or end early are refused at once; sound ones are read in every form of TIFF."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from labdaemon.errors import DataError
from labdaemon.imaging.raw import read_frame
from labdaemon.imaging.tiff_directories import read_directories

Writer = Callable[..., Path]
Entry = tuple[int, int, int, int]


def directory(order: str, entries: list[Entry], following: int) -> bytes:
    body = b"".join(struct.pack(order + "HHII", *entry) for entry in entries)
    return struct.pack(order + "H", len(entries)) + body + struct.pack(order + "I", following)


def tiff(order: str, magic: bytes, *parts: bytes) -> bytes:
    return magic + struct.pack(order + "I", 8) + b"".join(parts)


LOOPS = {
    "first to itself": lambda o, m: tiff(o, m, directory(o, [(256, 4, 1, 9)], 8)),
    "without entries": lambda o, m: tiff(o, m, directory(o, [], 8)),
    "second to first": lambda o, m: tiff(o, m, directory(o, [], 14), directory(o, [], 8)),
    "sub to itself": lambda o, m: tiff(o, m, directory(o, [(330, 4, 1, 26)], 0), directory(o, [(330, 4, 1, 26)], 0)),
    "sub to parent": lambda o, m: tiff(o, m, directory(o, [(330, 4, 1, 26)], 0), directory(o, [], 8)),
    "sub of sub to parent": lambda o, m: tiff(
        o,
        m,
        directory(o, [(330, 13, 1, 26)], 0),
        directory(o, [(330, 13, 1, 44)], 0),
        directory(o, [(330, 4, 1, 8)], 0),
    ),
}
FORMS = [("<", b"II*\0"), (">", b"MM\0*"), ("<", b"IIU\0"), ("<", b"IIRO"), (">", b"MMOR")]


@pytest.mark.timeout(20)
@pytest.mark.parametrize("form", FORMS, ids=lambda form: repr(form[1]))
@pytest.mark.parametrize("loop", LOOPS)
def test_loops_are_refused(
    tmp_path: Path, loop: str, form: tuple[str, bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "loop.dng"
    path.write_bytes(LOOPS[loop](*form))
    with pytest.raises(DataError, match=r"loop\.dng: its directories lead back to themselves"):
        read_frame(path)
    assert capfd.readouterr().err == ""


def places(data: bytes) -> tuple[int, dict[int, int]]:
    """End of the first directory's entries, and where each entry lies."""
    (first,) = struct.unpack("<I", data[4:8])
    (count,) = struct.unpack("<H", data[first : first + 2])
    entries = range(first + 2, first + 2 + 12 * count, 12)
    return first + 2 + 12 * count, {struct.unpack("<H", data[at : at + 2])[0]: at for at in entries}


FAR = struct.pack("<I", 0x40000000)


def changed(kind: str, data: bytes) -> bytes:
    end, at = places(data)
    new = bytearray(data)

    def put(place: int, value: bytes) -> None:
        new[place : place + len(value)] = value

    match kind:
        case "loops in a sound file":
            put(end, data[4:8])
        case "cut in the directory":
            return data[: places(data)[0] - 40]
        case "cut behind the directory":
            return data[: end + 4]
        case "next behind the end":
            put(end, FAR)
        case "values behind the end":
            put(at[50721] + 8, FAR)
            put(at[50708] + 8, FAR)
        case "sub-directory behind the end":
            put(at[50778], struct.pack("<HHI", 330, 4, 1) + FAR)
        case "sub-directory loops":
            put(at[50778], struct.pack("<HHI", 330, 4, 1) + data[4:8])
        case "strip behind the end":
            put(at[273] + 8, FAR)
        case "strip of 22 bytes":
            put(at[279] + 2, struct.pack("<HII", 4, 1, 22))
        case "lossless JPEG of 22 bytes":
            put(at[279] + 2, struct.pack("<HII", 4, 1, 22))
            put(at[259] + 8, struct.pack("<H", 7))
        case "strip without place":
            put(at[273] + 8, bytes(4))
        case _:
            raise AssertionError(kind)
    return bytes(new)


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("loops in a sound file", "lead back to themselves"),
        ("cut in the directory", "truncated"),
        ("cut behind the directory", "truncated"),
        ("next behind the end", "truncated"),
        ("values behind the end", "truncated"),
        ("sub-directory behind the end", "truncated"),
        ("sub-directory loops", "lead back to themselves"),
        ("strip behind the end", "truncated"),
        ("strip of 22 bytes", "truncated.* 22 bytes of pixels for 300x200"),
        ("lossless JPEG of 22 bytes", "truncated.* 22 bytes of pixels for 300x200"),
    ],
)
def test_a_damaged_dng_is_one_message_and_nothing_printed(
    tmp_path: Path, write_dng: Writer, kind: str, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    values = np.random.default_rng(1).integers(100, 4000, (200, 300)).astype(np.uint16)
    path = tmp_path / "bad.dng"
    path.write_bytes(changed(kind, write_dng(tmp_path / "good.dng", values).read_bytes()))
    with pytest.raises(DataError, match=says) as caught:
        read_frame(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_a_file_that_becomes_shorter_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "f.dng"
    path.write_bytes(b"II*\0" + struct.pack("<IH", 8, 3) + bytes(20))
    monkeypatch.setattr(os, "fstat", lambda _descriptor: os.stat_result((0,) * 6 + (1000,) + (0,) * 3))
    with pytest.raises(DataError, match="becomes shorter while it is read"):
        read_directories(path)


def test_a_panasonic_header_without_pixels(tmp_path: Path) -> None:
    entries = [(2, 3, 1, 4016), (3, 3, 1, 2672), (280, 4, 1, 512)]
    path = tmp_path / "head.rw2"
    path.write_bytes(tiff("<", b"IIU\0", directory("<", entries, 0)).ljust(600, b"\1"))
    with pytest.raises(DataError, match=r"truncated: it holds 88 bytes of pixels for 4016x2672"):
        read_frame(path)


@pytest.mark.parametrize("big", [False, True], ids=["TIFF", "BigTIFF"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_every_form_is_read(tmp_path: Path, big: bool, order: str) -> None:
    path = tmp_path / "t.tif"
    extra = [(50714, "2I", 2, (7, 2, 9, 3), True), (50735, "s", 0, "2601234", True)]
    with tifffile.TiffWriter(path, bigtiff=big, byteorder=order) as writer:
        writer.write(np.zeros((5, 7), np.uint16), subifds=1, extratags=extra, metadata=None)
        writer.write(np.zeros((3, 4), np.uint16), metadata=None)
        writer.write(np.zeros((6, 2), np.uint8), metadata=None)
    found = read_directories(path)
    assert [(one.number(256), one.number(257)) for one in found] == [(7, 5), (4, 3), (2, 6)]
    np.testing.assert_array_equal(found[0].values(50714), [3.5, 3.0])
    assert found[0].text(50735) == "2601234"
    assert found[2].number(50714, 3) == 3


def test_any_bytes_behind_a_sound_head_are_read_or_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / "fuzz.tif"
    for _ in range(200):
        path.write_bytes(tiff("<", b"II*\0", rng.integers(0, 12, rng.integers(2, 300)).astype(np.uint8).tobytes()))
        with pytest.raises(DataError):
            read_frame(path)
    assert capfd.readouterr().err == ""
