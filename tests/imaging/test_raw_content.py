from __future__ import annotations

import io
import struct

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.imaging.raw_content import Content, Kind, Read, check_content
from labdrivers.sim.dng import write_dng


def reader_of(data: bytes) -> Read:
    """Reads parts of bytes in memory."""
    return lambda offset, size: data[offset : offset + size]


def dng(pattern: str = "RGGB") -> bytes:
    memory = io.BytesIO()
    write_dng(memory, np.arange(64 * 48, dtype=np.uint16).reshape(48, 64), pattern)
    return memory.getvalue()


def tiff(values: np.ndarray, **options) -> bytes:
    memory = io.BytesIO()
    tifffile.imwrite(memory, values, **options)
    return memory.getvalue()


def nef() -> bytes:
    """A picture for looking at in the first directory, the sensor's values in one below it, as Nikon writes them."""
    entry = struct.Struct("<HHII")
    first = [(256, 4, 1, 160), (262, 3, 1, 2), (330, 4, 1, 200)]
    below = [(256, 4, 1, 32), (258, 3, 1, 12), (262, 3, 1, 32803), (273, 4, 1, 400), (279, 4, 1, 600)]
    data = bytearray(1000)
    for offset, entries in ((8, first), (200, below)):
        packed = struct.pack("<H", len(entries)) + b"".join(entry.pack(*one) for one in entries) + bytes(4)
        data[offset : offset + len(packed)] = packed
    data[:8] = b"II*\0" + struct.pack("<I", 8)
    return bytes(data)


def cr3(size: int = 500) -> bytes:
    head = struct.pack(">I4s4sI4s", 24, b"ftyp", b"crx ", 1, b"crx ") + b"isom"
    return head + struct.pack(">I4s", size, b"mdat") + bytes(size - 8)


def raf() -> bytes:
    parts = struct.pack(">6I", 200, 100, 300, 50, 400, 600)
    return b"FUJIFILMCCD-RAW 0201".ljust(84, b"\0") + parts + bytes(1000 - 108)


FRAMES = {
    "DNG": dng(),
    "monochrome DNG": dng("GRAY"),
    "NEF": nef(),
    "NEF, big-endian": tiff(np.ones((9, 9), np.uint16), photometric=32803, byteorder=">"),
    "BigTIFF": tiff(np.ones((9, 9), np.uint16), photometric=32803, bigtiff=True),
    "CR3": cr3(),
    "RAF": raf(),
    "grey TIFF": tiff(np.ones((9, 9), np.uint16), photometric="minisblack"),
}

OTHERS = {
    "JPEG": b"\xff\xd8\xff\xe1" + bytes(500),
    "HEIF": b"\0\0\0\x1cftypheix\0\0\0\0mif1heic" + bytes(500),
    "film": b"\0\0\0\x14ftypqt  \0\0\0\0qt  " + bytes(500),
    "PNG": b"\x89PNG\r\n\x1a\n" + bytes(500),
    "sound": b"RIFF\0\0\0\0WAVE" + bytes(500),
    "note": b"<x:xmpmeta xmlns:x='adobe:ns:meta/'>" + b" " * 500,
    "colour TIFF": tiff(np.ones((9, 9, 3), np.uint8), photometric="rgb"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_known_by_their_content_and_where_they_end(name: str):
    data = FRAMES[name]
    assert check_content(reader_of(data), len(data)).kind is Kind.RAW
    for part in (data[: len(data) // 2], data[:60], bytes(len(data)), b""):
        assert check_content(reader_of(part), len(part)).kind is Kind.UNFINISHED


@pytest.mark.parametrize("name", OTHERS)
def test_what_comes_with_a_frame_is_none(name: str):
    assert check_content(reader_of(OTHERS[name]), len(OTHERS[name])) == Content(Kind.OTHER)


@pytest.mark.parametrize(
    ("magic", "ending"),
    [
        (b"IIRO\x08\0\0\0", ".orf"),
        (b"MMOR\0\0\0\x08", ".orf"),
        (b"IIU\0\x08\0\0\0", ".rw2"),
        (b"II*\0\x10\0\0\0CR\x02\0", ".cr2"),
        (b"FOVb", ".x3f"),
        (b"\0MRM", ".mrw"),
    ],
)
def test_makers_own_formats(magic: bytes, ending: str):
    data = magic.ljust(600, b"\0")
    assert check_content(reader_of(data), len(data)) == Content(Kind.RAW, ending)


def test_what_is_neither_is_unknown():
    assert check_content(reader_of(b"no camera's file"), 16).kind is Kind.UNKNOWN


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(FRAMES)), st.lists(st.tuples(st.integers(0, 999), st.integers(0, 255)), max_size=12))
def test_damage_is_judged_and_never_raised(name: str, damage: list[tuple[int, int]]):
    data = bytearray(FRAMES[name])
    for place, value in damage:
        data[place % len(data)] = value
    asked = []

    def read(offset: int, size: int) -> bytes:
        asked.append(offset)
        return bytes(data[offset : offset + size])

    assert check_content(read, len(data)).kind in Kind
    assert len(asked) <= 2  # one block of 64 KiB, however the directories point about
