"""Directories and tags of TIFF-like files, read with every offset checked against the file's size.

NEF, DNG, ARW, CR2 and PEF are TIFF files; ORF and RW2 differ from TIFF in their first four bytes only. A directory
whose chain leads back to itself, or that points behind the end of the file, is refused here, before a decoder that
follows it for ever sees it. Numbers are those of TIFF 6.0 and BigTIFF.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError

FloatArray = NDArray[np.float64]
ByteOrder = Literal["<", ">"]

BIG_TIFF = (b"II+\0", b"MM\0+")
TIFF_MAGICS = (b"II*\0", b"MM\0*", *BIG_TIFF)
"""First four bytes of TIFF and BigTIFF."""
MAKER_MAGICS = (b"IIU\0", b"IIRO", b"IIRS", b"MMOR")
"""First four bytes of files with TIFF's structure that only LibRaw decodes: Panasonic RW2, Olympus ORF."""

SUB_DIRECTORIES, EXIF = 330, 34665
LARGEST_CHAIN = 10_000
"""Directories after which reading ends: no camera or scanner writes so many."""
LARGEST_DEPTH = 100
"""Directories above a sub-directory from which on it is damage."""
LARGEST_VALUES = 1 << 22
"""Values of one tag that are read: a strip offset for each row of the largest sensor takes a hundredth of it."""

