"""Progress of a campaign on a terminal: one live line, and a line for everything that happened above it.

Where the output is no terminal (a log, a pipe) only the lines are printed, and no heartbeat.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import click
from rich.console import Console
from rich.live import Live
from rich.text import Text

from labdaemon.orbit_size import largest_motion

BAR_CELLS = 10  # ten per cent each, which is as much as a glance reads
SILENT_S = 3.0
"""A heartbeat comes each second. From this age on what is shown is said to be old; a person knows within 5 s."""


def duration(seconds: float | None) -> str:
    """`1:02:03` or `2:03`; a dash where it is not known."""
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
    manual = status.get("captures_manual")
    if status.get("captures_total"):
        lines.append(f"captures   {status.get('captures', 0)} of {status['captures_total']}")
    if manual:
        lines.append(f"manual     {manual} captures outside the plan")
    if status.get("captures_expected"):
        lines.append(f"expected   {status['captures_expected']} captures wait for the next release")
    if status.get("left_s") is not None:
        lines.append(f"time left  {duration(status['left_s'])}")
    if largest := _largest(status):
        lines.append(f"largest    {largest}")
    for name, why in (status.get("waiting_for") or {}).items():
        lines.append(f"waits for  {name}: {why.removeprefix(f'{name}: ')}")
    if status.get("table"):
        seen = "; USE THE EMERGENCY STOP IF IT MOVES" if status["table"] == "unconfirmed" else ""
        lines.append(f"table      {status['table']}{seen}")
    if status.get("enable_line") not in (None, "proven"):
        accepted = ", accepted by the rig file" if status.get("accept_no_enable") else ""
        lines.append(f"line       enable line not proven ({status['enable_line']}){accepted}")
    if status.get("faults"):
        lines.append(f"faults     {status['faults']}")
    if status.get("queue"):
        lines.append(f"waiting    {status['queue']} campaigns")
    if status.get("rig"):
        lines.append(f"rig        {status['rig']}")
        lines.append(f"data       {status.get('data')}")
        lines.append(f"daemon     process {status.get('pid')} on {status.get('host')}")
    return lines


def _largest(status: dict[str, Any]) -> str:
    """`0.411 mm at T07; 1 doubtful`: doubtful targets never lead, and are never left out; empty if nothing is known."""
    target = f" at {status['largest_target']}" if status.get("largest_target") else ""
    parts = [f"{status['largest_mm']:.3f} mm{target}"] if status.get("largest_mm") is not None else []
    if status.get("doubtful"):
        of = "" if parts or status.get("doubtful_mm") is None else f", up to {status['doubtful_mm']:.3f} mm"
        parts.append(f"{status['doubtful']} doubtful{of}")
    return "; ".join(parts)


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
        case "step.decided":
            return f"decided    {_decision(data)}"
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


def _decision(data: dict[str, Any]) -> str:
    """The next step of a search for modes with its reason, or its end with the modes found."""
    where = excitation(data) if data.get("frequency_hz") is not None else "no further step"
    found = ", ".join(f"{mode['frequency_hz']:.4f} ± {mode['sd_frequency_hz']:.4f}" for mode in data.get("modes", ()))
    known = f"; modes at {found} Hz" if found else "; no mode yet"
    return f"{where}: {data.get('reason', '')}{known}"


def _envelope(data: dict[str, Any]) -> str:
    targets = data.get("targets", [])
    motion = largest_motion(targets)
    flagged = sum(bool(target.get("flags")) for target in targets)
    parts = [f"{motion.measured} of {len(targets)} targets", f"{flagged} flagged" if flagged else "", motion.text()]
    return ", ".join(part for part in parts if part)


class Progress:
    """Shows events as they come.

    The live line is drawn anew by a thread of its own, so that the age of what it shows grows even while this process
    waits for an answer.

    Parameters
    ----------
    plain
        No live line even on a terminal.
    to_stderr
        Lines go to stderr, where stdout carries JSON.
    monotonic
        Seconds of a clock that never jumps.
    """

    def __init__(
        self, *, plain: bool = False, to_stderr: bool = False, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._console = Console(highlight=False)
        self._monotonic, self._to_stderr = monotonic, to_stderr
        self._heard_s = monotonic()
        self._is_silent = False
        self._live: Live | None = None
        self._status: dict[str, Any] = {}
        if self._console.is_terminal and not plain:
            self._live = Live(console=self._console, refresh_per_second=4, transient=True, get_renderable=self._bar)

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
        self.note_heartbeat()
        if event["kind"] == "status":
            self._status = event["data"]
        line = event_line(event)
        if line is not None:
            self._print(line, event["at"][11:19])
        if self._live is not None:
            self._live.refresh()

    def note_heartbeat(self) -> None:
        """Note that the daemon gave a sign of life."""
        if self._is_silent:
            self._print(f"HEARD      the daemon again, after {self._age_s():.0f} s")
            self._is_silent = False
        self._heard_s = self._monotonic()

    def check_silence(self) -> None:
        """Report a silence, once; to be called about every second while nothing comes."""
        if not self._is_silent and self._age_s() >= SILENT_S:
            self._is_silent = True
            self._print(f"SILENT     no heartbeat for {self._age_s():.0f} s: what is shown above is as old, or older")
        if self._live is not None:
            self._live.refresh()

    def _age_s(self) -> float:
        return self._monotonic() - self._heard_s

    def _print(self, line: str, stamp: str | None = None) -> None:
        """A line above the live one, with the daemon's time, or without a stamp where it is this process' own."""
        stamp = stamp or "--:--:--"
        if self._live is None:
            click.echo(f"{stamp} {line}", err=self._to_stderr)
            return
        style = "bold red" if line.startswith(("FAULT", "SILENT")) else ""
        self._console.print(Text.assemble((f"{stamp} ", "dim"), (line, style)), soft_wrap=True)

    def _bar(self) -> Text:
        """The live line: state, captures, what is shaking, time left, largest amplitude, faults."""
        status = self._status
        done, total = status.get("captures") or 0, status.get("captures_total") or 0
        line = Text(no_wrap=True, overflow="ellipsis")
        age_s = self._age_s()
        if age_s >= SILENT_S:
            line.append(f"SILENT for {duration(age_s)}", style="bold red").append(", last known: ", style="dim")
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
        if largest := _largest(status):
            parts.append(f"largest {largest}")
        for part in parts:
            if part:
                line.append(" · ", style="dim").append(part)
        return line
