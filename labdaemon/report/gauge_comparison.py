"""Gauges and photographs compared: what each gauge saw, and the image results of the targets that it stands for.

The paper compares a laser with the image in this way (McCarthy 2016, Fig. 13).
"""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from labdaemon.errors import DataError
from labdaemon.orbit_size import is_doubtful, size_mm
from labdaemon.report.accuracy import semi_amplitude_sd_mm


@dataclass(frozen=True, slots=True)
class GaugeComparison:
    """What a gauge saw during a capture.

    Attributes
    ----------
    capture, gauge, role
        Names; role is "table", "response" or "".
    amplitude_mm, sd_mm
        Zero to peak; None where it saw nothing, for which `reason` gives the cause.
    image_mm, image_sd_mm
        Mean amplitude of the targets that the gauge stands for, and its sd; None where there are none.
    """

    capture: str
    gauge: str
    role: str
    amplitude_mm: float | None
    sd_mm: float | None
    reason: str = ""
    image_mm: float | None = None
    image_sd_mm: float | None = None

    @property
    def difference_mm(self) -> float | None:
        """Image minus gauge."""
        if self.image_mm is None or self.amplitude_mm is None:
            return None
        return self.image_mm - self.amplitude_mm


@dataclass(frozen=True, slots=True)
class GaugeSummary:
    """Differences, image minus gauge, over the captures of a gauge: number, mean, sd, and what 95 % keep; mm."""

    gauge: str
    count: int
    mean_mm: float
    sd_mm: float
    p95_mm: float


def read_gauges(
    path: Path, envelopes: Mapping[str, Sequence[Mapping[str, Any]]], stands_for: Mapping[str, Sequence[str]]
) -> list[GaugeComparison]:
    """Rows of `gauges.csv` with the image results next to them; empty where there is no such file.

    Parameters
    ----------
    path
        The file.
    envelopes
        Rows of `envelope.csv` by capture.
    stands_for
        Patterns of target names by gauge (rig file, `stands_for`).

    Raises
    ------
    DataError
        The file is no such table.
    """
    if not path.is_file():
        return []
    readings = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line in csv.DictReader(file):
                rows = envelopes.get(line["capture"], ())
                image = _image(rows, stands_for.get(line["gauge"], ()))
                readings.append(
                    GaugeComparison(
                        line["capture"],
                        line["gauge"],
                        line.get("role") or "",
                        _number(line.get("amplitude_mm")),
                        _number(line.get("sd_amplitude_mm")),
                        line.get("reason") or "",
                        *image,
                    )
                )
    except (KeyError, ValueError, OSError, csv.Error) as exc:  # UnicodeDecodeError is a ValueError
        raise DataError(f"is no table of gauges ({exc}); `labdaemon process` writes it anew", file=path) from None
    return readings


def summarise(readings: Sequence[GaugeComparison]) -> list[GaugeSummary]:
    """One summary per gauge that was compared with targets."""
    differences: dict[str, list[float]] = {}
    for reading in readings:
        if reading.difference_mm is not None:
            differences.setdefault(reading.gauge, []).append(reading.difference_mm)
    return [
        GaugeSummary(
            gauge,
            len(values),
            statistics.fmean(values),
            statistics.stdev(values) if len(values) > 1 else math.nan,
            sorted(abs(value) for value in values)[max(math.ceil(0.95 * len(values)) - 1, 0)],
        )
        for gauge, values in differences.items()
    ]


def _image(rows: Sequence[Mapping[str, Any]], patterns: Sequence[str]) -> tuple[float | None, float | None]:
    seen = [
        (size, semi_amplitude_sd_mm(row) or 0.0)
        for row in rows
        if any(fnmatchcase(str(row["target"]), pattern) for pattern in patterns)
        and not is_doubtful(row)
        and (size := size_mm(row)) is not None
    ]
    if not seen:
        return None, None
    return statistics.fmean(size for size, _ in seen), math.sqrt(sum(sd**2 for _, sd in seen)) / len(seen)


def _number(text: str | None) -> float | None:
    value = float(text) if text else math.nan
    return value if math.isfinite(value) else None
