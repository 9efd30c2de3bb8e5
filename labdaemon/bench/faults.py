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

from labdaemon.bench.kill import DaemonUnderTest, small_rig
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
class FaultOutcome:
    """What a fault made the daemon do.

    Attributes
    ----------
    message
        Message of its first fault event, None if it published none (a fault that costs nothing needs none).
    after_s
        Seconds from the fault to its end: completion, or the table at rest.
    """

    device: str
    fault: str
    lasting: bool
    ending: Ending
    message: str | None
    after_s: float


class FaultTrial:
    """A daemon with a simulated rig, into which faults are injected one after the other."""

    def __init__(self, rig: Any, folder: Path) -> None:
        self._daemon, self._rig = DaemonUnderTest(rig, folder, gauges=True), rig
        text = self._daemon.config.read_text()
        self._daemon.config.write_text(text.replace("[interlocks]", "[interlocks]" + INTERLOCKS))

    def run_fault(self, device: str, fault: str, *, lasting: bool) -> FaultOutcome:
        """Inject one fault into a running campaign and wait for the campaign's end."""
        self._ensure_running()
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
        message = self._first_fault(seq)
        if state == "completed":
            self._rig.clear()
            return FaultOutcome(device, fault, lasting, "went on", message, after_s)
        if not self._wait(lambda: not self._rig.table()["moving"], 10.0):
            return FaultOutcome(device, fault, lasting, "MOVES ON", message, after_s)
        ended = state == "gone"
        self._rig.clear()
        if state is None:
            self._daemon.kill()
            return FaultOutcome(device, fault, lasting, "HANGS", message, after_s)
        self._ensure_running()
        if self._ask("status")["state"] == "paused":
            self._ask("campaign.resume")
        if self._until_over(campaign["campaign"], again=True) != "completed":
            self._daemon.kill()
            return FaultOutcome(device, fault, lasting, "HANGS", message, after_s)
        ending: Ending = "ended at rest, then went on" if ended else "stopped, then went on"
        return FaultOutcome(device, fault, lasting, ending, message, after_s)

    def close(self) -> None:
        """End the daemon."""
        self._daemon.end()

    def _ensure_running(self) -> None:
        process = getattr(self._daemon, "process", None)
        while process is None or process.poll() is not None:
            self._daemon.start()
            process = self._daemon.process

    def _ask(self, method: str, **params: Any) -> Any:
        with Client(self._daemon.commands, timeout_s=20.0) as client:
            return client.call(method, **params)

    def _first_fault(self, seq: int) -> str | None:
        try:
            events = self._ask("events.replay", after=seq)["events"]
        except LabdaemonError:  # the daemon has ended, as some faults make it: it reports nothing any more
            return None
        messages = [str(event["data"]["message"]) for event in events if event["kind"] == "fault"]
        return messages[0] if messages else None

    def _until_over(self, campaign: str, *, again: bool = False) -> str | None:
        """``completed``, ``paused``, ``gone`` with the daemon, or None past the time."""
        end = time.monotonic() + MODERATE_S
        while time.monotonic() < end:
            if self._daemon.process.poll() is not None:
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


def table_of(outcomes: list[FaultOutcome]) -> str:
    """The table that the README quotes: kinds a device, and how they ended."""
    heads = ["device", "faults", "went on", "stopped at rest, then went on", "hang or move on", "slowest"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for device in dict.fromkeys(one.device for one in outcomes):
        mine = [one for one in outcomes if one.device == device]
        on = sum(one.ending == "went on" for one in mine)
        bad = sum(one.ending not in WELL for one in mine)
        slowest_s = max(one.after_s for one in mine)
        kinds = len({one.fault for one in mine})
        lines.append(
            f"| {device} | {kinds} × {len(mine) // kinds} | {on} | {len(mine) - on - bad} | {bad} | {slowest_s:.0f} s |"
        )
    return "\n".join(lines)


def _line(outcome: FaultOutcome) -> str:
    how = "lasting" if outcome.lasting else "once"
    message = outcome.message or "no message"
    return f"{outcome.device} {outcome.fault} ({how}): {outcome.ending} after {outcome.after_s:.1f} s; {message}"


def _document(outcome: FaultOutcome) -> dict[str, Any]:
    """For ``--json``, whose keys stay as other programs know them."""
    document = asdict(outcome)
    document["told"] = document.pop("message")
    return document


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
    """Inject every fault of every device while the daemon runs."""
    outcomes: list[FaultOutcome] = []
    for device in devices or DEVICES:
        folder = Path(tempfile.mkdtemp(prefix="labdaemon-faults-"))
        try:
            with small_rig(seed) as rig:
                trial = FaultTrial(rig, folder)
                try:
                    for fault in rig.control.ask("faults")[device]:
                        if faults and fault not in faults:
                            continue
                        for stays in [False] * once + [True] * lasting:
                            outcomes.append(trial.run_fault(device, fault, lasting=stays))
                            click.echo(_line(outcomes[-1]), err=True)
                finally:
                    trial.close()
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    click.echo(json.dumps([_document(one) for one in outcomes]) if as_json else table_of(outcomes))
    if any(one.ending not in WELL for one in outcomes):
        raise SystemExit(1)
