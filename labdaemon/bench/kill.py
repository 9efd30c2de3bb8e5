"""`labdaemon bench kill`: kill -9 of the daemon at every journalled transition, and at random moments.

The simulated rig runs as a process of its own, so its table moves on and its cards keep their files while the daemon is
dead. After each kill the daemon is started again at once; when the campaign has completed, the data folder is judged.
"""

from __future__ import annotations

import json
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click

from labdaemon.bench.verdict import CampaignVerdict, judge
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client import Client
from labdaemon.testing.free_port import free_address

TRANSITIONS = (
    "step.started",
    "capture.intended",
    "capture.fired",
    "capture.exposed",
    "frame.stored",
    "capture.completed",
    "envelope",
    "step.completed",
)
"""Every transition that each capture goes through."""

ONCE = ("campaign.queued", "campaign.started", "campaign.completed")
"""Those that a campaign goes through once."""

CAMPAIGN = """
name = "kill"
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
[[phase]]
kind = "steps"
frequency_hz = {{ start = 4, stop = 14, count = {captures} }}
amplitude_mm = 0.5
exposure_s = 0.25
settle = {{ timeout_s = 0.3 }}
"""

END_S = 900.0  # for all restarts together, each of which takes half a minute on a busy machine


@dataclass(slots=True)
class KillOutcome:
    """Outcome of a campaign whose daemon was killed.

    Attributes
    ----------
    kills
        How often the daemon was killed.
    rest_s
        Seconds from each restart until the table was at rest.
    """

    label: str
    kills: int = 0
    rest_s: list[float] = field(default_factory=list)
    verdict: CampaignVerdict = field(default_factory=CampaignVerdict)


