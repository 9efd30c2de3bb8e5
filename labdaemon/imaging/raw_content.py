"""Whether a file is RAW, by its content: magic numbers and TIFF directories, read a few kilobytes at a time.

A file on a camera's card is judged before it is fetched, through whatever reads parts of it. The rules are those by
which LibRaw recognises files; nothing is decoded. A file that is still being written is neither RAW nor anything else
yet: it has no magic number, or ends before its own directory says.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

Read = Callable[[int, int], bytes]
"""Bytes of a file from an offset, at most so many; fewer at its end."""

BLOCK_BYTES = 1 << 16  # each question to the camera takes milliseconds: a directory comes with one
HEAD_BYTES = 128  # all makers' signatures lie within it
MOST_DIRECTORIES = 48  # real files have ten; a hostile one must not lead in circles
MOST_ENTRIES = 1024  # real directories have a hundred
MOST_VALUES = 1 << 16  # as many strips or tiles has no camera
MOST_BOXES = 64  # CR3 has a dozen at its top

CFA, LINEAR_RAW = 32803, 34892
GREY = (0, 1)

WIDTH, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES = 256, 258, 259, 262, 277
STRIP_OFFSETS, STRIP_BYTES, TILE_OFFSETS, TILE_BYTES = 273, 279, 324, 325
SUB_DIRECTORIES, DNG_VERSION = 330, 50706
WANTED = frozenset(
    {WIDTH, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES, STRIP_OFFSETS, STRIP_BYTES, TILE_OFFSETS, TILE_BYTES}
    | {SUB_DIRECTORIES, DNG_VERSION}
)
JPEG_COMPRESSIONS = (6, 7)

FORMATS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
"""TIFF's types of whole numbers; others hold nothing that is asked for here."""

OTHER_RAW = {
    b"FOVb": ".x3f",
    b"\0MRM": ".mrw",
    b"II\x1a\0\0\0HEAPCCDR": ".crw",
    b"NOKIARAW": ".raw",
    b"DSC-Image": ".raw",
}
"""Makers' own formats that are known by their first bytes alone."""

OTHERS = (
    *(b"\xff\xd8\xff", b"\x89PNG", b"GIF8", b"BM", b"\0\0\0\x0cJXL ", b"\xff\x0a", b"\0\0\0\x0cjP"),
    *(b"RIFF", b"OggS", b"ID3", b"fLaC", b"\0\0\1\xba", b"\0\0\1\xb3", b"\x1aE\xdf\xa3"),
    *(b"<?xml", b"<x:xmpmeta", b"<?xpacket", b"%PDF", b"PK\3\4"),
)
"""Images for display, sounds, films and notes, by their first bytes."""

TIFF_MAGICS = {
    b"II*\0": "<",
    b"MM\0*": ">",
    b"II+\0": "<",
    b"MM\0+": ">",
    b"IIRO": "<",
    b"IIRS": "<",
    b"MMOR": ">",
    b"IIU\0": "<",
}
"""TIFF, BigTIFF, and what Olympus (``RO``, ``RS``, ``OR``) and Panasonic (``U``) write in place of 42."""

OLYMPUS, PANASONIC = (b"IIRO", b"IIRS", b"MMOR"), (b"IIU\0",)


class Kind(Enum):
    """What a file is."""

    RAW = "raw"
    OTHER = "other"
    UNKNOWN = "unknown"
    """Neither known as RAW nor as anything else: its name has to say."""
    UNFINISHED = "unfinished"
    """Not written to its end yet, as far as can be seen."""


@dataclass(frozen=True, slots=True)
class Content:
    """A file's kind, and the ending that its name should have where its content says so (with the dot)."""

    kind: Kind
    ending: str = ""


