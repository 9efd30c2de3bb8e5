"""What the tags of a TIFF-like file say before its pixels are read: kind, completeness, black levels, time, serial.

The tags are read before LibRaw unpacks anything, which takes a millisecond. Tag numbers are those of TIFF 6.0,
Exif 2.3 and the DNG specification 1.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.imaging.tiff_directories import MAKER_MAGICS, TIFF_MAGICS, TiffDirectory, read_directories

FloatArray = NDArray[np.float64]

TIFF_LIKE = TIFF_MAGICS + MAKER_MAGICS

WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES, SAMPLE_FORMAT = 256, 257, 258, 259, 262, 277, 339
SUBFILE, MAKER, DNG_VERSION = 254, 271, 50706
_STRIP_OFFSETS, _STRIP_BYTES, _TILE_OFFSETS, _TILE_BYTES = 273, 279, 324, 325
_CFA, _LINEAR_RAW = 32803, 34892
_CFA_REPEAT = 33421  # of TIFF/EP
_FLOAT = 3  # of the tag SampleFormat
_RW2_WIDTH, _RW2_HEIGHT, _RW2_OFFSET = 2, 3, 280

PIXELS_A_BYTE = 256
"""Pixels for each byte of a file above which it holds no frame, only tags: noise cannot be compressed so far."""
MOST_PIXELS_A_BYTE = 16
"""Compressed RAW data of fewer bytes hold no frame: the shortest Huffman code takes a bit for each pixel."""
ZERO_TAIL_BYTES, ZERO_TAIL_PART = 16_384, 0.02
"""Zero bytes, and their part of all, at the end of compressed data from which they are no padding."""


@dataclass(frozen=True, slots=True, eq=False)
class BlackTags:
    """Black levels as a DNG gives them, in coordinates of its active area.

    Attributes
    ----------
    pattern_dn
        (bh, bw) repeated over the active area from its top-left corner.
    column_dn, row_dn
        Added to each column and row (`BlackLevelDeltaH`, `BlackLevelDeltaV`); empty if absent.
    origin_yx
        Top-left corner of the active area in the whole RAW image.
    """

    pattern_dn: FloatArray
    column_dn: FloatArray
    row_dn: FloatArray
    origin_yx: tuple[int, int]

    def over(self, top: int, left: int, height: int, width: int) -> FloatArray:
        """Black levels of a window of the RAW image, DN; (height, width), or the pattern alone where nothing else is.

        Parameters
        ----------
        top, left
            The window's corner in the whole RAW image.
        height, width
            Its size.
        """
        dy, dx = top - self.origin_yx[0], left - self.origin_yx[1]
        pattern = np.roll(self.pattern_dn, (-dy, -dx), axis=(0, 1))
        if not self.column_dn.size and not self.row_dn.size:
            return pattern
        bh, bw = pattern.shape
        full = np.tile(pattern, (-(-height // bh), -(-width // bw)))[:height, :width]
        if self.column_dn.size:
            full = full + self.column_dn[np.clip(np.arange(width) + dx, 0, self.column_dn.size - 1)]
        if self.row_dn.size:
            full = full + self.row_dn[np.clip(np.arange(height) + dy, 0, self.row_dn.size - 1), None]
        return full


@dataclass(frozen=True, slots=True, eq=False)
class FileTags:
    """What is worth knowing of a TIFF-like file before its pixels are read.

    Attributes
    ----------
    is_raw
        True for RAW files, False for an ordinary TIFF image.
    images
        Directories of an ordinary TIFF that hold a full image: neither a thumbnail nor a mask.
    black
        DNG black levels, None where LibRaw's own are to be used.
    taken_at
        Camera's clock at the exposure, no time zone; None if not written.
    serial
        The body's serial number, empty if not written.
    exposure_s
        Exposure as the camera states it; None if not written.
    compression
        TIFF's number of how the RAW pixels are compressed; 1 for not at all, or not known.
    """

    is_raw: bool
    images: tuple[TiffDirectory, ...] = field(default=())
    black: BlackTags | None = None
    taken_at: datetime | None = None
    serial: str = ""
    exposure_s: float | None = None
    compression: int = 1


def read_tags(path: Path) -> FileTags:
    """Read the tags of a TIFF-like file and check that its image lies inside it; of another file nothing is known.

    Raises
    ------
    DataError
        The file is cut short, holds no pixels, its directories are damaged, or its pixels are of a kind that cannot be
        measured: floating-point values, several values for a pixel of the mosaic, several exposures, or a colour filter
        that does not repeat every two pixels.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(4) not in TIFF_LIKE:
            return FileTags(is_raw=True)
    directories = read_directories(path)
    main = [one for one in directories if one.number(PHOTOMETRIC) in (_CFA, _LINEAR_RAW)]
    for one in main or directories:
        needed = _end(one)
        if needed > size:
            raise DataError(
                f"the file is truncated: it has {size} bytes, its image needs {needed}; fetch it again", file=path
            )
    is_raw = bool(main) or not directories or _is_camera_file(directories[0])
    if main:
        largest = max(main, key=_pixels)
        _check_kind(path, largest)
        _check_single_exposure(path, main, largest)
        _check_content(path, largest, is_dng=any(DNG_VERSION in one.tags for one in directories))
    elif directories and directories[0].number(_RW2_OFFSET) and _RW2_WIDTH in directories[0].tags:
        _check_panasonic(path, size, directories[0])
    images = tuple(one for one in directories if not one.number(SUBFILE) & 5)
    return FileTags(
        is_raw=is_raw,
        images=() if is_raw else images,
        black=_black(max(main, key=_pixels)) if main else None,
        compression=max(main, key=_pixels).number(COMPRESSION, 1) if main else 1,
        **_shot(directories[0] if directories else TiffDirectory({})),
    )


