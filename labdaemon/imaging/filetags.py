"""What the TIFF tags of a RAW file say that LibRaw does not pass on: black-level patterns, completeness, time, serial.

NEF, DNG, ARW, CR2 and PEF are TIFF files; the tags are read before LibRaw unpacks anything, which takes a
millisecond. Tag numbers are those of TIFF 6.0, Exif 2.3 and the DNG specification 1.4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from labdaemon.errors import DataError

FloatArray = NDArray[np.float64]

TIFF_MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First four bytes of TIFF and BigTIFF; makers' variants of them are LibRaw's alone."""

_CFA, _LINEAR_RAW = 32803, 34892


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
        True for RAW files, False for an ordinary TIFF picture.
    black
        DNG black levels, None where LibRaw's own are to be used.
    taken_at
        Camera's clock at the exposure, no time zone; None if not written.
    serial
        The body's serial number, empty if not written.
    exposure_s
        Exposure as the camera states it; None if not written.
    """

    is_raw: bool
    black: BlackTags | None = None
    taken_at: datetime | None = None
    serial: str = ""
    exposure_s: float | None = None


def _walk(pages: Any) -> Iterator[Any]:
    for page in pages:
        yield page
        if page.pages is not None:
            yield from _walk(page.pages)


def _value(page: Any, code: int) -> Any:
    tag = page.tags.get(code)
    return None if tag is None else tag.value


def _levels(page: Any, code: int) -> FloatArray:
    """Values of a black-level tag, whatever type it is stored as (types 5 and 10 are pairs); empty if absent."""
    tag = page.tags.get(code)
    if tag is None:
        return np.empty(0)
    flat = np.atleast_1d(np.asarray(tag.value, dtype=np.float64)).ravel()
    return flat[0::2] / flat[1::2] if int(tag.dtype) in (5, 10) else flat


def _black(page: Any) -> BlackTags | None:
    pattern = _levels(page, 50714)
    if not pattern.size:
        return None
    rows, columns = _value(page, 50713) or (1, 1)
    if pattern.size != rows * columns:
        return None
    area = _value(page, 50829) or (0, 0, 0, 0)
    return BlackTags(
        pattern_dn=pattern.reshape(rows, columns),
        column_dn=_levels(page, 50715),
        row_dn=_levels(page, 50716),
        origin_yx=(int(area[0]), int(area[1])),
    )


def _moment(text: object) -> datetime | None:
    try:
        return datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None


def read_tags(path: Path) -> FileTags:
    """Read the tags of a TIFF-like file and check that its picture lies inside it.

    A directory that cannot be read is left to LibRaw to judge: makers take liberties with it.

    Raises
    ------
    DataError
        The file is cut short.
    """
    size = path.stat().st_size
    try:
        with tifffile.TiffFile(path) as tif:
            pages = list(_walk(tif.pages))
            main = [page for page in pages if int(page.photometric or 0) in (_CFA, _LINEAR_RAW)]
            ends = [_end(page) for page in main or pages]
            needed = max(ends, default=size + 1)
            raw = bool(main) or (bool(pages) and _camera(pages[0]))
            black = _black(max(main, key=lambda page: int(page.imagewidth * page.imagelength))) if main else None
            shot = _shot(pages[0]) if pages else {}
    except Exception:  # a strange directory fails in as many ways as there are tags
        return FileTags(is_raw=True)
    if needed > size:
        raise DataError(
            f"the file is truncated: it has {size} bytes, its picture needs {needed}; fetch it again", file=path
        )
    return FileTags(is_raw=raw, black=black, **shot)


def _end(page: Any) -> int:
    """Byte behind the last of a page's pixels."""
    return max((int(o) + int(c) for o, c in zip(page.dataoffsets, page.databytecounts, strict=False)), default=0)


def _camera(page: Any) -> bool:
    """Whether a file whose pages do not say so is a camera's own: a maker's name on anything but a grey picture."""
    return 50706 in page.tags or (271 in page.tags and int(page.photometric or 0) not in (0, 1))


def _shot(page: Any) -> dict[str, Any]:
    """When, by which body and how long, as far as it can be read."""
    try:
        exif = _value(page, 34665)
        exif = exif if isinstance(exif, dict) else {}
    except Exception:  # a damaged Exif directory costs its content, not the frame
        exif = {}
    exposure = exif.get("ExposureTime") or _value(page, 33434)
    return {
        "taken_at": _moment(exif.get("DateTimeOriginal") or _value(page, 36867) or _value(page, 306)),
        "serial": str(exif.get("BodySerialNumber") or _value(page, 50735) or _value(page, 42033) or "").strip(),
        "exposure_s": float(Fraction(*exposure)) if isinstance(exposure, tuple) and exposure[1] else None,
    }
