"""What runs while the daemon serves: engine, stream, workers and watchdog, wired to the table that is held."""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from labdaemon import __version__
from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.engine import Engine
from labdaemon.campaign.interlocks import InterlockLimits
from labdaemon.campaign.measurement_queue import MeasurementQueue
from labdaemon.campaign.plan import make_plan
from labdaemon.campaign.retry import RetryPolicy
from labdaemon.campaign.steps import Plan
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.recorder import Recorder
from labdaemon.errors import DeviceError, InterlockError, StorageUnavailable
from labdaemon.off_loop import off_loop
from labdaemon.processing import WorkerPool
from labdaemon.service.config import RigConfig, plan_rig
from labdaemon.service.daemon import Held
from labdaemon.service.devices import camera_overrides
from labdaemon.service.fault_hook import FaultHook, resolved
from labdaemon.service.guardian_context import REPORT_NAME, take_report
from labdaemon.service.handlers import handlers
from labdaemon.service.measuring import PoolMeasurer
from labdaemon.service.start import ExposureSteps, Start
from labdaemon.service.status import status_of
from labdaemon.service.supervise import as_failure, supervise
from labdaemon.service.watchdog import notify
from labdaemon.stream.commands import Handler
from labdaemon.stream.events import EventPublisher, latest, replay

log = logging.getLogger(__name__)


async def serve(held: Held, start: Start) -> int:
    """Wait for the devices, then serve until asked to end, or until a part fails for good.

    The table is at rest when this returns, or it was said that it is not.

    Parameters
    ----------
    held
        What the daemon holds.
    start
        What waits, and answers meanwhile.

    Raises
    ------
    AskedToEnd
        Before all devices were there.
    LabdaemonError
        The events address is taken, or a part failed too often. Never exit status 2 once it has served.
    """
    engine: Engine | None = None
    config = held.config

    def status() -> dict[str, Any]:
        guardian = held.guardian.describe() if held.guardian is not None else None
        report = status_of(engine, start.place) if engine is not None else start.status()
        return report | {"guardian": guardian}

    publisher = EventPublisher(config.service.events, held.journal, status, held.clock)
    hook = _fault_hook(held, start.place)

    def committed() -> None:
        publisher.wake()
        if hook is not None:
            hook.wake()

    recorder = Recorder(
        held.journal, ThreadExecutor("journal"), committed, ThreadExecutor("data disk"), ThreadExecutor("plans")
    )
    pool = WorkerPool(config.processing.workers, deadline_s=config.processing.deadline_s)
    try:
        publisher.bind()
        start.parts += [asyncio.create_task(supervise("events", publisher.run, held.clock)), held.keeping]
        start.announce = _once(lambda: held.ready(held.commands.address, publisher.address))
        held.desk.offer(_early(held, start, publisher, status), start.refusal)
        identities, steps = await start.reach_devices(held.rig, held.identities)
        engine = _engine(held, recorder, pool, partial(_plan, held, steps))
        await _heed_guardian(held, engine)
        rig = _describe(held, identities, publisher.address)
        submitted = partial(_plan, held, steps, check_disk=True)
        held.table_monitor.report, held.table_monitor.trip = engine.report, engine.trip
        start.checks |= _checks(engine)
        held.desk.open(handlers(engine, submitted, status, rig), held.journal)
        if hook is not None:
            engine.reporter.unrecorded = hook.unrecorded
        return await _run_parts(held, engine, publisher, start, hook)
    finally:
        publisher.close()
        pool.close()
        recorder.close()


def _once(work: Callable[[], None]) -> Callable[[], None]:
    """The same, but only when it is called first."""
    left = [work]

    def call() -> None:
        if left:
            left.pop()()

    return call


async def _heed_guardian(held: Held, engine: Engine) -> None:
    """Pause when the guardian is lost, and report what an earlier daemon's guardian did."""
    report = take_report(held.data / REPORT_NAME)
    if report is not None:
        await engine.reporter.fault(
            DeviceError(report, device="guardian"), campaign=None, step=None, action="look why the daemon ended"
        )
    if held.guardian is None:
        return

    def lost(reason: str) -> None:
        log.error("%s", reason)
        engine.trip(InterlockError(reason))

    held.guardian.on_lost = lost


def _fault_hook(held: Held, place: Mapping[str, Any]) -> FaultHook | None:
    """What carries faults to a person; None where the rig file names nothing.

    Raises
    ------
    ConfigError
        The program is not there.
    """
    command = held.config.service.on_fault_command
    if command is None:
        return None
    return FaultHook(resolved(command, held.config.source), held.journal, place, held.clock)