class DaemonUnderTest:
    """A daemon process and the rig it drives.

    Parameters
    ----------
    rig
        A running simulated rig.
    folder
        For config, data and ledger.
    gauges
        Whether the rig file names the rig's gauges; without them settling is a fixed wait.
    """

    def __init__(self, rig: Any, folder: Path, *, gauges: bool = False) -> None:
        self.rig: Any = rig
        self.folder: Path = folder
        self.data: Path = folder / "data"
        self.commands: str = free_address()
        self.config: Path = rig.write_files(folder, events=free_address(), commands=self.commands, data=str(self.data))
        text = self.config.read_text()
        if not gauges:  # then nothing can see the enable line stop the table either
            text = without_gauges(text).replace("[interlocks]\n", "[interlocks]\naccept_no_enable = true\n")
        self.config.write_text(text + "\n[processing]\nworkers = 1\n")
        self.process: subprocess.Popen[str]

    def start(self, transition: str = "") -> float | None:
        """Start it, and wait until it serves or has died; seconds until the table was at rest."""
        ledger = self.folder / "ledger.txt"
        command = [sys.executable, "-m", "labdaemon.bench.kill_child", self.config, self.data, transition, ledger]
        began = time.monotonic()
        with (self.folder / "daemon.log").open("a") as log:
            self.process = subprocess.Popen(
                [str(part) for part in command], stdout=subprocess.PIPE, stderr=log, text=True
            )
        rest_s: float | None = None
        while rest_s is None and self.process.poll() is None and time.monotonic() - began < 30.0:
            if not self.rig.table()["moving"]:
                rest_s = time.monotonic() - began
            time.sleep(0.005)
        assert self.process.stdout is not None
        self.process.stdout.readline()
        return rest_s

    def submit(self, captures: int) -> None:
        """Submit the campaign, once, however often this is called."""
        try:
            with Client(self.commands, timeout_s=10.0) as client:
                client.call("campaign.submit", toml=CAMPAIGN.format(captures=captures), request_id="the one")
        except LabdaemonError:
            return  # it was killed meanwhile

    def is_complete(self) -> bool:
        """Whether the campaign has completed, by the journal on disk."""
        if not (self.data / "journal.db").exists():
            return False
        try:
            with sqlite3.connect(f"file:{self.data / 'journal.db'}?mode=ro", uri=True) as journal:
                states = [row[0] for row in journal.execute("SELECT state FROM campaigns")]
            journal.close()
        except sqlite3.OperationalError:  # the daemon has not made its tables yet
            return False
        return states == ["completed"]

    def end(self) -> None:
        """Ask it to end."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self._reap()

    def kill(self) -> None:
        """Kill -9."""
        self.process.kill()
        self._reap()

    def _reap(self) -> None:
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


def run_campaign(
    rig: Any, folder: Path, captures: int, *, transition: str = "", moments: int = 0, seed: int = 0
) -> KillOutcome:
    """Walk one campaign through all its kills, and judge what is left.

    Parameters
    ----------
    transition
        Kill at this transition, once in each step.
    moments
        Instead, kill at so many random moments.
    """
    source = random.Random(seed)
    daemon, outcome = DaemonUnderTest(rig, folder), KillOutcome(transition or "random moments")
    taken_before = len(rig.truth())
    end = time.monotonic() + END_S
    while not daemon.is_complete() and time.monotonic() < end:
        rest_s = daemon.start(transition)
        if outcome.kills and rest_s is not None:
            outcome.rest_s.append(rest_s)
        daemon.submit(captures)
        until = time.monotonic() + source.uniform(0.0, 6.0) if outcome.kills < moments else float("inf")
        while daemon.process.poll() is None and not daemon.is_complete() and time.monotonic() < min(until, end):
            time.sleep(0.02)
        if daemon.is_complete() and daemon.process.poll() is None:
            daemon.end()
        else:
            daemon.kill()
        outcome.kills += daemon.process.returncode == -signal.SIGKILL
    daemon.end()
    if outcome.kills and not daemon.is_complete():
        outcome.label += " (not completed in time)"
    taken = len(rig.truth()) - taken_before
    on_cards = sum(len(files) for files in rig.control.ask("cards").values())
    outcome.verdict = judge(daemon.data, taken=taken, on_cards=on_cards, captures=captures)
    return outcome


def without_gauges(toml: str) -> str:
    """A rig file without its gauges: settling is then a fixed wait."""
    kept, skipping = [], False
    for line in toml.splitlines():
        if line.startswith("["):
            skipping = line.startswith("[[gauge]]")
        if not skipping:
            kept.append(line)
    return "\n".join(kept)


@contextmanager
def small_rig(seed: int, *, enable_wired: bool = True) -> Iterator[Any]:
    """A simulated rig in a process of its own, with frames that cost nothing."""
    [entry] = entry_points(group="labdaemon.simulators", name="rig")
    with entry.load()(seed=seed, small=True, enable_wired=enable_wired) as rig:
        yield rig


def table_of(outcomes: list[KillOutcome]) -> str:
    """The table that the README quotes."""
    heads = ["killed at", "kills", "frames lost", "results repeated", "missing"]
    heads += ["leftover .part", "seq gaps", "open", "slowest rest"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for outcome in outcomes:
        verdict, slowest_s = outcome.verdict, max(outcome.rest_s, default=0.0)
        lines.append(
            f"| {outcome.label} | {outcome.kills} | {verdict.frames_lost} | {verdict.results_repeated} | "
            f"{verdict.results_missing} | {verdict.stray_parts} | {verdict.seq_gaps} | {verdict.open_ends} | "
            f"{slowest_s:.2f} s |"
        )
    return "\n".join(lines)


@click.command("kill")
@click.option("--captures", type=click.IntRange(1), default=20, show_default=True, help="Steps of each campaign.")
@click.option("--at", "chosen", multiple=True, metavar="TRANSITION", help="Only these; may be given again.")
@click.option("--before", is_flag=True, help="Kill just before each commit as well.")
@click.option("--moments", type=click.IntRange(0), default=20, show_default=True, help="Kills at random moments.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(captures: int, chosen: tuple[str, ...], before: bool, moments: int, seed: int, as_json: bool) -> None:
    """Kill the daemon at every journalled transition, and look what is lost."""
    names = list(chosen or (*ONCE, *TRANSITIONS))
    if before:
        names += [f"before {name}" for name in names]
    outcomes: list[KillOutcome] = []
    for number, name in enumerate([*names, ""]):
        if not name and not moments:
            continue
        folder = Path(tempfile.mkdtemp(prefix="labdaemon-kill-"))
        try:
            with small_rig(seed + number) as rig:
                outcome = run_campaign(
                    rig, folder, captures, transition=name, moments=0 if name else moments, seed=seed
                )
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        outcomes.append(outcome)
        click.echo(f"{outcome.label}: {outcome.kills} kills, {outcome.verdict}", err=True)
    if as_json:
        click.echo(json.dumps([_plain(outcome) for outcome in outcomes]))
    else:
        click.echo(table_of(outcomes))
    if not all(outcome.verdict.is_well for outcome in outcomes):
        raise SystemExit(1)


def _plain(outcome: KillOutcome) -> dict[str, Any]:
    counts = {name: getattr(outcome.verdict, name) for name in CampaignVerdict.__dataclass_fields__}
    return {
        "killed_at": outcome.label,
        "kills": outcome.kills,
        "slowest_rest_s": max(outcome.rest_s, default=0.0),
        **counts,
    }