def exposure_of(path: Path) -> float | None:
    """Exposure that the camera wrote into a frame's file, s; None where it wrote none, or the file is damaged."""
    try:
        return read_tags(path).exposure_s
    except (DataError, OSError):  # whoever reads the frame reports it
        return None


def check_pixel_bytes(path: Path, directory: TiffDirectory) -> None:
    """Check that an image of an ordinary TIFF has pixels, and as many bytes as they take.

    A decoder makes room for what a damaged header claims, gigabytes for a file of kilobytes, before it reads a byte.

    Raises
    ------
    DataError
        It has no pixels, fewer bytes than they take, or strips without any.
    """
    counts = _pixel_bytes(directory)
    if not _pixels(directory):
        raise DataError(f"has no pixels: {directory.number(WIDTH)}x{directory.number(HEIGHT)}", file=path)
    bits = directory.number(BITS, 1) * directory.number(SAMPLES, 1)
    needed = _pixels(directory) * (bits / 8 if directory.number(COMPRESSION, 1) == 1 else 1 / PIXELS_A_BYTE)
    if not counts.size or not counts.all():
        raise DataError(
            "does not say how many bytes its pixels take (StripByteCounts is absent or 0): it is incomplete, or a "
            "program left them out; save it again",
            file=path,
        )
    if counts.sum() < needed:
        raise _no_pixels(path, directory, counts)


def _pixels(directory: TiffDirectory) -> int:
    return directory.number(WIDTH) * directory.number(HEIGHT)


def _pixel_bytes(directory: TiffDirectory) -> FloatArray:
    """(n,) byte counts of strips or tiles."""
    return directory.values(_TILE_BYTES if _TILE_BYTES in directory.tags else _STRIP_BYTES)


def _pixel_offsets(directory: TiffDirectory) -> FloatArray:
    return directory.values(_TILE_OFFSETS if _TILE_OFFSETS in directory.tags else _STRIP_OFFSETS)


def _end(directory: TiffDirectory) -> int:
    """Byte behind the last of an image's pixels; 0 where it has none."""
    offsets, counts = _pixel_offsets(directory), _pixel_bytes(directory)
    ends = [int(o) + int(c) for o, c in zip(offsets, counts, strict=False)]
    return max(ends, default=0)


def _no_pixels(path: Path, directory: TiffDirectory, counts: FloatArray) -> DataError:
    return DataError(
        f"the file is truncated: it holds {int(counts.sum())} bytes of pixels for {directory.number(WIDTH)}x"
        f"{directory.number(HEIGHT)}; fetch it again",
        file=path,
    )


def _check_kind(path: Path, directory: TiffDirectory) -> None:
    """Refuse values and colour filters that LibRaw would pass on as something else."""
    if _FLOAT in directory.values(SAMPLE_FORMAT):
        raise DataError(
            "is a floating-point DNG: it was processed after the exposure; give the camera's own RAW file", file=path
        )
    bits = directory.values(BITS)
    if bits.size and bits.max() > 16:
        raise DataError(f"has {bits.max():g} bits a value; at most 16 are read", file=path)
    samples = directory.number(SAMPLES, 1)
    if directory.number(PHOTOMETRIC) == _CFA and samples > 1:
        raise DataError(
            f"has {samples} values for each pixel of its mosaic (pixel shift or dual pixel): switch that off in the "
            "camera and give a RAW file of one exposure",
            file=path,
        )
    repeat = tuple(int(v) for v in directory.values(_CFA_REPEAT))
    if directory.number(PHOTOMETRIC) == _CFA and repeat and repeat != (2, 2):
        rows, columns = (*repeat, 0)[:2]
        kind = {(6, 6): "an X-Trans sensor", (4, 4): "a Quad Bayer sensor"}.get((rows, columns), "a sensor")
        raise DataError(
            f"comes from {kind} whose colour filter repeats every {rows} x {columns} pixels; a Bayer (2 x 2) or grey "
            "sensor is needed",
            file=path,
        )


