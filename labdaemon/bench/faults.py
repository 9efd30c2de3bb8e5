"""`labdaemon bench faults`: every fault of every simulated device, met by the running daemon in mid-campaign.

Each fault comes once for a moment (the campaign must go on by itself) and once for good (the campaign must go on in
spite of it, or stop with the table at rest, and complete once the fault is over). What does neither in time hangs.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import click

from labdaemon.bench.kill import Victim, small_rig
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client import Client

DEVICES = ("shaker", "trigger", "gauge-table", "gauge-response", "left")

CAMPAIGN = """
name = "faults"
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
[[phase]]
kind = "steps"
frequency_hz = [6.0, 7.0, 9.0]
amplitude_mm = 0.5
exposure_s = 0.25
settle = {{ max_change_per_cycle = 0.05, timeout_s = 15 }}
on_fault = "{on_fault}"
"""

INTERLOCKS = """
camera_timeout_s = 5.0
"""

MODERATE_S = 180.0
"""Longest that a campaign of a few seconds may take through a fault before it counts as hanging."""

Ending = Literal["went on", "stopped, then went on", "ended at rest, then went on", "HANGS", "MOVES ON"]
WELL: tuple[Ending, ...] = ("went on", "stopped, then went on", "ended at rest, then went on")


@dataclass(frozen=True, slots=True)
class Met:
    """How the daemon bore a fault.

    Attributes
    ----------
    told
        What it said first, None if it noticed nothing (a fault that costs nothing needs no word).
    after_s
        Seconds from the fault to its end: completion, or the table at rest.
    """

    device: str
    fault: str
    lasting: bool
    ending: Ending
    told: str | None
    after_s: float


class Patient:
    """A daemon that is made to meet faults."""

    def __init__(self, rig: Any, folder: Path) -> None:
        self._victim, self._rig = Victim(rig, folder, gauges=True), rig
        text = self._victim.config.read_text()
        self._victim.config.write_text(text.replace("[interlocks]", "[interlocks]" + INTERLOCKS))

    def meet(self, device: str, fault: str, *, lasting: bool) -> Met:
        """One fault, from a running campaign to its end."""
        self._up()
        while self._ask("status")["campaign"] is not None:  # what the last one left
            self._ask("campaign.abort")
            time.sleep(0.5)
        seq = self._ask("status")["seq"]
        campaign = self._ask("campaign.submit", toml=CAMPAIGN.format(on_fault="pause" if lasting else "retry"))
        self._wait(lambda: self._ask("status")["step"] == 1 and self._rig.table()["moving"], 60.0)
        began = time.monotonic()
        self._rig.inject(device, fault, count=None if lasting else 1)
        state = self._until_over(campaign["campaign"])
        after_s = time.monotonic() - began
        told = self._first_fault(seq)
        if state == "completed":
            self._rig.clear()
            return Met(device, fault, lasting, "went on", told, after_s)
        if not self._wait(lambda: not self._rig.table()["moving"], 10.0):
            return Met(device, fault, lasting, "MOVES ON", told, after_s)
        ended = state == "gone"
        self._rig.clear()
        if state is None:
            self._victim.kill()
            return Met(device, fault, lasting, "HANGS", told, after_s)
        self._up()
        if self._ask("status")["state"] == "paused":
            self._ask("campaign.resume")
        if self._until_over(campaign["campaign"], again=True) != "completed":
            self._victim.kill()
            return Met(device, fault, lasting, "HANGS", told, after_s)
        return Met(
            device, fault, lasting, "ended at rest, then went on" if ended else "stopped, then went on", told, after_s
        )

    def close(self) -> None:
        """End the daemon."""
        self._victim.end()

    def _up(self) -> None:
        process = getattr(self._victim, "process", None)
        while process is None or process.poll() is not None:
            self._victim.start()
            process = self._victim.process

    def _ask(self, method: str, **params: Any) -> Any:
        with Client(self._victim.commands, timeout_s=20.0) as client:
            return client.call(method, **params)

    def _first_fault(self, seq: int) -> str | None:
        try:
            events = self._ask("events.replay", after=seq)["events"]
        except LabdaemonError:
            return None
        told = [str(event["data"]["message"]) for event in events if event["kind"] == "fault"]
        return told[0] if told else None

    def _until_over(self, campaign: str, *, again: bool = False) -> str | None:
        """``completed``, ``paused``, ``gone`` with the daemon, or None past the time."""
        end = time.monotonic() + MODERATE_S
        while time.monotonic() < end:
            if self._victim.process.poll() is not None:
                return "gone"
            status = self._ask("status")
            if status["campaign"] is None:
                return "completed"
            if status["state"] == "paused" and status["doing"] == "paused":
                if not again:
                    return "paused"
                time.sleep(1.0)
                self._ask("campaign.resume")
            time.sleep(0.05)
        return None

    @staticmethod
    def _wait(condition: Any, timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if condition():
                return True
            time.sleep(0.05)
        return False


def table_of(met: list[Met]) -> str:
    """The table that the README quotes: kinds a device, and how they ended."""
    heads = ["device", "faults", "went on", "stopped at rest, then went on", "hang or move on", "slowest"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for device in dict.fromkeys(one.device for one in met):
        mine = [one for one in met if one.device == device]
        on = sum(one.ending == "went on" for one in mine)
        bad = sum(one.ending not in WELL for one in mine)
        slowest_s = max(one.after_s for one in mine)
        kinds = len({one.fault for one in mine})
        lines.append(
            f"| {device} | {kinds} × {len(mine) // kinds} | {on} | {len(mine) - on - bad} | {bad} | {slowest_s:.0f} s |"
        )
    return "\n".join(lines)


def _line(met: Met) -> str:
    how = "lasting" if met.lasting else "once"
    return f"{met.device} {met.fault} ({how}): {met.ending} after {met.after_s:.1f} s; {met.told or 'no word'}"


@click.command("faults")
@click.option("--device", "devices", multiple=True, type=click.Choice(DEVICES), help="Only these.")
@click.option("--fault", "faults", multiple=True, metavar="FAULT", help="Only these.")
@click.option("--once/--no-once", default=True, show_default=True, help="Let each fault come once, for a moment.")
@click.option("--lasting/--no-lasting", default=True, show_default=True, help="Let each fault come for good.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print every case as JSON.")
def command(
    devices: tuple[str, ...], faults: tuple[str, ...], once: bool, lasting: bool, seed: int, as_json: bool
) -> None:
    """Let the daemon meet every fault of every device."""
    met: list[Met] = []
    for device in devices or DEVICES:
        folder = Path(tempfile.mkdtemp(prefix="labdaemon-faults-"))
        try:
            with small_rig(seed) as rig:
                patient = Patient(rig, folder)
                try:
                    for fault in rig.control.ask("faults")[device]:
                        if faults and fault not in faults:
                            continue
                        for stays in [False] * once + [True] * lasting:
                            met.append(patient.meet(device, fault, lasting=stays))
                            click.echo(_line(met[-1]), err=True)
                finally:
                    patient.close()
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    click.echo(json.dumps([asdict(one) for one in met]) if as_json else table_of(met))
    if any(one.ending not in WELL for one in met):
        raise SystemExit(1)
