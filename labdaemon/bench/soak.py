"""`labdaemon bench soak`: days of campaign in simulated time, through hundreds of faults, with memory watched.

The engine, the journal and all that lies between are the real ones; the devices are `labdaemon.testing.rig`, which
fail at random as they are ordered to. Every frame that a fake camera takes is accounted for in the end.
"""

from __future__ import annotations

import gc
import logging
import os
import random
import resource
import shutil
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import click

from labdaemon.bench.verdict import CampaignVerdict, judge
from labdaemon.campaign.interlock_monitor import PollIntervals
from labdaemon.campaign.retry import RetryPolicy
from labdaemon.clock import SimulatedClock
from labdaemon.journal import records
from labdaemon.testing.lab import FakeLab
from labdaemon.testing.rig import FaultKind

OPERATIONS: dict[str, tuple[FaultKind, ...]] = {
    "shaker.set": ("gone", "rubbish", "refused", "silent", "slow"),
    "shaker.state": ("gone", "rubbish", "silent"),
    "shaker.stop": ("gone", "rubbish", "refused", "silent"),
    "trigger.fire": ("gone", "rubbish", "refused", "silent"),
    "trigger.heartbeat": ("gone", "rubbish", "silent"),
    "left.wait_file": ("gone", "rubbish", "silent", "unexpected_file"),
    "right.wait_file": ("gone", "rubbish", "silent", "unexpected_file"),
    "left.download": ("gone", "torn", "rubbish", "silent"),
    "right.download": ("gone", "torn", "rubbish", "silent"),
    "left.delete": ("gone", "silent"),
    "left.configure": ("gone", "refused"),
    "left.files": ("gone", "slow"),
    "right.release": ("lost_file",),
    "response.read": ("gone", "rubbish", "silent"),
    "table.read": ("gone", "rubbish"),
}
"""What may fail, and how."""

DWELLS_HZ = (4.2, 5.0, 6.3, 8.0, 12.0)
SWEEP_STEPS = 100  # of one campaign; as many campaigns follow one another as captures are asked for

RESUME_S = 300.0
"""How long a paused campaign waits for the person who resumes it."""


@dataclass(frozen=True, slots=True)
class SoakResult:
    """Figures of a soak.

    Attributes
    ----------
    memory_mb, descriptors
        At a tenth of the way, and at the end.
    """

    hours: float
    captures: int
    faults: int
    kinds: int
    restarts: int
    resumed: int
    memory_mb: tuple[float, float]
    descriptors: tuple[int, int]
    seconds: float
    verdict: CampaignVerdict


