"""Drive level to millimetres: measured at some frequencies, interpolated between them, never beyond.

An electrodynamic shaker's displacement for a volt at the generator falls roughly as a power of the frequency (constant
force: as 1/f²), so the interpolation is straight in log-log.
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from labdaemon.errors import ConfigError, LimitError
from labdrivers.settings import DriverSettings

CSV_HEADER = ("frequency_hz", "mm_per_v")


class DrivePoint(DriverSettings):
    """Amplitude of the table (mm) for each volt at the generator, both zero to peak, at one frequency."""

    frequency_hz: float = Field(gt=0)
    mm_per_v: float = Field(gt=0)


class DriveTable:
    """The calibration of a shaker.

    Parameters
    ----------
    points
        At least one; a single one holds at its own frequency only.
    key
        Path in the rig file, for messages.
    """

    def __init__(self, points: Sequence[DrivePoint], *, key: str = "drive") -> None:
        ordered = sorted(points, key=lambda point: point.frequency_hz)
        self._key = key
        self._log_f = [math.log(point.frequency_hz) for point in ordered]
        self._log_gain = [math.log(point.mm_per_v) for point in ordered]
        if not ordered:
            raise ConfigError("the drive table is empty; calibrate the shaker", key=key)
        if any(b - a < 1e-9 for a, b in zip(self._log_f, self._log_f[1:], strict=False)):
            raise ConfigError("two drive points at one frequency; keep one", key=key)

    def mm_per_v(self, frequency_hz: float) -> float:
        """Interpolated gain; raises `LimitError` outside the calibrated range."""
        x = math.log(frequency_hz)
        low, high = self._log_f[0], self._log_f[-1]
        if not low - 1e-9 <= x <= high + 1e-9:
            raise LimitError(
                f"the drive table is calibrated from {math.exp(low):g} to {math.exp(high):g} Hz, not at "
                f"{frequency_hz:g} Hz; calibrate there first",
                key=self._key,
            )
        if len(self._log_f) == 1:
            return math.exp(self._log_gain[0])
        right = min(max(bisect_right(self._log_f, x), 1), len(self._log_f) - 1)
        x0, x1 = self._log_f[right - 1], self._log_f[right]
        y0, y1 = self._log_gain[right - 1], self._log_gain[right]
        return math.exp(y0 + (y1 - y0) * (x - x0) / (x1 - x0))


def read_drive_csv(file: Path) -> list[DrivePoint]:
    """Read a calibration, ``frequency_hz,mm_per_v`` with a header; further columns are ignored.

    Raises
    ------
    ConfigError
        The file is missing, or a line of it is no point; the message names the line.
    """
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as exc:
        raise ConfigError(f"calibration cannot be read: {exc}", source=file) from exc
    points = []
    for number, row in enumerate(rows, start=2):
        try:
            point = DrivePoint(frequency_hz=float(row["frequency_hz"]), mm_per_v=float(row["mm_per_v"]))
        except (KeyError, TypeError, ValueError) as exc:
            raise ConfigError(
                f"line {number} is no calibration point; write a header {','.join(CSV_HEADER)} and positive numbers",
                source=file,
            ) from exc
        points.append(point)
    return points
