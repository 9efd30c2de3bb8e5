"""Plain arrays as frames, with a clear error where something is missing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdaemon.errors import UsageError
from labdaemon.imaging import RawFrame, check_frame, read_frame

FrameLike: TypeAlias = "str | PathLike[str] | RawFrame | NDArray[np.generic]"
"""A file, a frame that was read, or an array of linear values."""

MIN_SIDE_PX = 16
"""Smaller images cannot hold a dot and the paper around it."""

BAYER_CELLS = {
    "RGGB": ((0, 1), (3, 2)),
    "BGGR": ((2, 3), (1, 0)),
    "GRBG": ((1, 0), (2, 3)),
    "GBRG": ((3, 2), (0, 1)),
}
"""Colour plane of each pixel of the repeated cell; the two greens are two planes."""


def frame_from_array(
    values: ArrayLike,
    *,
    white_level: float | None = None,
    black_level: float = 0.0,
    bayer: str | None = None,
    name: str = "array",
) -> RawFrame:
    """Make a frame from an array of linear sensor values.

    Parameters
    ----------
    values
        (h, w) values, proportional to light. No gamma, no tone curve.
    white_level
        Value at which the sensor clips. For uint8 and uint16 it defaults to the largest value of the type; a sensor of
        12 or 14 bits in uint16 needs its own (4095, 16383).
    black_level
        Value without light.
    bayer
        "RGGB", "BGGR", "GRBG" or "GBRG" for a Bayer mosaic; None for grey values.
    name
        Used in messages.

    Raises
    ------
    UsageError
        The array is not a grey image or a mosaic, has values that are not finite, or its white level is missing.
    DataError
        It is a mosaic, and `bayer` does not say so.
    """
    array = np.asarray(values)
    _refuse_wrong_shape(array, name)
    if array.dtype == np.bool_ or not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
        raise UsageError(f"{name}: values of type {array.dtype} are no light; give numbers")
    if np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
        raise UsageError(f"{name}: some values are not finite; replace them or mark them as white level")
    white = _white_level(array, white_level, name)
    if not black_level < white:
        raise UsageError(f"{name}: the white level {white:g} must be larger than the black level {black_level:g}")
    pattern = np.zeros((1, 1), dtype=np.uint8)
    if bayer is not None:
        if bayer.upper() not in BAYER_CELLS:
            raise UsageError(f"{name}: bayer is one of {', '.join(BAYER_CELLS)}, not {bayer!r}")
        pattern = np.array(BAYER_CELLS[bayer.upper()], dtype=np.uint8)
    kept: NDArray[np.uint16] | NDArray[np.float32]
    kept = array.astype(np.uint16) if array.dtype in (np.uint8, np.uint16) else array.astype(np.float32)
    return check_frame(RawFrame(Path(name), kept, pattern, np.full((1, 1), float(black_level)), white))


def as_frames(source: FrameLike | Sequence[FrameLike], name: str) -> list[RawFrame]:
    """One frame or several, from whatever a caller has.

    Raises
    ------
    DataError
        A file cannot be read.
    UsageError
        There is no frame, or an array is not usable.
    """
    if isinstance(source, (str, PathLike, RawFrame, np.ndarray)):
        return [_as_frame(source, name)]
    if not isinstance(source, Iterable):
        raise UsageError(f"{name}: a {type(source).__name__} is no frame; give a path, a frame or a numpy array")
    sources = list(source)
    if not sources:
        raise UsageError(f"{name}: no frame was given")
    return [_as_frame(one, f"{name}[{index}]") for index, one in enumerate(sources)]


def _as_frame(source: FrameLike, name: str) -> RawFrame:
    if isinstance(source, RawFrame):
        return source
    if isinstance(source, (str, PathLike)):
        return read_frame(Path(source))
    if isinstance(source, np.ndarray):
        return frame_from_array(source, name=name)
    raise UsageError(f"{name}: a {type(source).__name__} is no frame; give a path, a frame or a numpy array")


def _refuse_wrong_shape(array: NDArray[np.generic], name: str) -> None:
    if array.ndim == 3:
        raise UsageError(
            f"{name}: shape {array.shape} looks like a colour image; give linear grey values (h, w), or the Bayer "
            "mosaic through labdaemon.frame_from_array(values, bayer=…)"
        )
    if array.ndim != 2 or min(array.shape) < MIN_SIDE_PX:
        raise UsageError(f"{name}: shape {array.shape} is no image; give (h, w) of at least {MIN_SIDE_PX} px a side")


def _white_level(array: NDArray[np.generic], white_level: float | None, name: str) -> float:
    if white_level is not None:
        return float(white_level)
    if array.dtype in (np.uint8, np.uint16):
        return 255.0 if array.dtype == np.uint8 else 65535.0
    raise UsageError(
        f"{name}: the white level of {array.dtype} values is not known; give it by "
        "labdaemon.frame_from_array(values, white_level=…)"
    )
