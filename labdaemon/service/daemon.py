"""The daemon: wires config, devices, journal, engine, stream and workers, in the order that safety asks for.

First the data folder and the sockets, which prove that no other daemon holds this rig; then the table to rest, before
anything else; then the journal, the other devices, and what a crash left. On every way out, asked for or not, the
table comes to rest first.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
import os
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from labdaemon import __version__
from labdaemon.campaign.attempts import Policy
from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.engine import Engine
from labdaemon.campaign.interlocks import Limits
from labdaemon.campaign.measuring import Measuring
from labdaemon.campaign.plan import make_plan
from labdaemon.campaign.steps import Plan
from labdaemon.capture.capture import Lab
from labdaemon.capture.lines import DeviceLine
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import Rig, bring_to_rest
from labdaemon.capture.table import Table
from labdaemon.clock import Clock, SystemClock
from labdaemon.errors import LabdaemonError
from labdaemon.journal.journal import Journal
from labdaemon.journal.storage import DataLock
from labdaemon.journal.transitions import probe
from labdaemon.processing import WorkerPool
from labdaemon.service.config import RigConfig, plan_rig
from labdaemon.service.devices import build_rig, camera_choices, connect_others, connect_stoppers, exposure_steps
from labdaemon.service.handlers import Desk, handlers
from labdaemon.service.measuring import PoolMeasurer
from labdaemon.service.status import status_of
from labdaemon.service.supervise import supervise
from labdaemon.service.watchdog import feed, notify
from labdaemon.stream.commands import CommandServer
from labdaemon.stream.events import EventPublisher

log = logging.getLogger(__name__)

INTERRUPTED = 130
TERMINATED = 0


@dataclass(frozen=True, slots=True)
class Options:
    """How a person started it.

    Attributes
    ----------
    data
        Folder for everything it writes; None for the rig file's own.
    new_journal
        Set a damaged journal aside and begin another.
    accept_changed_rig
        Go on with campaigns that were planned for another rig file.
    """

    data: Path | None = None
    new_journal: bool = False
    accept_changed_rig: bool = False


def run_daemon(
    config: RigConfig, options: Options = Options(), *, ready: Callable[[str, str], None] = lambda *_: None
) -> int:
    """Run until told to end, and return the exit status.

    Parameters
    ----------
    ready
        Called with the addresses of commands and events once both are served.

    Raises
    ------
    LabdaemonError
        It could not start, or a part of it failed for good. The table is at rest.
    """
    return asyncio.run(_Daemon(config, options, ready).run())


class _Daemon:
    """One run of the daemon."""

    def __init__(self, config: RigConfig, options: Options, ready: Callable[[str, str], None]) -> None:
        self.config, self.options, self.ready = config, options, ready
        self.clock: Clock = SystemClock()
        self.data = (options.data or config.data).resolve()
        self.rig = build_rig(config)
        self.table = Table(self.rig, self.clock, config.interlocks.gauge_disagreement)
        self.desk = Desk()
        self.exit_status: asyncio.Future[int]

    async def run(self) -> int:
        self.exit_status = asyncio.get_running_loop().create_future()
        for number, status in ((signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED)):
            asyncio.get_running_loop().add_signal_handler(number, self._end, status)
        lock = DataLock(self.data)
        commands = CommandServer(self.config.service.commands, self.desk.handlers(), self.desk)
        try:
            commands.bind()
            return await self._hold_table(lock, commands)
        finally:
            commands.close()
            lock.release()

    async def _hold_table(self, lock: DataLock, commands: CommandServer) -> int:
        """From the first word to the table until the last."""
        last_resort = _last_resort(self.rig)
        try:
            identities = await connect_stoppers(self.rig)
            rest = await bring_to_rest(self.rig, at_once=True)
            log.info("table at rest (%s)", rest.by)
            atexit.register(last_resort)
            journal = Journal(self.data, self.clock, replace_damaged=self.options.new_journal, lock=lock)
            try:
                return await self._serve(journal, commands, identities)
            finally:
                journal.close()
        finally:
            notify("STOPPING=1")
            await self._end_at_rest()
            atexit.unregister(last_resort)

    async def _serve(self, journal: Journal, commands: CommandServer, identities: dict[str, str]) -> int:
        publisher = EventPublisher(self.config.service.events, journal, lambda: status_of(engine), self.clock)
        recorder = Recorder(journal, DeviceLine("journal"), publisher.wake)
        pool = WorkerPool(self.config.processing.workers, deadline_s=self.config.processing.deadline_s)
        try:
            publisher.bind()
            identities |= await connect_others(self.rig)
            steps = await exposure_steps(self.rig)
            engine = self._engine(recorder, pool, partial(self._plan, steps=steps))
            rig = self._describe(identities, commands.address, publisher.address)
            submitted = partial(self._plan, steps=steps, check_disk=True)
            self.desk.open(handlers(engine, submitted, lambda: status_of(engine), rig), journal)
            return await self._run_parts(engine, publisher, commands, recorder)
        finally:
            publisher.close()
            pool.close()
            recorder.close()

    async def _run_parts(
        self, engine: Engine, publisher: EventPublisher, commands: CommandServer, recorder: Recorder
    ) -> int:
        parts: list[asyncio.Future[Any]] = [
            asyncio.create_task(supervise("events", publisher.run, self.clock)),
            asyncio.create_task(supervise("commands", commands.run, self.clock)),
            asyncio.create_task(engine.run()),
            asyncio.create_task(feed(self.clock, _checks(engine, recorder), _stalled)),
        ]
        self.ready(commands.address, publisher.address)
        notify(f"READY=1\nSTATUS=serving on {commands.address}")
        try:
            await asyncio.wait([*parts, self.exit_status], return_when=asyncio.FIRST_COMPLETED)
            for part in parts:
                if part.done():
                    part.result()
            return self.exit_status.result() if self.exit_status.done() else 1
        finally:
            for part in parts:
                part.cancel()
            await self._end_at_rest()
            await asyncio.gather(*parts, return_exceptions=True)
            await engine.measuring.cancel()

    def _engine(self, recorder: Recorder, pool: WorkerPool, planner: Callable[[str], Plan]) -> Engine:
        interlocks = self.config.interlocks
        limits = Limits(**interlocks.model_dump())
        lab = Lab(
            self.rig,
            self.table,
            recorder,
            self.clock,
            self.data,
            cameras=camera_choices(self.config),
            camera_timeout_s=interlocks.camera_timeout_s,
        )
        measuring = Measuring(
            recorder,
            PoolMeasurer(pool),
            self.clock,
            self.data,
            depth=2 * pool.workers,
        )
        engine = Engine(
            lab,
            measuring,
            planner,
            limits,
            folder_files=self._folder_files(),
            free_bytes=lambda: shutil.disk_usage(self.data).free,
            policy=Policy(accept_changed_rig=self.options.accept_changed_rig, window_s=self.config.trigger.window_s),
        )
        engine.manual.exposure_s = next(
            (camera.exposure_s for camera in self.config.cameras.values() if camera.exposure_s is not None), 1.0
        )
        return engine

    def _plan(self, toml: str, steps: dict[str, tuple[float, ...]], *, check_disk: bool = False) -> Plan:
        free = None
        if check_disk:
            free = max(shutil.disk_usage(self.data).free - self.config.interlocks.min_disk_bytes, 0)
        return make_plan(load_campaign(toml), plan_rig(self.config, exposure_steps_s=steps, free_bytes=free))

    def _folder_files(self) -> dict[str, str]:
        """What makes a campaign's folder a data-set folder."""
        files = {
            "rig.toml": self.config.source.read_text(encoding="utf-8"),
            "control.csv": self.config.path(self.config.control.file).read_text(encoding="utf-8"),
        }
        if self.config.targets.file is not None:
            files["targets.csv"] = self.config.path(self.config.targets.file).read_text(encoding="utf-8")
        return files

    def _describe(self, identities: dict[str, str], commands: str, events: str) -> dict[str, Any]:
        return {
            "version": __version__,
            "pid": os.getpid(),
            "config": str(self.config.source),
            "service": {"commands": commands, "events": events, "data": str(self.data)},
            "campaigns": str(self.data / "campaigns"),
            "devices": identities,
            "cameras": list(self.config.cameras),
            "gauges": [gauge.name for gauge in self.config.gauges],
            "limits": self.config.shaker.limits.model_dump() if self.config.shaker is not None else None,
            "interlocks": self.config.interlocks.model_dump(),
        }

    async def _end_at_rest(self) -> None:
        """Table to rest; said loudly if it does not confirm."""
        try:
            await self.table.stop()
        except LabdaemonError as exc:
            log.critical("%s", exc)

    def _end(self, status: int) -> None:
        if not self.exit_status.done():
            self.exit_status.set_result(status)


def _checks(engine: Engine, recorder: Recorder) -> dict[str, Any]:
    """What must have moved since the watchdog was last fed. The event loop is what asks."""
    seen = {"beats": -1}

    async def journal() -> bool:
        await recorder.write(probe)
        return True

    async def guard() -> bool:
        before, seen["beats"] = seen["beats"], engine.guard.beats
        return engine.guard.beats > before

    async def workers() -> bool:
        return engine.measuring.oldest_s() <= 2.0 * engine.limits.worker_stall_s

    return {"journal": journal, "guard": guard, "workers": workers}


def _stalled(names: list[str]) -> None:
    log.error("no progress in %s: the watchdog is not fed", ", ".join(names))


def _last_resort(rig: Rig) -> Callable[[], None]:
    """Stop the table by plain calls, for a process that ends without its event loop."""

    def stop() -> None:
        for device, how in ((rig.shaker, "stop_now"), (rig.trigger, "drop_enable")):
            if device is not None:
                try:
                    getattr(device.driver, how)()
                except Exception:
                    log.exception("%s of the last resort failed", how)

    return stop