def _check_single_exposure(path: Path, main: Sequence[TiffDirectory], largest: TiffDirectory) -> None:
    """Refuse files of several exposures, of which LibRaw would pass on the first without a word."""
    size = (largest.number(WIDTH), largest.number(HEIGHT))
    full = [
        one
        for one in main
        if one.number(PHOTOMETRIC) == _CFA
        and not one.number(SUBFILE)
        and (one.number(WIDTH), one.number(HEIGHT)) == size
    ]
    if len(full) > 1:
        raise DataError(
            f"holds {len(full)} exposures (pixel shift or a burst): switch that off in the camera and give a RAW file "
            "of one exposure",
            file=path,
        )


def _check_content(path: Path, directory: TiffDirectory, *, is_dng: bool) -> None:
    """Refuse RAW data of too few bytes, and compressed data that end in zeros."""
    counts, offsets = _pixel_bytes(directory), _pixel_offsets(directory)
    if not counts.size:
        return  # a maker may keep its pixels elsewhere; LibRaw knows where
    plain = is_dng and directory.number(COMPRESSION, 1) == 1
    least = _pixels(directory) / 8 * (directory.number(BITS, 8) * directory.number(SAMPLES, 1) if plain else 8)
    if counts.sum() < (least if plain else least / MOST_PIXELS_A_BYTE / _shrinkage(directory)):
        raise _no_pixels(path, directory, counts)
    if not plain and offsets.size:
        zeros = _zeros_at_end(path, int(offsets[-1]), int(counts[-1]))
        if zeros > max(ZERO_TAIL_BYTES, ZERO_TAIL_PART * float(counts[-1])):
            raise DataError(
                f"the file is incomplete: the last {zeros} bytes of its pixels are zero; fetch it again", file=path
            )


def _shrinkage(directory: TiffDirectory) -> float:
    """How many times smaller than lossless JPEG a compression can make a frame that shows nothing."""
    return 1.0 if directory.number(COMPRESSION, 1) in (1, 7) else 128.0


def _zeros_at_end(path: Path, offset: int, count: int) -> int:
    """How many bytes at the end of a part of the file are zero."""
    with path.open("rb") as stream:
        stream.seek(offset)
        data = stream.read(count)
    return len(data) - len(data.rstrip(b"\0"))


def _check_panasonic(path: Path, size: int, directory: TiffDirectory) -> None:
    """Check that a Panasonic RW2 file, which gives no byte count, has room for its pixels."""
    width, height = directory.number(_RW2_WIDTH), directory.number(_RW2_HEIGHT)
    left = size - directory.number(_RW2_OFFSET)
    if left * MOST_PIXELS_A_BYTE < width * height:
        raise DataError(
            f"the file is truncated: it holds {max(left, 0)} bytes of pixels for {width}x{height}; fetch it again",
            file=path,
        )


def _black(directory: TiffDirectory) -> BlackTags | None:
    pattern = directory.values(50714)
    if not pattern.size:
        return None
    repeat: Sequence[float] = directory.values(50713).tolist() or (1, 1)
    rows, columns = int(repeat[0]), int(repeat[-1])
    if pattern.size != rows * columns or not np.isfinite(pattern).all():
        return None
    area = directory.values(50829).tolist() or [0, 0]
    return BlackTags(
        pattern_dn=pattern.reshape(rows, columns),
        column_dn=directory.values(50715),
        row_dn=directory.values(50716),
        origin_yx=(int(area[0]), int(area[1])),
    )


def _moment(text: str) -> datetime | None:
    try:
        return datetime.strptime(text, "%Y:%m:%d %H:%M:%S")
    except ValueError:  # a body without a clock writes zeros or blanks
        return None


def _is_camera_file(directory: TiffDirectory) -> bool:
    """Whether a file whose pages do not say so is a camera's own: a maker's name on anything but a grey image."""
    return DNG_VERSION in directory.tags or (MAKER in directory.tags and directory.number(PHOTOMETRIC) not in (0, 1))


def _shot(directory: TiffDirectory) -> dict[str, Any]:
    """When, by which body and how long, as far as it can be read."""
    exif = directory.exif or TiffDirectory({})
    exposure = [*exif.values(33434), *directory.values(33434)]
    return {
        "taken_at": _moment(exif.text(36867) or directory.text(36867) or directory.text(306)),
        "serial": exif.text(42033) or directory.text(50735) or directory.text(42033),
        "exposure_s": float(exposure[0]) if exposure and np.isfinite(exposure[0]) else None,
    }
