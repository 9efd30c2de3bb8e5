"""Progress of a campaign on a terminal: one live line, and a line for everything that happened above it.

Where the output is no terminal (a log, a pipe) only the lines are printed, and no heartbeat.
"""

from __future__ import annotations

import math
from types import TracebackType
from typing import Any, Self

import click
from rich.console import Console
from rich.live import Live
from rich.text import Text

BAR_CELLS = 10


def amplitude_mm(target: dict[str, Any]) -> float | None:
    """Largest distance of a target from its mean, from a row of an envelope; None if it was not measured.

    The major semi-axis of the orbit a·sin + b·cos: the root of the larger eigenvalue of aaᵀ + bbᵀ.
    """
    if any(target.get(f"a{axis}_mm") is None for axis in "xyz"):
        return None
    a = [float(target[f"a{axis}_mm"]) for axis in "xyz"]
    b = [float(target.get(f"b{axis}_mm") or 0.0) for axis in "xyz"]
    aa, bb, ab = _dot(a, a), _dot(b, b), _dot(a, b)
    return math.sqrt((aa + bb) / 2 + math.hypot((aa - bb) / 2, ab))


def _dot(one: list[float], other: list[float]) -> float:
    return sum(x * y for x, y in zip(one, other, strict=True))


def duration(seconds: float | None) -> str:
    """`1:02:03` or `2:03`; a dash when nobody knows."""
    if seconds is None:
        return "–"
    whole = round(max(seconds, 0.0))
    hours, minutes, rest = whole // 3600, whole // 60 % 60, whole % 60
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def excitation(data: dict[str, Any]) -> str:
    """`8 Hz, 1 mm`, as far as it is known."""
    parts = []
    if data.get("frequency_hz") is not None:
        parts.append(f"{data['frequency_hz']:.5g} Hz")
    amplitude = data.get("amplitude_mm", data.get("excitation_amplitude_mm"))
    if amplitude is not None:
        parts.append(f"{amplitude:.3g} mm")
    return ", ".join(parts)


def status_lines(status: dict[str, Any]) -> list[str]:
    """The daemon's status for people, a line each."""
    lines = [f"state      {status.get('state', 'unknown')}"]
    if status.get("campaign"):
        name = f" ({status['name']})" if status.get("name") else ""
        lines.append(f"campaign   {status['campaign']}{name}")
    if status.get("step") is not None:
        total = f" of {status['steps']}" if status.get("steps") else ""
        what = ", ".join(part for part in (status.get("label"), excitation(status), status.get("doing")) if part)
        lines.append(f"step       {status['step'] + 1}{total}: {what}")
    if status.get("captures_total"):
        lines.append(f"captures   {status.get('captures', 0)} of {status['captures_total']}")
    if status.get("left_s") is not None:
        lines.append(f"time left  {duration(status['left_s'])}")
    if status.get("largest_mm") is not None:
        lines.append(f"largest    {status['largest_mm']:.3f} mm")
    if status.get("faults"):
        lines.append(f"faults     {status['faults']}")
    if status.get("queue"):
        lines.append(f"waiting    {status['queue']} campaigns")
    return lines


def event_line(event: dict[str, Any]) -> str | None:
    """What happened, in a line; None for what is not worth one."""
    data, kind = event["data"], event["kind"]
    match kind:
        case "status":
            return None
        case "envelope":
            return f"envelope   {data.get('capture')}: {_envelope(data)}"
        case "capture.completed":
            return f"capture    {data.get('capture')}"
        case "step.started":
            what = ", ".join(part for part in (str(data.get("label", data.get("step"))), excitation(data)) if part)
            return f"step       {what}"
        case "step.completed":
            return None
        case "step.skipped":
            return f"skipped    {data.get('label', data.get('step'))}: {data.get('reason', '')}".rstrip(": ")
        case "fault":
            message, device = str(data.get("message", "")), data.get("device")
            named = message if not device or message.startswith(f"{device}:") else f"{device}: {message}"
            action = f" ({data['action']})" if data.get("action") else ""
            return f"FAULT      {named}{action}"
        case _:
            reason = f": {data['reason']}" if data.get("reason") else ""
            return f"{kind.partition('.')[2] or kind:<10} campaign {event.get('campaign') or ''}{reason}"


def _envelope(data: dict[str, Any]) -> str:
    targets = data.get("targets", [])
    sizes = [(size, target["target"]) for target in targets if (size := amplitude_mm(target)) is not None]
    flagged = sum(bool(target.get("flags")) for target in targets)
    text = f"{len(sizes)} of {len(targets)} targets"
    if flagged:
        text += f", {flagged} flagged"
    if sizes:
        largest, name = max(sizes)
        text += f", largest {largest:.3f} mm at {name}"
    return text


class Progress:
    """Shows events as they come.

    Parameters
    ----------
    plain
        No live line even on a terminal.
    """

    def __init__(self, *, plain: bool = False) -> None:
        self._console = Console(highlight=False)
        self._live: Live | None = None
        self._status: dict[str, Any] = {}
        if self._console.is_terminal and not plain:
            self._live = Live(console=self._console, refresh_per_second=4, transient=True)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, event: dict[str, Any]) -> None:
        """Show one message of the events socket."""
        if event["kind"] == "status":
            self._status = event["data"]
        line = event_line(event)
        if line is not None:
            stamp = event["at"][11:19]
            if self._live is None:
                click.echo(f"{stamp} {line}")
            else:
                style = "bold red" if line.startswith("FAULT") else ""
                self._console.print(Text.assemble((f"{stamp} ", "dim"), (line, style)), soft_wrap=True)
        if self._live is not None:
            self._live.update(self._bar())

    def _bar(self) -> Text:
        """The live line: state, captures, what is shaking, time left, largest amplitude, faults."""
        status = self._status
        done, total = status.get("captures") or 0, status.get("captures_total") or 0
        line = Text(no_wrap=True, overflow="ellipsis")
        line.append(str(status.get("state", "…")), style="bold")
        if total:
            full = BAR_CELLS * min(done, total) // total
            line.append(" ").append("━" * full, style="green").append("━" * (BAR_CELLS - full), style="dim")
            line.append(f" {done}/{total}")
        if status.get("faults"):
            line.append(" · ", style="dim").append(f"{status['faults']} faults", style="bold red")
        parts = [excitation(status), status.get("doing")]
        if status.get("left_s") is not None:
            parts.append(f"{duration(status['left_s'])} left")
        if status.get("largest_mm") is not None:
            parts.append(f"largest {status['largest_mm']:.3f} mm")
        for part in parts:
            if part:
                line.append(" · ", style="dim").append(part)
        return line