@dataclass(slots=True)
class _Directory:
    """The tags of one TIFF directory that matter here: whole numbers by tag."""

    tags: dict[int, list[int]] = field(default_factory=dict)

    def first(self, tag: int, default: int = -1) -> int:
        values = self.tags.get(tag)
        return values[0] if values else default

    @property
    def is_raw(self) -> bool:
        return self.first(PHOTOMETRIC) in (CFA, LINEAR_RAW)

    @property
    def is_grey(self) -> bool:
        """An ordinary image of one channel, taken as linear."""
        return (
            self.first(PHOTOMETRIC) in GREY
            and self.first(SAMPLES, 1) == 1
            and self.first(BITS) in (8, 16)
            and self.first(COMPRESSION, 1) not in JPEG_COMPRESSIONS
        )

    @property
    def end(self) -> int:
        """Byte behind the last of the pixels; 0 where it does not say."""
        ends = [0]
        for offsets, sizes in ((STRIP_OFFSETS, STRIP_BYTES), (TILE_OFFSETS, TILE_BYTES)):
            pairs = zip(self.tags.get(offsets, []), self.tags.get(sizes, []), strict=False)
            ends += [offset + size for offset, size in pairs if offset not in (0, 0xFFFFFFFF)]
        return max(ends)


class _IncompleteFile(Exception):
    """The file ends before what its own structure says."""


def check_file(path: Path) -> Content:
    """`check_content` of a file on disk."""
    with path.open("rb") as file:

        def read(offset: int, size: int) -> bytes:
            file.seek(offset)
            return file.read(size)

        return check_content(read, path.stat().st_size)


def check_content(read: Read, size_bytes: int) -> Content:
    """Judge a file by its content.

    Parameters
    ----------
    read
        Reads parts of it. What it raises is passed on.
    size_bytes
        Its size; structures that reach past it make it unfinished.
    """
    source = _Blocks(read, size_bytes)
    head = source.some(0, HEAD_BYTES)
    if len(head) < 12 or not any(head):
        return Content(Kind.UNFINISHED)  # too short for any format, or room that is taken but not written yet
    try:
        if head[:4] in TIFF_MAGICS:
            return _tiff(source, head)
        if head.startswith(b"FUJIFILMCCD-RAW"):
            return _fuji(source)
        if head[4:8] == b"ftyp":
            return _boxes(source, head)
    except _IncompleteFile:  # the camera has not written it to its end yet
        return Content(Kind.UNFINISHED)
    for magic, ending in OTHER_RAW.items():
        if head.startswith(magic):
            return Content(Kind.RAW, ending)
    return Content(Kind.OTHER if head.lstrip(b"\xef\xbb\xbf").startswith(OTHERS) else Kind.UNKNOWN)


class _Blocks:
    """Reads through a cache of blocks, so that a directory costs one reading and not one a tag."""

    def __init__(self, read: Read, size_bytes: int) -> None:
        self._read, self.size_bytes = read, size_bytes
        self._blocks: dict[int, bytes] = {}

    def some(self, offset: int, size: int) -> bytes:
        """At most so many bytes."""
        found = bytearray()
        end = min(offset + size, self.size_bytes)
        while offset < end:
            number, skipped = divmod(offset, BLOCK_BYTES)
            part = self._block(number)[skipped : skipped + end - offset]
            if not part:
                break
            found += part
            offset += len(part)
        return bytes(found)

    def all(self, offset: int, size: int) -> bytes:
        """Exactly so many bytes; raises `_IncompleteFile` past the end."""
        found = self.some(offset, size)
        if len(found) < size:
            raise _IncompleteFile
        return found

    def _block(self, number: int) -> bytes:
        if number not in self._blocks:
            start = number * BLOCK_BYTES
            self._blocks[number] = self._read(start, min(BLOCK_BYTES, self.size_bytes - start))
        return self._blocks[number]


