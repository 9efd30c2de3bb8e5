"""Open a frame file, whatever the camera calls it, or say in one line why it cannot be measured on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.imaging.ceiling import find_ceilings
from labdaemon.imaging.compression import find_knees
from labdaemon.imaging.file_tags import PIXELS_A_BYTE, TIFF_LIKE, FileTags, read_tags
from labdaemon.imaging.frame import RawFrame, mean_frame
from labdaemon.imaging.frame_checks import empty_note, empty_rows, refuse_mosaic, uniform_note
from labdaemon.imaging.grey_files import PNG_MAGIC, read_png, read_tiff
from labdaemon.imaging.library_output import captured_stderr
from labdaemon.plain_file import check_plain_file

__all__ = ["RawFrame", "check_frame", "mean_frame", "read_frame"]

LOSSLESS_JPEG = 7
COMPRESSIONS = {
    8: "Deflate",
    32767: "Sony's method",
    32946: "Deflate",
    34713: "Nikon's method (High Efficiency is not supported)",
    34892: "lossy JPEG",
    52546: "JPEG XL",
    65535: "Pentax's method",
}
"""TIFF's numbers of compressions that LibRaw reads only in part."""


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
        The file is missing, cut short, damaged, a JPEG, a colour image, several images, a colour sensor's mosaic saved
        as grey, of another size, or from a sensor whose colour filter is not a Bayer mosaic (Quad Bayer, X-Trans,
        Foveon).
    """
    path = Path(path)
    magic = _magic(path)
    if magic[:3] == b"\xff\xd8\xff":
        raise DataError(
            "is a JPEG, not RAW: its tone curve hides how long a target stayed; set the camera to RAW", file=path
        )
    if magic == PNG_MAGIC:
        frame = _grey_frame(path, read_png(path), FileTags(is_raw=False))
    else:
        tags = read_tags(path) if magic[:4] in TIFF_LIKE else FileTags(is_raw=True)
        frame = _raw(path, tags) if tags.is_raw else _grey_frame(path, read_tiff(path, tags), tags)
    if expect_size is not None and frame.size != tuple(expect_size):
        raise DataError(
            f"is {frame.size[0]}x{frame.size[1]} pixels, but image_size says {expect_size[0]}x{expect_size[1]}: "
            "another camera's file, or image_size is not that of the visible RAW area",
            file=path,
        )
    return check_frame(frame)


def check_frame(frame: RawFrame) -> RawFrame:
    """The frame with what its values show of sensor and file: ceilings, rows that were never written.

    A frame whose values are no counts is returned as it is.

    Raises
    ------
    DataError
        It is declared grey, but is a colour sensor's mosaic.
    """
    if frame.values.dtype != np.uint16:
        return frame
    values = np.asarray(frame.values, dtype=np.uint16)
    if frame.channels == 1:
        refuse_mosaic(frame.path, values)
    empty = empty_rows(values)
    if empty.any():
        masked = np.repeat(empty[:, None], values.shape[1], axis=1)
        frame = replace(frame, masked=masked, notes=(empty_note(frame.path, empty),))
    ceilings_dn = find_ceilings(values, frame.pattern)
    if frame.is_raw:
        tops_dn = np.minimum(ceilings_dn, frame.white_level)
        ceilings_dn = np.minimum(ceilings_dn, find_knees(values, frame.pattern, float(frame.black.mean()), tops_dn))
    notes = frame.notes + uniform_note(frame.path, values)
    return replace(frame, ceilings_dn=ceilings_dn, notes=notes)


def _magic(path: Path) -> bytes:
    try:
        check_plain_file(path)
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
    problem, unpacked = "", None
    with captured_stderr() as printed:
        try:
            with rawpy.imread(str(path)) as raw:
                pattern = _pattern(path, raw)
                values = np.array(raw.raw_image_visible, dtype=np.uint16)
                unpacked = pattern, values, _black(raw, tags, pattern), _white(raw)
        except rawpy.LibRawError as exc:
            text = exc.args[0].decode() if exc.args and isinstance(exc.args[0], bytes) else str(exc)
            problem = text[:1].lower() + text[1:]
        except (MemoryError, ValueError, OSError) as exc:  # sizes in a damaged header may be anything
            problem = str(exc) or type(exc).__name__
    if unpacked is None:
        raise DataError(f"LibRaw cannot read it ({' '.join(problem.split())}); {_likely_reason(tags)}", file=path)
    if printed.reports_damage:
        raise DataError("the file is truncated or damaged: its pixels cannot all be decoded; fetch it again", file=path)
    pattern, values, black, white = unpacked
    if path.stat().st_size * PIXELS_A_BYTE < values.size:
        raise DataError(
            f"the file is truncated: {path.stat().st_size} bytes hold no {values.shape[1]}x{values.shape[0]} pixels; "
            "fetch it again",
            file=path,
        )
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
        is_raw=True,
    )


def _likely_reason(tags: FileTags) -> str:
    """What to do about a file that LibRaw refuses: a compression that it does not know is no damage."""
    if tags.compression in (1, LOSSLESS_JPEG):
        return "it is damaged or not a RAW file"
    name = COMPRESSIONS.get(tags.compression, f"compression {tags.compression}")
    return (
        f"its pixels are compressed by {name}: set camera or converter to lossless or no compression, or it is damaged"
    )


def _white(raw: rawpy.RawPy) -> float:
    """White level as the file states it, DN."""
    white = float(raw.white_level)
    linear = raw.camera_white_level_per_channel
    if linear is not None and min(linear) > 0.5 * white:  # smaller ones are makers' tags misread
        white = min(white, float(min(linear)))
    return white


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
    if sorted(channel for row in cell for channel in row) not in ([0, 1, 2, 3], [0, 1, 1, 2]) or cell[0] == cell[1]:
        raise DataError("has a colour filter that is not a Bayer mosaic; a Bayer or grey sensor is needed", file=path)
    return np.array(cell, dtype=np.uint8)


def _black(raw: rawpy.RawPy, tags: FileTags, pattern: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Black level from the file's own tags where it has them, else LibRaw's, one a channel.

    LibRaw averages patterns larger than 2 x 2, and makes margins even without shifting the pattern.
    """
    sizes = raw.sizes
    if tags.black is not None:
        return tags.black.over(sizes.top_margin, sizes.left_margin, sizes.height, sizes.width)
    levels = np.array(raw.black_level_per_channel, dtype=np.float64)
    return levels[pattern]


def _grey_frame(path: Path, values: NDArray[Any], tags: FileTags) -> RawFrame:
    """A frame of a grey sensor, its values taken as linear from 0 to the largest that the file could hold."""
    return RawFrame(
        path=path,
        values=values.astype(np.uint16),
        pattern=np.zeros((1, 1), dtype=np.uint8),
        black=np.zeros((1, 1)),
        white_level=float(np.iinfo(values.dtype).max),
        taken_at=tags.taken_at,
    )
