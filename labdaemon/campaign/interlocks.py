"""What stops the table, as pure checks: limits and an observation in, a reason or None out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from labdaemon.capture.devices import CameraStatus
from labdaemon.flags import Flag


@dataclass(frozen=True, slots=True)
class Limits:
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
    worker_stall_s: float = 300.0


@dataclass(frozen=True, slots=True)
class Sighting:
    """The structure's semi-amplitude as a gauge read it, at a monotonic time."""

    at_s: float
    amplitude_mm: float
    sd_mm: float = 0.0


def response_reason(limits: Limits, now: Sighting, before: Sighting | None) -> str | None:
    """Too large an answer, or one that grows too fast. A growth within three sd of the readings is noise."""
    if limits.max_response_mm is not None and now.amplitude_mm > limits.max_response_mm:
        return f"the structure moves {now.amplitude_mm:.3g} mm, more than max_response_mm = {limits.max_response_mm:g}"
    if limits.max_response_rate_mm_s is None or before is None or now.at_s <= before.at_s:
        return None
    growth_mm = now.amplitude_mm - before.amplitude_mm
    rate = growth_mm / (now.at_s - before.at_s)
    if rate > limits.max_response_rate_mm_s and growth_mm > 3.0 * (now.sd_mm**2 + before.sd_mm**2) ** 0.5:
        return (
            f"the structure's motion grows by {rate:.3g} mm/s, more than max_response_rate_mm_s = "
            f"{limits.max_response_rate_mm_s:g}"
        )
    return None


def table_reason(limits: Limits, asked_mm: float, read: Sighting) -> str | None:
    """The table gauge reads another amplitude than was set."""
    if limits.gauge_disagreement is None:
        return None
    off_mm = abs(read.amplitude_mm - asked_mm)
    if off_mm <= max(limits.gauge_disagreement * asked_mm, 3.0 * read.sd_mm):
        return None
    return f"the table gauge reads {read.amplitude_mm:.3g} mm where {asked_mm:.3g} mm was set"


def camera_reason(limits: Limits, camera: str, status: CameraStatus) -> str | None:
    """An empty battery or a full card; what a body does not tell is not judged."""
    if status.battery_percent is not None and status.battery_percent < limits.min_battery_percent:
        return f"{camera}: battery at {status.battery_percent} %, less than {limits.min_battery_percent} %; charge it"
    if status.free_bytes is not None and status.free_bytes < limits.min_card_bytes:
        return f"{camera}: {status.free_bytes / 1e6:.0f} MB free on its card; empty or replace it"
    return None


def disk_reason(limits: Limits, free_bytes: int) -> str | None:
    """The disk is nearly full."""
    if free_bytes >= limits.min_disk_bytes:
        return None
    return f"{free_bytes / 1e6:.0f} MB free on the data disk, less than {limits.min_disk_bytes / 1e6:.0f} MB"


def envelope_reason(limits: Limits, rows: Iterable[Mapping[str, Any]]) -> str | None:
    """The measured envelope is too large, or smears reach the edges of their papers."""
    targets = at_edge = 0
    for row in rows:
        targets += 1
        at_edge += Flag.PAPER_EDGE in (row.get("flags") or ())
        major = [row.get(f"a{axis}_mm") for axis in "xyz"]
        if limits.max_response_mm is None or any(value is None for value in major):
            continue
        size_mm = sum(float(value or 0.0) ** 2 for value in major) ** 0.5
        if size_mm > limits.max_response_mm:
            return f"target {row.get('target')} moves {size_mm:.3g} mm, more than max_response_mm"
    if limits.max_paper_edge is not None and targets and at_edge > limits.max_paper_edge * targets:
        return f"the smear of {at_edge} of {targets} targets reaches the edge of its paper; lower the amplitude"
    return None


def stall_reason(limits: Limits, oldest_waiting_s: float) -> str | None:
    """Workers make no progress."""
    if oldest_waiting_s <= limits.worker_stall_s:
        return None
    return f"a capture has waited {oldest_waiting_s:.0f} s to be measured; look at the worker processes"
