"""What stops the table, as pure checks: limits and an observation in, a `Violation` or None out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labdaemon.capture.devices import CameraStatus
from labdaemon.flags import Flag
from labdaemon.orbit_size import is_doubtful, size_mm

DOUBTFUL_TO_TRIP = 3
"""Flagged targets beyond the limit that trip together: a wrong fit is one target's, a motion its neighbours' too."""

_Size = tuple[str, float]


@dataclass(frozen=True, slots=True)
class InterlockLimits:
    """When to stop. None switches a check off.

    Attributes
    ----------
    max_response_mm
        Semi-amplitude of the structure, by a gauge or by an envelope.
    max_response_rate_mm_s
        How fast that may grow.
    gauge_disagreement
        Relative difference between the table's amplitude as set and as read.
    max_paper_edge
        Share of an envelope's targets whose smear may reach the edge of its paper.
    worker_stall_s
        How long the oldest waiting measurement may take.
    """

    max_response_mm: float | None = None
    max_response_rate_mm_s: float | None = None
    gauge_disagreement: float | None = 0.2
    min_battery_percent: int = 10
    min_card_bytes: int = 200_000_000
    min_disk_bytes: int = 1_000_000_000
    max_paper_edge: float | None = 0.1
    camera_timeout_s: float = 30.0
    worker_stall_s: float = 1800.0


@dataclass(frozen=True, slots=True)
class Violation:
    """A crossed limit.

    Attributes
    ----------
    limit
        Name of the limit, as in the rig file's section ``[interlocks]``.
    message
        What was seen, for a person.
    """

    limit: str
    message: str

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True, slots=True)
class GaugeSample:
    """The structure's semi-amplitude as a gauge read it, at a monotonic time."""

    at_s: float
    amplitude_mm: float
    sd_mm: float = 0.0


def check_response(limits: InterlockLimits, now: GaugeSample, before: GaugeSample | None) -> Violation | None:
    """Too large an answer, or one that grows too fast. A growth within three sd of the readings is noise."""
    if limits.max_response_mm is not None and now.amplitude_mm > limits.max_response_mm:
        return Violation(
            "max_response_mm",
            f"the structure moves {now.amplitude_mm:.3g} mm, more than max_response_mm = {limits.max_response_mm:g}",
        )
    if limits.max_response_rate_mm_s is None or before is None or now.at_s <= before.at_s:
        return None
    growth_mm = now.amplitude_mm - before.amplitude_mm
    rate = growth_mm / (now.at_s - before.at_s)
    if rate > limits.max_response_rate_mm_s and growth_mm > 3.0 * (now.sd_mm**2 + before.sd_mm**2) ** 0.5:
        return Violation(
            "max_response_rate_mm_s",
            f"the structure's motion grows by {rate:.3g} mm/s, more than max_response_rate_mm_s = "
            f"{limits.max_response_rate_mm_s:g}",
        )
    return None


def check_table(limits: InterlockLimits, asked_mm: float, read: GaugeSample) -> Violation | None:
    """The table gauge reads another amplitude than was set."""
    if limits.gauge_disagreement is None:
        return None
    off_mm = abs(read.amplitude_mm - asked_mm)
    if off_mm <= max(limits.gauge_disagreement * asked_mm, 3.0 * read.sd_mm):
        return None
    return Violation(
        "gauge_disagreement", f"the table gauge reads {read.amplitude_mm:.3g} mm where {asked_mm:.3g} mm was set"
    )


def check_camera(limits: InterlockLimits, camera: str, status: CameraStatus) -> Violation | None:
    """An empty battery or a full card; what a body does not report is not judged."""
    if status.battery_percent is not None and status.battery_percent < limits.min_battery_percent:
        return Violation(
            "min_battery_percent",
            f"{camera}: battery at {status.battery_percent} %, less than {limits.min_battery_percent} %; charge it",
        )
    if status.free_bytes is not None and status.free_bytes < limits.min_card_bytes:
        return Violation(
            "min_card_bytes", f"{camera}: {status.free_bytes / 1e6:.0f} MB free on its card; empty or replace it"
        )
    return None


def check_envelope(limits: InterlockLimits, rows: Iterable[Mapping[str, Any]]) -> Violation | None:
    """The measured envelope is too large, or smears reach the edges of their papers.

    A target without a flag trips alone. Flagged ones are in doubt: `DOUBTFUL_TO_TRIP` of them trip together, and an
    `ambiguous` one, which may be another orbit's, only where no target is without a flag.
    """
    measured = list(rows)
    targets = len(measured)
    at_edge = sum(Flag.PAPER_EDGE in (row.get("flags") or ()) for row in measured)
    if limits.max_response_mm is not None:
        sure, doubtful = _too_large(limits.max_response_mm, measured)
        if sure:
            name, size = sure[0]
            return Violation(
                "max_response_mm",
                f"target {name} moves {size:.3g} mm, more than max_response_mm = {limits.max_response_mm:g}",
            )
        if len(doubtful) >= DOUBTFUL_TO_TRIP:
            name, size = doubtful[0]
            return Violation(
                "max_response_mm",
                f"{len(doubtful)} flagged targets move more than max_response_mm = {limits.max_response_mm:g}, "
                f"{name} by {size:.3g} mm",
            )
    if limits.max_paper_edge is not None and targets and at_edge > limits.max_paper_edge * targets:
        return Violation(
            "max_paper_edge",
            f"the smear of {at_edge} of {targets} targets reaches the edge of its paper; lower the amplitude",
        )
    return None


def _too_large(limit_mm: float, rows: Sequence[Mapping[str, Any]]) -> tuple[list[_Size], list[_Size]]:
    """Targets beyond the limit, largest first: those without a flag, and flagged ones that count."""
    sizes = [(row, str(row.get("target")), size) for row in rows if (size := size_mm(row)) is not None]
    has_sure = any(not is_doubtful(row) for row, _, _ in sizes)
    sure: list[_Size] = []
    doubtful: list[_Size] = []
    for row, name, size in sorted(sizes, key=lambda one: -one[2]):
        if size <= limit_mm:
            break
        if not is_doubtful(row):
            sure.append((name, size))
        elif not (has_sure and Flag.AMBIGUOUS in (row.get("flags") or ())):
            doubtful.append((name, size))
    return sure, doubtful


def check_workers(limits: InterlockLimits, oldest_waiting_s: float) -> Violation | None:
    """Workers make no progress."""
    if oldest_waiting_s <= limits.worker_stall_s:
        return None
    return Violation(
        "worker_stall_s", f"a capture has waited {oldest_waiting_s:.0f} s to be measured; look at the worker processes"
    )
