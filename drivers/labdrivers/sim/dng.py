"""A RAW file such as a camera leaves: a 16-bit CFA DNG that LibRaw opens, pixel for pixel what was read out."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from typing import IO

import numpy as np
import tifffile

from labdrivers.sim.scene import Mosaic

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_CFA, _LINEAR_RAW, _GREY = 32803, 34892, 1


def write_dng(
    file: Path | str | IO[bytes],
    mosaic: Mosaic,
    pattern: str = "RGGB",
    black: int = 0,
    white: int = 4095,
    *,
    model: str = "NIKON D80",
    serial: str = "",
    captured_at: str = "2026:01:01 00:00:00",
    exposure_s: float = 1.0,
    f_number: float = 32.0,
    iso: int = 100,
) -> None:
    """Write a mosaic as an uncompressed DNG.

    Parameters
    ----------
    mosaic
        (h, w) uint16 as read out, black level included.
    pattern
        Colours of the top left 2 × 2 pixels, row by row; ``GRAY`` for a sensor without a mosaic.
    black, white
        Levels that the file declares.
    model, serial, captured_at, exposure_s, f_number, iso
        What the camera says of itself and of the exposure; `captured_at` as ``YYYY:MM:DD HH:MM:SS``.
    """
    exposure = Fraction(exposure_s).limit_denominator(100_000)
    aperture = Fraction(f_number).limit_denominator(100)
    grey = pattern == "GRAY"
    tags: list[tuple[int, int, int, object, bool]] = [
        (271, _ASCII, 0, model.partition(" ")[0], True),
        (272, _ASCII, 0, model, True),
        (33434, _RATIONAL, 1, (exposure.numerator, exposure.denominator), True),
        (33437, _RATIONAL, 1, (aperture.numerator, aperture.denominator), True),
        (34855, _SHORT, 1, iso, True),
        (36867, _ASCII, 0, captured_at, True),
        (50706, _BYTE, 4, (1, 4, 0, 0), True),
        (50707, _BYTE, 4, (1, 1, 0, 0), True),
        (50708, _ASCII, 0, model, True),
        (50714, _SHORT, 1, black, True),
        (50717, _LONG, 1, white, True),
    ]
    if serial:
        tags.append((50735, _ASCII, 0, serial, True))
    if not grey:
        colours = bytes("RGB".index(letter) for letter in pattern)
        unit = [value for row in np.eye(3, dtype=int) for number in row for value in (int(number), 1)]
        tags += [
            (33421, _SHORT, 2, (2, 2), True),
            (33422, _BYTE, 4, colours, True),
            (50710, _BYTE, 3, (0, 1, 2), True),
            (50711, _SHORT, 1, 1, True),
            (50713, _SHORT, 2, (1, 1), True),
            (50721, _SRATIONAL, 9, tuple(unit), True),
            (50728, _RATIONAL, 3, (1, 2, 1, 1, 1, 2), True),
            (50778, _SHORT, 1, 21, True),
        ]
    memory = io.BytesIO()
    tifffile.imwrite(
        memory,
        np.ascontiguousarray(mosaic, dtype=np.uint16),
        photometric=_GREY if grey else _CFA,
        planarconfig=None,
        rowsperstrip=mosaic.shape[0],
        datetime=captured_at,
        metadata=None,
        extratags=sorted(tags, key=lambda tag: tag[0]),
    )
    if grey:
        # A sensor without a mosaic is "linear raw" with one sample, which tifffile will not write in one go.
        memory.seek(0)
        with tifffile.TiffFile(memory, mode="r+") as written:
            written.pages.first.tags[262].overwrite(_LINEAR_RAW)
    if isinstance(file, (str, Path)):
        Path(file).write_bytes(memory.getvalue())
    else:
        file.write(memory.getvalue())
