"""Tables and figures of the page that are about all captures: flags with remedies, gauges, amplitude over frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from labdaemon.orbit_size import is_doubtful, size_mm
from labdaemon.report.accuracy import semi_amplitude_sd_mm
from labdaemon.report.frequency_chart import ChartPoint, Curve, frequency_svg
from labdaemon.report.gauge_comparison import GaugeComparison, summarise
from labdaemon.report.remedies import remedy

MAX_FLAGGED = 200
"""Lines of the table of flagged targets; the rest is counted."""


@dataclass(frozen=True, slots=True)
class PageGrid:
    """A table: its head, its lines, and whether the last column holds flags."""

    head: Sequence[str]
    lines: Sequence[Sequence[str]]
    flags: bool = False


class ExcitedCapture(Protocol):
    """The part of a capture's section that tables read."""

    @property
    def name(self) -> str:
        """The capture's name."""
        ...

    @property
    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Its rows of `envelope.csv`."""
        ...

    @property
    def frequency_hz(self) -> float | None:
        """Excitation frequency."""
        ...

    @property
    def table_mm(self) -> float | None:
        """Amplitude of the table."""
        ...


def number_text(value: float | None, form: str) -> str:
    """A number in a cell; a dash where there is none."""
    return "–" if value is None or math.isnan(value) else format(value, form)


def amplitude_chart(captures: Sequence[ExcitedCapture], curves: Mapping[str, Curve] | None = None) -> str | None:
    """Amplitude over frequency; per amplitude of the table where that is known for all. None for one frequency.

    Parameters
    ----------
    captures
        All of the page.
    curves
        Of a fitted model by target, per amplitude of the table; not drawn where an amplitude of the table is unknown.
    """
    driven = [capture for capture in captures if capture.frequency_hz is not None]
    is_ratio = bool(driven) and all(capture.table_mm for capture in driven)
    targets: dict[str, list[ChartPoint]] = {}
    for capture in driven:
        unit = (capture.table_mm or 1.0) if is_ratio else 1.0
        for row in capture.rows:
            size = size_mm(row)
            if size is not None and not is_doubtful(row):
                sd = semi_amplitude_sd_mm(row) or 0.0
                point = ChartPoint(capture.frequency_hz or 0.0, size / unit, sd / unit)
                targets.setdefault(str(row["target"]), []).append(point)
    return frequency_svg(targets, is_ratio=is_ratio, curves=curves if is_ratio else None)


def flagged_table(captures: Sequence[ExcitedCapture]) -> PageGrid | None:
    """Every flagged target with what to do about it; None where there is none. `at_rest` is no fault."""
    lines = [
        (
            capture.name,
            str(row["target"]),
            number_text(size_mm(row), ".4f"),
            flag,
            remedy(flag),
        )
        for capture in captures
        for row in capture.rows
        for flag in row.get("flags") or ()
        if flag != "at_rest"
    ]
    if not lines:
        return None
    more = len(lines) - MAX_FLAGGED
    shown: list[Sequence[str]] = [*lines[:MAX_FLAGGED]]
    if more > 0:
        shown.append(("…", f"{more} more", "", "", ""))
    return PageGrid(("capture", "target", "amplitude mm", "flag", "what to do"), shown, flags=True)


def gauge_tables(readings: Sequence[GaugeComparison]) -> tuple[PageGrid, PageGrid | None] | None:
    """What gauges saw, and how the image results differ from it; None without gauges."""
    if not readings:
        return None
    head = ("capture", "gauge", "mounted on", "gauge mm", "sd mm", "image mm", "sd mm", "difference mm", "remark")
    lines = [
        (
            one.capture,
            one.gauge,
            one.role,
            number_text(one.amplitude_mm, ".4f"),
            number_text(one.sd_mm, ".4f"),
            number_text(one.image_mm, ".4f"),
            number_text(one.image_sd_mm, ".4f"),
            number_text(one.difference_mm, "+.4f"),
            one.reason,
        )
        for one in readings
    ]
    compared = [
        (
            one.gauge,
            str(one.count),
            number_text(one.mean_mm, "+.4f"),
            number_text(one.sd_mm, ".4f"),
            number_text(one.p95_mm, ".4f"),
        )
        for one in summarise(readings)
    ]
    total = PageGrid(("gauge", "captures", "mean difference mm", "sd mm", "95 % within mm"), compared)
    return PageGrid(head, lines, flags=True), total if compared else None
