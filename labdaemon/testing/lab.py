"""Campaigns in memory, for simulated time: a measurer that reads the fake frames, and the whole lab around it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.engine import Engine
from labdaemon.campaign.interlocks import InterlockLimits
from labdaemon.campaign.limits import ShakerLimits
from labdaemon.campaign.measurement_queue import CaptureRows, MeasurementQueue
from labdaemon.campaign.plan import PlanRig, make_plan
from labdaemon.campaign.retry import RetryPolicy
from labdaemon.campaign.steps import Plan
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.lamp import Lamp
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.table import Table
from labdaemon.capture.table_monitor import TableMonitor
from labdaemon.capture.table_observer import EnableLineProof
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DataError, SetupError, StorageError
from labdaemon.journal import records
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import CampaignRecord, CampaignState
from labdaemon.testing.lamp import give_lamp
from labdaemon.testing.rig import FakeRig, FakeWorld, fake_rig

ENDED: tuple[CampaignState, ...] = ("completed", "aborted", "failed", "paused")


@dataclass(slots=True)
class FakeMeasurer:
    """One target a frame, whose row reports what the fake cameras wrote.

    Attributes
    ----------
    measure_s
        Time that one measurement takes.
    refusal
        Message with which every capture is refused; empty to measure.
    wrong_size
        Message with which first frames are refused; empty to take them.
    unmeasurable
        Names of captures that cannot be measured.
    flags, amplitude_mm
        Given to every row.
    results
        What the result files would hold, by folder.
    refuses
        Raised instead of writing result files.
    """

    measure_s: float = 5.0
    unmeasurable: set[str] = field(default_factory=set)
    flags: tuple[str, ...] = ()
    amplitude_mm: float = 1.0
    results: dict[Path, list[str]] = field(default_factory=dict)
    refuses: StorageError | None = None
    refusal: str = ""
    wrong_size: str = ""

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> CaptureRows:
        await asyncio.sleep(self.measure_s)
        if self.refusal:
            raise DataError(self.refusal, file=folder / "sharp")
        if name in self.unmeasurable:
            raise DataError("killed its worker twice and was set aside", file=name)
        frames = [path for capture in captures for path in sorted((folder / "captures" / capture).glob("*.dng"))]
        if not frames or not list((folder / "sharp" / (sharp or "")).glob("*.dng")):
            raise DataError("has no sharp frames or no frames", file=folder / "captures" / name)
        rows = [
            {"capture": name, "target": path.stem, "ax_mm": self.amplitude_mm, "ay_mm": 0.0, "az_mm": 0.0}
            | {"flags": list(self.flags)}
            for path in frames
        ]
        return CaptureRows(rows, [{"capture": name, "camera": path.stem} for path in frames])

    async def check_frames(self, folder: Path, frames: Sequence[tuple[str, Path]]) -> None:
        if frames and self.wrong_size:
            raise SetupError(self.wrong_size)

    def write_results(self, folder: Path, results: Iterable[CaptureRows]) -> None:
        if self.refuses is not None:
            raise self.refuses
        self.results[folder] = [str(result.envelope[0]["capture"]) for result in results]

    def append_results(self, folder: Path, result: CaptureRows) -> bool:
        if self.refuses is not None:
            raise self.refuses
        if folder not in self.results:
            return False
        self.results[folder].append(str(result.envelope[0]["capture"]))
        return True

    def lacks(self, folder: Path, names: set[str], kept: str | None) -> bool:
        return not names <= set(self.results.get(folder, []))

    def stamp(self, folder: Path) -> str:
        return ""


class FakeLab:
    """An engine with everything around it in memory but the journal, which is real.

    It can be killed and started again: the world (table, cards) continues, the engine begins from the journal.

    Parameters
    ----------
    data
        The data folder; in memory (tmpfs) for long runs.
    proof
        What is known of the enable line when the engine begins.
    """

    def __init__(
        self,
        data: Path,
        clock: SimulatedClock,
        *,
        rig: FakeRig | None = None,
        limits: InterlockLimits | None = None,
        policy: RetryPolicy | None = None,
        has_trigger: bool = True,
        has_shaker: bool = True,
        proof: EnableLineProof = "proven",
        lamp: Lamp | None = None,
    ) -> None:
        self.data: Path = data
        self.clock: SimulatedClock = clock
        self.fake: FakeRig = rig or fake_rig(clock)
        if not has_shaker:  # others move the table, and hold its enable line
            self.fake.rig = replace(self.fake.rig, shaker=None)
            self.fake.world.line_wired = False
        if not has_trigger:
            self.fake.rig = replace(self.fake.rig, trigger=None, shaker=None)
        self.limits: InterlockLimits = limits or InterlockLimits()
        self.policy: RetryPolicy = policy or RetryPolicy()
        self.lamp = lamp
        if lamp is not None:
            give_lamp(self.fake)
        self.free_bytes: int = 10**12
        self.proof = proof
        self.exposures_s: dict[str, tuple[float, ...]] = dict.fromkeys(self.fake.rig.cameras, (0.5, 1.0, 2.0))
        self.rig_digest: str = ""
        self.measurer: FakeMeasurer = FakeMeasurer()
        self.journal: Journal
        self.engine: Engine
        self.table_monitor: TableMonitor
        self._keeping: asyncio.Task[None]
        self._run: asyncio.Task[None] | None = None

    @property
    def world(self) -> FakeWorld:
        """The table and the structure."""
        return self.fake.world

    def start(self) -> None:
        """As the daemon does it: the table to rest, the journal opened, the engine let run."""
        self.world.drive(False, self.world.frequency_hz, self.world.amplitude_mm)
        self.journal = Journal(self.data, self.clock, synchronous="OFF")
        recorder = Recorder(self.journal, InlineExecutor("journal", lambda: 0.0))
        table = Table(self.fake.rig, self.clock, self.limits.gauge_disagreement)
        table.observer.proof = self.proof
        context = AcquisitionContext(self.fake.rig, table, recorder, self.clock, self.data, lamp=self.lamp)
        queue = MeasurementQueue(recorder, self.measurer, self.clock, self.data)
        self.engine = Engine(
            context,
            queue,
            self.plan,
            self.limits,
            folder_files={"rig.toml": "", "control.csv": ""},
            free_bytes=lambda: self.free_bytes,
            policy=self.policy,
        )
        self.table_monitor = TableMonitor(self.fake.rig, table, self.clock)
        self.table_monitor.observer = self.engine
        self._run = asyncio.create_task(self.engine.run())
        self._keeping = asyncio.create_task(self.table_monitor.run())

    def plan(self, toml: str) -> Plan:
        """A campaign's plan for this lab."""
        table = ShakerLimits(150.0, 1000.0, 20000.0, (0.5, 50.0)) if self.fake.rig.shaker is not None else None
        return make_plan(load_campaign(toml), PlanRig(table, self.exposures_s, digest=self.rig_digest, lamp=self.lamp))

    async def submit(self, toml: str) -> str:
        """Queue a campaign."""
        return await self.engine.submit(self.plan(toml))

    async def kill(self) -> None:
        """What kill -9 does to the engine, as far as one process can do that to itself: nothing is put in order."""
        if self._run is not None:
            self._run.cancel()
            self._keeping.cancel()
            await asyncio.gather(self._run, self._keeping, return_exceptions=True)
        await self.engine.queue.cancel()
        self.journal.close()
        self._run = None

    async def until(self, campaign: str, *states: CampaignState, timeout_s: float = 5e4) -> CampaignRecord:
        """Let time pass until the campaign is in one of these states (by default: has ended, or is paused).

        Raises
        ------
        TimeoutError
            It has not come to that in time.
        """
        end_s = self.clock.monotonic() + timeout_s
        while True:
            if self._run is not None and self._run.done():
                self._run.result()
            record = records.campaign(self.journal, campaign)
            if record is not None and record.state in (states or ENDED):
                return record
            if self.clock.monotonic() > end_s:
                raise TimeoutError(f"{campaign} is {record.state if record else 'unknown'} after {timeout_s:g} s")
            await self.clock.sleep(1.0)
