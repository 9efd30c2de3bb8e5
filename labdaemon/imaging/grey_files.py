"""Grey TIFF and PNG files as other programs write them: decoded, or refused for what they are."""

from __future__ import annotations

import io
import lzma
import re
import struct
import zlib
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.imaging.file_tags import (
    BITS,
    HEIGHT,
    PHOTOMETRIC,
    SAMPLE_FORMAT,
    SAMPLES,
    WIDTH,
    FileTags,
    check_pixel_bytes,
)
from labdaemon.imaging.library_output import captured_stderr
from labdaemon.imaging.tiff_directories import BIG_TIFF, TiffDirectory

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_ORIENTATION, _DESCRIPTION = 274, 270
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _PALETTE = 0, 1, 3
_COLOUR = "is a colour image; give the RAW file, or a grey TIFF or PNG with linear values"


def read_tiff(path: Path, tags: FileTags) -> NDArray[Any]:
    """Decode a grey TIFF of 8 or 16 bits.

    Parameters
    ----------
    path
        The file.
    tags
        Its tags.

    Returns
    -------
    (h, w) values, larger for more light whatever the file's photometric interpretation, in the order in which they are
    stored.

    Raises
    ------
    DataError
        It holds several images, colour, other than 8 or 16-bit whole numbers, or cannot be decoded.
    """
    if len(tags.images) != 1:
        raise DataError(f"holds {len(tags.images)} images (pages); save the one that is meant by itself", file=path)
    page = tags.images[0]
    _check_page(path, page)
    bits, size = page.number(BITS, 1), (page.number(HEIGHT), page.number(WIDTH))
    check_pixel_bytes(path, page)
    with captured_stderr() as printed:
        values = _decode(path, page)
    if values is None or printed.reports_damage:
        raise DataError("cannot be decoded; the file is damaged or its compression unknown", file=path)
    if values.shape != size or values.dtype != (np.uint8 if bits == 8 else np.uint16):
        raise DataError(f"cannot be decoded as {size[1]}x{size[0]} grey values of {bits} bits", file=path)
    if page.number(PHOTOMETRIC, _BLACK_IS_ZERO) == _WHITE_IS_ZERO:
        values = np.iinfo(values.dtype).max - values
    return values


def _check_page(path: Path, page: TiffDirectory) -> None:
    """Refuse what is no grey image of whole numbers."""
    stack = re.search(r"^images=(\d+)", page.text(_DESCRIPTION), re.MULTILINE)  # ImageJ writes one directory for all
    if stack and int(stack[1]) > 1:
        raise DataError(f"holds {stack[1]} images; save the one that is meant by itself", file=path)
    photometric, samples = page.number(PHOTOMETRIC, _BLACK_IS_ZERO), page.number(SAMPLES, 1)
    if photometric not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO):
        raise DataError(
            "has a colour palette; save it as grey values" if photometric == _PALETTE else _COLOUR, file=path
        )
    if samples != 1:
        raise DataError("has an alpha channel; save grey values alone" if samples == 2 else _COLOUR, file=path)
    bits, kind = page.number(BITS, 1), page.number(SAMPLE_FORMAT, 1)
    if bits not in (8, 16) or kind != 1:
        name = {1: "unsigned", 2: "signed", 3: "floating-point"}.get(kind, "other")
        raise DataError(f"has {name} values of {bits} bits; a grey TIFF or PNG must have 8 or 16 bits", file=path)


def _decode(path: Path, page: TiffDirectory) -> NDArray[Any] | None:
    """Values as stored: by tifffile, or by OpenCV where that lacks the codec (LZW); None where both fail."""
    data = bytearray(path.read_bytes())
    order: Literal["little", "big"] = "little" if data[:1] == b"I" else "big"
    # Both read the first directory, which may be a thumbnail's.
    place = slice(8, 16) if data[:4] in BIG_TIFF else slice(4, 8)
    data[place] = page.place.to_bytes(place.stop - place.start, order)
    try:
        return np.asarray(tifffile.imread(io.BytesIO(data), key=0))
    except (zlib.error, lzma.LZMAError):  # a checksum does not hold; OpenCV does not look at it
        return None
    except Exception:  # codecs raise whatever they like; OpenCV decides whether the file can be read
        pass
    # OpenCV would turn the image by its orientation, and inverts WhiteIsZero for 8 bits only.
    for code in (PHOTOMETRIC, _ORIENTATION):
        tag = page.tags.get(code)
        if tag is not None:
            data[tag.place : tag.place + 2] = (1).to_bytes(2, order)
    return _by_opencv(bytes(data))


def read_png(path: Path) -> NDArray[Any]:
    """Decode a grey PNG of 8 or 16 bits; what follows its end is left alone.

    Returns
    -------
    (h, w) values.

    Raises
    ------
    DataError
        It is cut short, damaged, animated, coloured, or has other than 8 or 16 bits.
    """
    data = path.read_bytes()
    pixels = [PNG_MAGIC]
    place, kind = len(PNG_MAGIC), b""
    while kind != b"IEND":
        if place + 12 > len(data):
            raise DataError("the file is truncated; fetch it again", file=path)
        (length,), kind = struct.unpack(">I", data[place : place + 4]), data[place + 4 : place + 8]
        chunk, place = data[place : place + 12 + length], place + 12 + length
        if place > len(data):
            raise DataError("the file is truncated; fetch it again", file=path)
        if kind in (b"IHDR", b"IDAT", b"IEND"):
            if zlib.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:], "big"):
                raise DataError("is damaged: a checksum does not hold; fetch it again", file=path)
            pixels.append(chunk)
        if kind == b"IHDR":
            _check_header(path, chunk[8:-4])
        if kind == b"acTL":
            raise DataError("holds several images (animated PNG); save the one that is meant by itself", file=path)
    with captured_stderr() as printed:
        # Without the other chunks, so that no transparent colour or profile changes what comes out.
        values = _by_opencv(b"".join(pixels))
    if values is None or printed.reports_damage:
        raise DataError("cannot be decoded; the file is damaged", file=path)
    return values


def _check_header(path: Path, header: bytes) -> None:
    bits, colour = header[8:10] if len(header) >= 10 else (0, 0)
    if colour != 0:
        raise DataError("has an alpha channel; save grey values alone" if colour == 4 else _COLOUR, file=path)
    if bits not in (8, 16):
        raise DataError(f"has values of {bits} bits; a grey TIFF or PNG must have 8 or 16 bits", file=path)


def _by_opencv(data: bytes) -> NDArray[Any] | None:
    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:  # some damage raises instead of giving nothing
        return None