# TIFF's field types: NumPy's code, and how many of these make one value.
_TYPES = {
    1: ("u1", 1), 2: ("S1", 1), 3: ("u2", 1), 4: ("u4", 1), 5: ("u4", 2), 6: ("i1", 1), 7: ("u1", 1), 8: ("i2", 1),
    9: ("i4", 1), 10: ("i4", 2), 11: ("f4", 1), 12: ("f8", 1), 13: ("u4", 1), 16: ("u8", 1), 17: ("i8", 1),
    18: ("u8", 1),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class TiffTag:
    """One entry of a directory.

    Attributes
    ----------
    kind, count
        Field type and number of values.
    data
        The values' bytes.
    place
        Byte of the file at which they begin.
    order
        ``<`` or ``>``.
    """

    kind: int
    count: int
    data: bytes
    place: int
    order: ByteOrder

    @property
    def text(self) -> str:
        """The value of a text tag, up to its NUL."""
        return self.data.split(b"\0", 1)[0].decode("latin-1").strip()

    def numbers(self) -> FloatArray:
        """(n,) values as floating-point numbers, fractions divided out; n is 0 for text."""
        code, parts = _TYPES[self.kind]
        if code == "S1":
            return np.empty(0)
        flat = np.frombuffer(self.data, np.dtype(code).newbyteorder(self.order)).astype(np.float64)
        if parts == 1:
            return flat
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(flat[0::2] / flat[1::2])


@dataclass(frozen=True, slots=True, eq=False)
class TiffDirectory:
    """One directory: an image of the file, or its Exif data.

    Attributes
    ----------
    tags
        By number. An entry whose type is unknown is left out.
    exif
        The Exif directory, None where there is none or where it is damaged.
    place
        Byte of the file at which it begins.
    """

    tags: dict[int, TiffTag]
    exif: TiffDirectory | None = None
    place: int = 0

    def number(self, code: int, default: int = 0) -> int:
        """First value of a tag as a whole number."""
        values = self.values(code)
        return int(values[0]) if values.size and np.isfinite(values[0]) else default

    def values(self, code: int) -> FloatArray:
        """(n,) values of a tag; n is 0 where it is absent."""
        tag = self.tags.get(code)
        return tag.numbers() if tag is not None else np.empty(0)

    def text(self, code: int) -> str:
        """Text of a tag, empty where it is absent."""
        tag = self.tags.get(code)
        return tag.text if tag is not None else ""


class _Reader:
    """A file, its byte order and the widths of its counts and offsets."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.stream, self.path = stream, path
        self.size = os.fstat(stream.fileno()).st_size
        head = self.read(0, 16 if self.size >= 16 else 8)
        self.order: ByteOrder = "<" if head[:1] == b"I" else ">"
        self.big = head[:4] in BIG_TIFF
        self.first = self.unpack("Q", head[8:16])[0] if self.big else self.unpack("I", head[4:8])[0]

    def unpack(self, layout: str, data: bytes) -> tuple[int, ...]:
        return struct.unpack(self.order + layout, data)

    def read(self, offset: int, count: int) -> bytes:
        """Bytes of the file.

        Raises
        ------
        DataError
            They lie behind its end.
        """
        if offset + count > self.size:
            raise DataError(
                f"the file is truncated or damaged: it has {self.size} bytes, its directories point to byte "
                f"{offset + count}; fetch it again",
                file=self.path,
            )
        self.stream.seek(offset)
        data = self.stream.read(count)
        if len(data) < count:
            raise DataError("the file becomes shorter while it is read; fetch it again", file=self.path)
        return data


def read_directories(path: Path) -> list[TiffDirectory]:
    """Directories of a TIFF-like file, each followed by its sub-directories.

    Raises
    ------
    DataError
        A directory or a tag's values lie behind the end of the file, or the directories lead back to themselves.
    """
    with path.open("rb") as stream:
        reader = _Reader(stream, path)
        found: list[TiffDirectory] = []
        _follow(reader, reader.first, set(), set(), found)
        return found


def _follow(reader: _Reader, offset: int, above: set[int], seen: set[int], found: list[TiffDirectory]) -> None:
    """Read a chain of directories; `above` are those that lead here, `seen` all that were read."""
    chain: list[int] = []
    while offset:
        if offset in above:
            raise DataError("its directories lead back to themselves; the file is damaged", file=reader.path)
        if len(seen) > LARGEST_CHAIN or len(above) - len(chain) > LARGEST_DEPTH:
            raise DataError(f"has more than {len(seen)} images; one frame is needed", file=reader.path)
        if offset in seen:  # two parents may share a directory; its content counts once
            break
        seen.add(offset)
        above.add(offset)
        chain.append(offset)
        tags, following = _directory(reader, offset)
        found.append(TiffDirectory(tags, _exif(reader, tags), offset))
        children = tags.get(SUB_DIRECTORIES)
        if children is not None:
            for child in children.numbers():
                _follow(reader, int(child), above, seen, found)
        offset = following
    above.difference_update(chain)


def _exif(reader: _Reader, tags: dict[int, TiffTag]) -> TiffDirectory | None:
    try:
        return TiffDirectory(_directory(reader, int(tags[EXIF].numbers()[0]))[0]) if EXIF in tags else None
    except (DataError, IndexError, ValueError):  # a damaged Exif directory costs its content, not the frame
        return None


def _directory(reader: _Reader, offset: int) -> tuple[dict[int, TiffTag], int]:
    """Tags of a directory, and the offset of the next one (0 for none)."""
    head, entry, inline = (8, 20, 8) if reader.big else (2, 12, 4)
    (count,) = reader.unpack("Q" if reader.big else "H", reader.read(offset, head))
    block = reader.read(offset + head, count * entry)
    tail = reader.read(offset + head + count * entry, inline)
    (following,) = reader.unpack("Q" if reader.big else "I", tail)
    tags: dict[int, TiffTag] = {}
    for index in range(count):
        code, kind, length = reader.unpack("HHQ" if reader.big else "HHI", block[index * entry :][: entry - inline])
        if kind not in _TYPES:
            continue
        name, parts = _TYPES[kind]
        size = length * parts * np.dtype(name).itemsize
        place = offset + head + (index + 1) * entry - inline
        if size > inline:
            (place,) = reader.unpack("Q" if reader.big else "I", block[index * entry :][entry - inline : entry])
        if length > LARGEST_VALUES:  # a maker's own block, or damage; either way nothing that is used here
            reader.read(place + size, 0)
            continue
        tags[code] = TiffTag(kind, length, reader.read(place, size), place, reader.order)
    return tags, following
