"""Result files: the rows of `measurements.csv` and `envelope.csv`, the same in memory, on disk and in messages."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from labdaemon.blur import Measurement
from labdaemon.correlations import CORRELATIONS, correlations_of
from labdaemon.durable import write_durably
from labdaemon.flags import Flag
from labdaemon.geometry import ObjectMotion
from labdaemon.plain_json import plain_text

Value: TypeAlias = str | float | list[str] | None
Row: TypeAlias = dict[str, Value]
"""A row by column: numbers as floats rounded as the file has them, None where empty, `flags` as a list.
JSON-able."""

_PX = ("x_px", "y_px", "ax_px", "ay_px", "bx_px", "by_px")
_MM = ("x_mm", "y_mm", "z_mm", "ax_mm", "ay_mm", "az_mm", "bx_mm", "by_mm", "bz_mm")
MEASUREMENT_COLUMNS = ("capture", "camera", "target", *_PX, *(f"sd_{name}" for name in _PX), "flags", "sign")
ENVELOPE_COLUMNS = (
    *("capture", "target", *_MM, *(f"sd_{name}" for name in _MM)),
    *("residual_ratio", "flags", "sign", *CORRELATIONS),
)
_LATER: Row = dict.fromkeys(("sign", *CORRELATIONS))
"""Columns that rows of an older journal lack."""


def _number(value: float) -> float | None:
    return round(float(value), 6) + 0.0 if math.isfinite(value) else None


def _flags(flags: Iterable[Flag]) -> list[str]:
    present = set(flags)
    return [flag.value for flag in Flag if flag in present]


def measurement_row(capture: str, camera: str, measurement: Measurement, sign: int = 0) -> Row:
    """One row of `measurements.csv`; empty numbers where the target was not measured, no sign where it is 0."""
    values = np.concatenate([measurement.centre_px, measurement.a_px, measurement.b_px])
    with np.errstate(invalid="ignore"):
        sds = np.sqrt(np.diag(measurement.covariance_px2))
    row: Row = {"capture": capture, "camera": camera, "target": measurement.target}
    row.update({name: _number(value) for name, value in zip(_PX, values, strict=True)})
    row.update({f"sd_{name}": _number(value) for name, value in zip(_PX, sds, strict=True)})
    row["flags"] = _flags(measurement.flags)
    row["sign"] = sign or None
    return row


def envelope_row(capture: str, target: str, motion: ObjectMotion | None, flags: Iterable[Flag], sign: int = 0) -> Row:
    """One row of `envelope.csv`; `motion` None where the target could not be measured, `sign` 0 where unknown."""
    nothing = np.full(9, np.nan)
    values, sds, ratio, covariance = nothing, nothing, None, np.full((9, 9), np.nan)
    if motion is not None:
        values = np.concatenate([motion.mean_mm, motion.a_mm, motion.b_mm])
        with np.errstate(invalid="ignore"):
            sds = np.sqrt(np.diag(motion.covariance_mm2))
        ratio, covariance = motion.residual_ratio, motion.covariance_mm2
    row: Row = {"capture": capture, "target": target}
    row.update({name: _number(value) for name, value in zip(_MM, values, strict=True)})
    row.update({f"sd_{name}": _number(value) for name, value in zip(_MM, sds, strict=True)})
    row["residual_ratio"] = None if ratio is None else _number(ratio)
    row["flags"] = _flags(flags)
    row["sign"] = sign or None
    row |= correlations_of(covariance)
    return row


def _cell(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return ";".join(value)
    if isinstance(value, float):
        return f"{value:.6f}"
    return plain_text(str(value))


def csv_text(columns: Sequence[str], rows: Iterable[Row]) -> str:
    """The file's text: header, one line a row, six decimals, empty where there is no number.

    Rows that a journal kept from before there were signs or correlations have none.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell((_LATER | row)[column]) for column in columns] for row in rows)
    return out.getvalue()


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write a result file whole or not at all, synced.

    Raises
    ------
    StorageError
        The folder cannot be written.
    """
    write_durably(path, csv_text(columns, rows))
