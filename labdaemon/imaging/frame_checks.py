"""What a decoded frame shows of its file: pixels that were never written, and a mosaic that is declared grey."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError

PERIODS = (2, 4, 6)
"""Sides of the colour filters in use: Bayer, Quad Bayer, X-Trans."""
LARGEST_MISMATCH = 0.02
"""Relative difference of brightness between the places of a cell that no grey sensor has."""
LEAST_SIGNIFICANCE = 8.0
"""Standard errors of the difference above which it is no accident of the scene."""
SAMPLED_CELLS = 20_000  # spread over the frame: as good as all of it, in a hundredth of the time
LEAST_CELLS = 100  # a percentile of fewer says nothing
LEAST_ROWS = 2
"""Rows of zeros below which a frame is left alone."""


def empty_rows(values: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """(h,) True for rows of a partly exposed frame that hold zeros alone; False throughout for a frame without light.

    A sensor's rows hold noise. Rows of zeros were never written: the power went, or a card was pulled, while the file
    was being copied, and its length is right all the same.
    """
    height, width = values.shape
    empty: NDArray[np.bool_] = np.logical_not(values[:, :: max(1, width // 64)].any(axis=1))
    for row in np.flatnonzero(empty):
        empty[row] = not values[row].any()
    if np.count_nonzero(empty) < LEAST_ROWS or empty.all():
        return np.zeros(height, dtype=np.bool_)
    return empty


def empty_note(path: Path, empty: NDArray[np.bool_]) -> str:
    """One line about a frame's empty rows."""
    rows = np.flatnonzero(empty)
    return (
        f"{path}: {len(rows)} of {len(empty)} rows are zero ({rows[0]} to {rows[-1]}): the file is incomplete and "
        "nothing is measured there; fetch it again"
    )


def uniform_note(path: Path, values: NDArray[np.uint16]) -> tuple[str, ...]:
    """One line about a frame whose pixels all have one value, which no sensor's noise leaves; nothing about another."""
    first = values.flat[0]
    if values.size == 1 or values[0, -1] != first or (values != first).any():
        return ()
    return (
        f"{path}: all its pixels are {first}: it was not decoded, was never written, or shows neither light nor noise; "
        "fetch it again",
    )


def refuse_mosaic(path: Path, values: NDArray[Any]) -> None:
    """Refuse a colour sensor's mosaic that was saved as a grey image.

    Raises
    ------
    DataError
        The places of a 2 x 2, 4 x 4 or 6 x 6 cell differ in brightness all over the frame, in both directions.
    """
    for period in PERIODS:
        mismatch = _mismatch(values, period)
        if mismatch > LARGEST_MISMATCH:
            raise DataError(
                f"is the mosaic of a colour sensor saved as grey (pixels of a {period} x {period} cell differ by "
                f"{100 * mismatch:.0f} %); give the camera's RAW file",
                file=path,
            )


def _mismatch(values: NDArray[Any], period: int) -> float:
    """Largest relative difference between places of a cell, less its uncertainty; 0 where it is along one axis only.

    Sensors with several outputs have columns or rows of unequal gain; a colour filter differs along both.
    """
    cells = _cells(values, period)
    if cells.size < LEAST_CELLS * period**2:
        return 0.0
    mean = cells.mean(axis=(1, 3))
    bright = (mean > np.median(mean)) & (cells.min(axis=(1, 3)) < float(cells.max()))
    if np.count_nonzero(bright) < LEAST_CELLS:
        return 0.0
    ratio = cells.transpose(0, 2, 1, 3)[bright] / mean[bright][:, None, None]
    level = np.median(ratio, axis=0)
    spread = 1.4826 * float(np.median(np.abs(ratio - level)))
    error = LEAST_SIGNIFICANCE * 1.2533 * spread / np.sqrt(np.count_nonzero(bright))
    rows, columns = level.mean(axis=1, keepdims=True), level.mean(axis=0, keepdims=True)
    along_both = min(float(np.ptp(rows)), float(np.ptp(columns)))
    joint = float(np.ptp(level - rows - columns))
    return max(float(np.ptp(level)) - error, 0.0) if max(along_both, joint) - error > LARGEST_MISMATCH else 0.0


def _cells(values: NDArray[Any], period: int) -> NDArray[np.float64]:
    """(rows, period, columns, period) cells from all over the frame."""
    height, width = (side // period for side in values.shape)
    step = max(1, int(np.sqrt(height * width / SAMPLED_CELLS)))
    whole = values[: height * period, : width * period].reshape(height, period, width, period)
    return whole[::step, :, ::step, :].astype(np.float64)