def _early(
    held: Held, start: Start, publisher: EventPublisher, report: Callable[[], dict[str, Any]]
) -> dict[str, Handler]:
    """Commands that are carried out while devices are waited for: also what `watch` asks for."""

    async def status(params: dict[str, Any]) -> Any:
        return {**report(), "seq": held.journal.last_seq, "journal": held.journal.uuid}

    async def rig(params: dict[str, Any]) -> Any:
        return _describe(held, held.identities, publisher.address)

    async def replay_events(params: dict[str, Any]) -> Any:
        return await off_loop(replay, held.journal, params)

    async def latest_events(params: dict[str, Any]) -> Any:
        return await off_loop(latest, held.journal, params)

    return {
        **start.handlers(),
        "status": status,
        "rig": rig,
        "events.replay": replay_events,
        "events.latest": latest_events,
    }


async def _run_parts(
    held: Held, engine: Engine, publisher: EventPublisher, start: Start, hook: FaultHook | None
) -> int:
    parts: list[asyncio.Future[Any]] = [*start.parts, asyncio.create_task(engine.run())]
    if hook is not None:
        parts.append(asyncio.create_task(supervise("on_fault", hook.run, held.clock)))
    start.announce()
    notify(f"STATUS=serving on {held.commands.address}")
    try:
        await asyncio.wait([*parts, start.end], return_when=asyncio.FIRST_COMPLETED)
        for part in parts:
            if part.done() and (exc := part.exception()) is not None:
                raise as_failure(exc) from exc
        return start.end.result()
    finally:
        for part in parts:
            part.cancel()
        with suppress(InterlockError):  # said on the way out, by the stop that decides the exit status
            await held.table.stop(patience_s=0.0)
        await asyncio.gather(*parts, return_exceptions=True)
        await engine.queue.cancel()
        if hook is not None:
            await hook.flush()


def _engine(held: Held, recorder: Recorder, pool: WorkerPool, planner: Callable[[str], Plan]) -> Engine:
    interlocks = held.config.interlocks
    lab = AcquisitionContext(
        held.rig,
        held.table,
        recorder,
        held.clock,
        held.data,
        cameras=camera_overrides(held.config),
        camera_timeout_s=interlocks.camera_timeout_s,
    )
    measurer = held.measurer(pool, held.journal) if held.measurer is not None else PoolMeasurer(pool)
    engine = Engine(
        lab,
        MeasurementQueue(recorder, measurer, held.clock, held.data, depth=2 * pool.workers),
        planner,
        InterlockLimits(**interlocks.model_dump(exclude={"accept_no_enable"})),
        folder_files=_folder_files(held.config),
        free_bytes=lambda: shutil.disk_usage(held.data).free,
        policy=RetryPolicy(
            accept_changed_rig=held.options.accept_changed_rig,
            window_s=held.config.trigger.window_s,
            accept_no_enable=interlocks.accept_no_enable,
        ),
    )
    exposures = [camera.exposure_s for camera in held.config.cameras.values() if camera.exposure_s is not None]
    engine.manual.exposure_s = exposures[0] if exposures else 1.0
    return engine


def _plan(held: Held, steps: ExposureSteps, toml: str, *, check_disk: bool = False) -> Plan:
    """A campaign's plan for this rig, as its cameras are set now."""
    free = None
    if check_disk:
        free = max(shutil.disk_usage(held.data).free - held.config.interlocks.min_disk_bytes, 0)
    return make_plan(load_campaign(toml), plan_rig(held.config, exposure_steps_s=steps, free_bytes=free))


def _folder_files(config: RigConfig) -> dict[str, str]:
    """What makes a campaign's folder a data-set folder."""
    files = {
        "rig.toml": config.source.read_text(encoding="utf-8"),
        "control.csv": config.path(config.control.file).read_text(encoding="utf-8"),
    }
    if config.targets.file is not None:
        files["targets.csv"] = config.path(config.targets.file).read_text(encoding="utf-8")
    return files


def _describe(held: Held, identities: dict[str, str], events: str) -> dict[str, Any]:
    """The answer to `rig`."""
    config = held.config
    return {
        "version": __version__,
        "pid": os.getpid(),
        "config": str(config.source),
        "service": {"commands": held.commands.address, "events": events, "data": str(held.data)},
        "campaigns": str(held.data / "campaigns"),
        "devices": identities,
        "cameras": list(config.cameras),
        "gauges": [gauge.name for gauge in config.gauges],
        "limits": config.shaker.limits.model_dump() if config.shaker is not None else None,
        "interlocks": config.interlocks.model_dump(),
    }


def _checks(engine: Engine) -> Mapping[str, Callable[[], Awaitable[bool]]]:
    """What must have moved since the watchdog was last fed. The event loop is what asks."""
    seen = {"beats": -1}

    async def journal() -> bool:
        # A disk that takes nothing is no reason to end: started again, the daemon would find the same disk.
        try:
            await engine.disk.check()
        except StorageUnavailable as exc:
            engine.trip(exc)
        return True

    async def guard() -> bool:
        before, seen["beats"] = seen["beats"], engine.monitor.iterations
        return engine.monitor.iterations > before

    async def workers() -> bool:
        return engine.queue.oldest_s() <= 2.0 * engine.limits.worker_stall_s

    return {"journal": journal, "guard": guard, "workers": workers}
