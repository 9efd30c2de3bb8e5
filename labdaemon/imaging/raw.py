"""Open a frame file, whatever the camera calls it, or say in one line why it cannot be measured on."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rawpy
import tifffile
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.imaging.filetags import TIFF_MAGICS, FileTags, read_tags
from labdaemon.imaging.frame import RawFrame, mean_frame

__all__ = ["RawFrame", "mean_frame", "read_frame"]

_PNG = b"\x89PNG\r\n\x1a\n"


def read_frame(path: Path | str, *, expect_size: tuple[int, int] | None = None) -> RawFrame:
    """Read a frame: any file LibRaw opens, or an 8 or 16-bit grey TIFF or PNG, which is taken as linear.

    Parameters
    ----------
    path
        The file.
    expect_size
        (width, height) that the camera's `image_size` says; another size is refused.

    Raises
    ------
    DataError
        The file is missing, cut short, a JPEG, a colour picture, of another size, or from a sensor whose colour filter
        is not a Bayer mosaic (X-Trans, Foveon).
    """
    path = Path(path)
    magic = _magic(path)
    if magic[:3] == b"\xff\xd8\xff":
        raise DataError(
            "is a JPEG, not RAW: its tone curve hides how long a target stayed; set the camera to RAW", file=path
        )
    if magic == _PNG:
        frame = _grey_picture(path, _png(path), FileTags(is_raw=False))
    else:
        tags = read_tags(path) if magic[:4] in TIFF_MAGICS else FileTags(is_raw=True)
        frame = _raw(path, tags) if tags.is_raw else _grey_picture(path, _tiff(path), tags)
    if expect_size is not None and frame.size != tuple(expect_size):
        raise DataError(
            f"is {frame.size[0]}x{frame.size[1]} pixels, but image_size says {expect_size[0]}x{expect_size[1]}: "
            "another camera's file, or image_size is not that of the visible RAW area",
            file=path,
        )
    return frame


def _magic(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            head = stream.read(8)
    except FileNotFoundError:
        raise DataError("no such file; was the capture fetched from the camera?", file=path) from None
    except OSError as exc:
        raise DataError(f"cannot be read ({exc.strerror or exc})", file=path) from exc
    if len(head) < 8:
        raise DataError("the file is empty or truncated; fetch it again", file=path)
    return head


def _raw(path: Path, tags: FileTags) -> RawFrame:
    try:
        with rawpy.imread(str(path)) as raw:
            pattern = _pattern(path, raw)
            values = np.array(raw.raw_image_visible, dtype=np.uint16)
            black = _black(raw, tags, pattern)
            white = float(raw.white_level)
            linear = raw.camera_white_level_per_channel
    except rawpy.LibRawError as exc:
        text = exc.args[0].decode() if exc.args and isinstance(exc.args[0], bytes) else str(exc)
        reason = text[:1].lower() + text[1:]
        raise DataError(f"LibRaw cannot read it ({reason}); it is damaged or not a RAW file", file=path) from exc
    if linear is not None and min(linear) > 0.5 * white:  # smaller ones are makers' tags misread
        white = min(white, float(min(linear)))
    if white <= float(black.max()):
        raise DataError(f"its white level {white:g} lies below its black level {black.max():g}", file=path)
    return RawFrame(
        path=path,
        values=values,
        pattern=pattern,
        black=black,
        white_level=white,
        taken_at=tags.taken_at,
        serial=tags.serial,
        exposure_s=tags.exposure_s,
    )


def _pattern(path: Path, raw: rawpy.RawPy) -> NDArray[np.uint8]:
    """Colour channel of the visible area's repeating cell; (1, 1) for a grey sensor."""
    if raw.raw_type != rawpy.RawType.Flat or raw.raw_image is None:
        raise DataError(
            "has three values a pixel (Foveon, or a RAW already demosaiced); a Bayer or grey sensor is needed",
            file=path,
        )
    if raw.num_colors == 1:
        return np.zeros((1, 1), dtype=np.uint8)
    pattern = raw.raw_pattern
    if pattern is not None and pattern.shape == (6, 6):
        raise DataError("comes from an X-Trans sensor; a Bayer or grey sensor is needed", file=path)
    if pattern is None or pattern.shape != (2, 2):
        raise DataError("has a colour filter that is not a Bayer mosaic; a Bayer or grey sensor is needed", file=path)
    sizes = raw.sizes
    cell = [
        [raw.raw_color(sizes.top_margin + row, sizes.left_margin + column) for column in range(2)] for row in range(2)
    ]
    return np.array(cell, dtype=np.uint8)


def _black(raw: rawpy.RawPy, tags: FileTags, pattern: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Black level from the file's own tags where it has them, else LibRaw's, one a channel.

    LibRaw averages patterns larger than 2 x 2, and shifts odd margins to even ones without shifting the pattern.
    """
    sizes = raw.sizes
    if tags.black is not None:
        return tags.black.over(sizes.top_margin, sizes.left_margin, sizes.height, sizes.width)
    levels = np.array(raw.black_level_per_channel, dtype=np.float64)
    return levels[pattern]


def _tiff(path: Path) -> NDArray[np.generic]:
    try:
        picture: NDArray[np.generic] = tifffile.imread(path, key=0)
    except Exception as exc:  # the codecs raise whatever they like
        raise DataError(f"cannot be decoded ({exc}); the file is damaged", file=path) from exc
    return picture


def _png(path: Path) -> NDArray[np.generic]:
    data = path.read_bytes()
    if b"IEND" not in data[-16:]:
        raise DataError("the file is truncated; fetch it again", file=path)
    picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise DataError("cannot be decoded; the file is damaged", file=path)
    return picture


def _grey_picture(path: Path, picture: NDArray[np.generic], tags: FileTags) -> RawFrame:
    if picture.ndim != 2:
        raise DataError("is a colour picture; give the RAW file, or a grey TIFF or PNG with linear values", file=path)
    if picture.dtype not in (np.uint8, np.uint16):
        raise DataError(f"has values of type {picture.dtype}; a grey TIFF or PNG must have 8 or 16 bits", file=path)
    return RawFrame(
        path=path,
        values=picture.astype(np.uint16),
        pattern=np.zeros((1, 1), dtype=np.uint8),
        black=np.zeros((1, 1)),
        white_level=255.0 if picture.dtype == np.uint8 else 65535.0,
        taken_at=tags.taken_at,
    )