def campaign(captures: int, hours: float) -> str:
    """Half of the captures in dwells that fill the hours, half in sweeps; sharp sets retaken every four hours."""
    dwells = captures // 2 // len(DWELLS_HZ)
    sweep = min(SWEEP_STEPS, max(captures // 2, 2))
    hold_s = max((hours * 3600.0 - 7.0 * captures) / (dwells * len(DWELLS_HZ)), 1.0)
    phases = ['name = "soak"', '[[phase]]\nkind = "sharp"\nframes = 2\nevery_s = 14400']
    for frequency_hz in DWELLS_HZ:
        phases.append(
            f'[[phase]]\nkind = "dwell"\nfrequency_hz = {frequency_hz}\namplitude_mm = 0.5\nexposure_s = 1.0\n'
            f"hold_s = {hold_s:.1f}\nrepeats = {dwells}"
        )
    phases.append(
        f'[[phase]]\nkind = "sweep"\nfrequency_hz = {{ start = 4, stop = 14, count = {sweep}, spacing = "log" }}\n'
        f"amplitude_mm = 0.5\nexposure_s = 1.0\nrepeats = {max(captures // 2 // sweep, 1)}"
    )
    return "\n".join(phases)


def soak(data: Path, *, captures: int, hours: float, faults: int, restarts: int = 20, seed: int = 1) -> SoakResult:
    """Run it.

    Parameters
    ----------
    data
        Where to; best in memory.
    captures, hours
        The campaign's length.
    faults
        How many are injected, at random places and times.
    restarts
        How often the engine is dropped and begun again from the journal.
    """
    clock, source, began = SimulatedClock(), random.Random(seed), time.monotonic()
    fault_every_s, restart_every_s = hours * 3600.0 / (1.2 * faults), hours * 3600.0 / (restarts + 1)

    async def run() -> SoakResult:
        lab = FakeLab(data, clock, policy=RetryPolicy(max_tries=8, intervals=PollIntervals(1.0, 1.0, 10.0, 60.0)))
        lab.start()
        id = await lab.submit(campaign(captures, hours))
        injected: Counter[str] = Counter()
        resumed = restarted = 0
        next_fault_s, next_restart_s = fault_every_s, restart_every_s
        early: tuple[float, int] | None = None
        while True:
            await clock.sleep(10.0)
            record = records.campaign(lab.journal, id)
            if record is None or record.state in ("completed", "failed", "aborted"):
                break
            if record.state == "paused":
                await clock.sleep(RESUME_S)
                await lab.engine.resume()
                resumed += 1
            if clock.monotonic() >= next_fault_s:
                operation = source.choice(list(OPERATIONS))
                kind = source.choice(OPERATIONS[operation])
                lab.world.fail(operation, kind)
                injected[f"{operation} {kind}"] += 1
                next_fault_s += source.expovariate(1.0 / fault_every_s)
            if clock.monotonic() >= next_restart_s:
                await lab.kill()
                lab.start()
                restarted += 1
                next_restart_s += restart_every_s
            if early is None and clock.monotonic() > 360.0 * hours:
                early = footprint()
        late = footprint()
        done = sum(records.captures_by_step(lab.journal, id).values())
        await lab.kill()
        cameras = lab.fake.cameras
        verdict = judge(
            data,
            taken=sum(len(camera.made) for camera in cameras),
            on_cards=sum(len(camera.card) for camera in cameras),
            captures=len([step for step in lab.plan(record.toml).steps if step.kind != "sharp"]) if record else 0,
            has_files=False,
        )
        first = early or late
        return SoakResult(
            hours=clock.monotonic() / 3600.0,
            captures=done,
            faults=lab.world.faults_met,
            kinds=len(injected),
            restarts=restarted,
            resumed=resumed,
            memory_mb=(first[0], late[0]),
            descriptors=(first[1], late[1]),
            seconds=time.monotonic() - began,
            verdict=verdict,
        )

    return clock.run(run())


def footprint() -> tuple[float, int]:
    """Resident memory of this process, megabytes, and its open descriptors."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6, len(os.listdir("/proc/self/fd"))


@click.command("soak")
@click.option("--captures", type=click.IntRange(20), default=10_000, show_default=True)
@click.option("--hours", type=click.FloatRange(0.1), default=72.0, show_default=True)
@click.option("--faults", type=click.IntRange(1), default=500, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
def command(captures: int, hours: float, faults: int, seed: int) -> None:
    """Run a campaign for days in simulated time, through hundreds of faults."""
    logging.getLogger("labdaemon").addHandler(logging.NullHandler())  # faults are what this is about
    data = Path(tempfile.mkdtemp(prefix="labdaemon-soak-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None))
    try:
        result = soak(data, captures=captures, hours=hours, faults=faults, seed=seed)
    finally:
        shutil.rmtree(data, ignore_errors=True)
    click.echo(table_of(result))
    if not result.verdict.is_well:
        raise SystemExit(1)


def table_of(result: SoakResult) -> str:
    """The table that the README quotes."""
    verdict = result.verdict
    rows = {
        "simulated": f"{result.hours:.1f} h in {result.seconds:.0f} s",
        "captures": result.captures,
        "faults met": f"{result.faults} of {result.kinds} kinds",
        "restarts from the journal": result.restarts,
        "pauses that a person ended": result.resumed,
        "memory at a tenth, at the end": f"{result.memory_mb[0]:.1f} MB, {result.memory_mb[1]:.1f} MB",
        "descriptors": f"{result.descriptors[0]}, {result.descriptors[1]}",
        "frames lost": verdict.frames_lost,
        "results repeated, missing": f"{verdict.results_repeated}, {verdict.results_missing}",
        "leftover .part, seq gaps, open ends": f"{verdict.stray_parts}, {verdict.seq_gaps}, {verdict.open_ends}",
    }
    return "\n".join(["| soak | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])