def _tiff(source: _Blocks, head: bytes) -> Content:
    """RAW if a directory holds a sensor's own values, or the maker marked the whole file."""
    magic = head[:4]
    order = TIFF_MAGICS[magic]
    directories = list(_directories(source, order, is_big=magic[2:4] in (b"+\0", b"\0+")))
    raw = [directory for directory in directories if directory.is_raw]
    if max((directory.end for directory in raw), default=0) > source.size_bytes:
        return Content(Kind.UNFINISHED)
    if magic in OLYMPUS:
        return Content(Kind.RAW, ".orf")
    if magic in PANASONIC:
        return Content(Kind.RAW, ".rw2")
    if head[8:10] == b"CR":
        return Content(Kind.RAW, ".cr2")
    if head[8:12] in (b"IIII", b"MMMM"):
        return Content(Kind.RAW, ".iiq")
    if raw or any(DNG_VERSION in directory.tags for directory in directories):
        return Content(Kind.RAW)
    if directories and directories[0].is_grey:
        if directories[0].end > source.size_bytes:
            return Content(Kind.UNFINISHED)
        return Content(Kind.RAW, ".tif")
    return Content(Kind.UNKNOWN if not directories or directories[0].first(PHOTOMETRIC) < 0 else Kind.OTHER)


def _directories(source: _Blocks, order: str, *, is_big: bool) -> Iterator[_Directory]:
    """The chain of directories and those below them, each once, whatever they point at."""
    [first] = struct.unpack(order + ("Q" if is_big else "I"), source.all(8 if is_big else 4, 8 if is_big else 4))
    waiting, seen = [first], {0}
    while waiting and len(seen) <= MOST_DIRECTORIES:
        offset = waiting.pop(0)
        if offset in seen:
            continue
        seen.add(offset)
        if offset >= source.size_bytes:
            raise _IncompleteFile
        directory, following = _directory(source, order, offset, is_big=is_big)
        yield directory
        waiting += [following, *directory.tags.get(SUB_DIRECTORIES, [])]


def _directory(source: _Blocks, order: str, offset: int, *, is_big: bool) -> tuple[_Directory, int]:
    """One directory, and where the next one lies."""
    count_form, entry_form, pointer = ("Q", "HHQ8s", 8) if is_big else ("H", "HHI4s", 4)
    [count] = struct.unpack(order + count_form, source.all(offset, struct.calcsize(order + count_form)))
    directory = _Directory()
    if count > MOST_ENTRIES:
        return directory, 0
    offset += struct.calcsize(order + count_form)
    size = struct.calcsize(order + entry_form)
    entries = source.all(offset, count * size)
    for place in range(count):
        tag, kind, number, value = struct.unpack_from(order + entry_form, entries, place * size)
        letter = FORMATS.get(kind)
        if tag not in WANTED or letter is None or not 0 < number <= MOST_VALUES:
            continue
        form = f"{order}{number}{letter}"
        length = struct.calcsize(form)
        if length > pointer:
            [place_of_values] = struct.unpack(order + ("Q" if is_big else "I"), value)
            value = source.all(place_of_values, length)
        directory.tags[tag] = list(struct.unpack_from(form, value))
    following = source.some(offset + count * size, pointer)
    last = struct.unpack(order + ("Q" if is_big else "I"), following)[0] if len(following) == pointer else 0
    return directory, last


def _fuji(source: _Blocks) -> Content:
    """RAF: three parts, whose offsets and lengths stand at fixed places."""
    numbers = struct.unpack(">6I", source.all(84, 24))
    end = max(offset + length for offset, length in zip(numbers[::2], numbers[1::2], strict=True))
    return Content(Kind.UNFINISHED if end > source.size_bytes else Kind.RAW, ".raf")


def _boxes(source: _Blocks, head: bytes) -> Content:
    """An ISO media file: Canon's CR3 by its brand; all others are stills for looking at, or films."""
    if head[8:12] != b"crx ":
        return Content(Kind.OTHER)
    offset = 0
    for _ in range(MOST_BOXES):
        if offset >= source.size_bytes:
            break
        [size] = struct.unpack(">I", source.all(offset, 4))
        if size == 1:
            [size] = struct.unpack(">Q", source.all(offset + 8, 8))
        if size < 8:  # 0 reaches to the end of the file; less makes no sense
            break
        offset += size
    return Content(Kind.UNFINISHED if offset > source.size_bytes else Kind.RAW, ".cr3")
