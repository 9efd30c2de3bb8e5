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
from labdaemon.journal.retention import Retention
from labdaemon.off_loop import off_loop
from labdaemon.processing import WorkerPool
from labdaemon.service.campaign_reports import CampaignReports
from labdaemon.service.config import RigConfig, plan_rig
from labdaemon.service.daemon import DaemonContext
from labdaemon.service.devices import camera_overrides
from labdaemon.service.fault_hook import FaultHook, resolve_command
from labdaemon.service.guardian_context import REPORT_NAME, take_report
from labdaemon.service.handlers import handlers
from labdaemon.service.history import keep_history
from labdaemon.service.lamp_settings import lamp_of
from labdaemon.service.openrpc import openrpc_document
from labdaemon.service.pool_measurer import PoolMeasurer
from labdaemon.service.side_servers import SideServers
from labdaemon.service.startup import ExposureSteps, StartupSequence
from labdaemon.service.status import status_of
from labdaemon.service.supervise import as_failure, supervise
from labdaemon.service.watchdog import notify
from labdaemon.stream.dispatcher import Handler
from labdaemon.stream.publisher import EventPublisher, latest, replay
from labdaemon.version import __version__

log: logging.Logger = logging.getLogger(__name__)


async def serve(context: DaemonContext, start: StartupSequence) -> int:
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
    EndRequest
        Before all devices were there.
    LabdaemonError
        The events address is taken, or a part failed too often. Never exit status 2 once it has served.
    """
    engine: Engine | None = None
    config = context.config

    def status() -> dict[str, Any]:
        guardian = context.guardian.describe() if context.guardian is not None else None
        report = status_of(engine, start.place) if engine is not None else start.status()
        return report | {"guardian": guardian}

    publisher = EventPublisher(config.service.events, context.journal, status, context.clock, context.doors.events)
    hook = _fault_hook(context, start.place)
    reports = CampaignReports(context.journal, context.data) if config.service.reports else None

    servers = SideServers(config, context.commands.dispatcher.answer, context.journal)
    recorder = Recorder(
        context.journal,
        ThreadExecutor("journal"),
        ThreadExecutor("data disk"),
        ThreadExecutor("plans"),
        observers=[publisher, servers, *(one for one in (hook, reports) if one is not None)],
    )
    pool = WorkerPool(config.processing.workers, deadline_s=config.processing.deadline_s)
    try:
        publisher.bind()
        await servers.bind()
        addresses = {"events": publisher.address, **servers.addresses()}
        start.parts += servers.start(context.clock)
        start.parts += [asyncio.create_task(supervise("events", publisher.run, context.clock)), context.keeping]
        start.announce = _only_once(lambda: context.ready(context.commands.address, publisher.address))
        context.deferred.serve_early(_early_handlers(context, start, addresses, status), start.refusal)
        identities, steps = await start.reach_devices(context.rig, context.identities)
        engine = _engine(context, recorder, pool, partial(_plan, context, steps))
        await _follow_guardian(context, engine)
        rig = _describe_rig(context, identities, addresses)
        submitted = partial(_plan, context, steps, check_disk=True)
        context.table_monitor.observer = engine
        start.checks |= _checks(engine)
        context.deferred.serve(handlers(engine, submitted, status, rig), context.journal)
        engine.reporter.observer = hook
        if reports is not None:
            start.parts.append(asyncio.create_task(supervise("reports", reports.run, context.clock)))
        return await _run_parts(context, engine, start, hook)
    finally:
        publisher.close()
        servers.close()
        pool.close()
        recorder.close()


def _only_once(work: Callable[[], None]) -> Callable[[], None]:
    """The same, but only when it is called first."""
    left = [work]

    def call() -> None:
        if left:
            left.pop()()

    return call


async def _follow_guardian(context: DaemonContext, engine: Engine) -> None:
    """Pause when the guardian is lost, and report what an earlier daemon's guardian did."""
    report = take_report(context.data / REPORT_NAME)
    if report is not None:
        await engine.reporter.fault(
            DeviceError(report, device="guardian"), campaign=None, step=None, action="look why the daemon ended"
        )
    if context.guardian is None:
        return

    def lost(reason: str) -> None:
        log.error("%s", reason)
        engine.trip(InterlockError(reason))

    context.guardian.on_lost = lost


def _fault_hook(context: DaemonContext, place: Mapping[str, Any]) -> FaultHook | None:
    """What carries faults to a person; None where the rig file names nothing.

    Raises
    ------
    ConfigError
        The program is not there.
    """
    command = context.config.service.on_fault_command
    if command is None:
        return None
    return FaultHook(resolve_command(command, context.config.source), context.journal, place, context.clock)


def _early_handlers(
    context: DaemonContext, start: StartupSequence, addresses: dict[str, str], report: Callable[[], dict[str, Any]]
) -> dict[str, Handler]:
    """Commands that are carried out while devices are waited for: also what `watch` asks for."""

    async def status(params: dict[str, Any]) -> Any:
        return {**report(), "seq": context.journal.last_seq, "journal": context.journal.uuid}

    async def rig(params: dict[str, Any]) -> Any:
        return _describe_rig(context, context.identities, addresses)

    async def replay_events(params: dict[str, Any]) -> Any:
        return await off_loop(replay, context.journal, params)

    async def latest_events(params: dict[str, Any]) -> Any:
        return await off_loop(latest, context.journal, params)

    async def discover(params: dict[str, Any]) -> Any:
        return await off_loop(openrpc_document)

    return {
        **start.handlers(),
        "status": status,
        "rig": rig,
        "events.replay": replay_events,
        "events.latest": latest_events,
        "rpc.discover": discover,
    }


async def _run_parts(context: DaemonContext, engine: Engine, start: StartupSequence, hook: FaultHook | None) -> int:
    parts: list[asyncio.Future[Any]] = [*start.parts, asyncio.create_task(engine.run())]
    if hook is not None:
        parts.append(asyncio.create_task(supervise("on_fault", hook.run, context.clock)))
    retention = Retention(context.config.service.history_days, context.config.service.history_events)
    if not retention.is_unlimited:
        keep = partial(keep_history, engine.context.recorder, retention, context.clock)
        parts.append(asyncio.create_task(supervise("history", keep, context.clock)))
    start.announce()
    notify(f"STATUS=serving on {context.commands.address}")
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
            await context.table.stop(patience_s=0.0)
        await asyncio.gather(*parts, return_exceptions=True)
        await engine.queue.cancel()
        if hook is not None:
            await hook.flush()


def _engine(context: DaemonContext, recorder: Recorder, pool: WorkerPool, planner: Callable[[str], Plan]) -> Engine:
    interlocks = context.config.interlocks
    acquisition = AcquisitionContext(
        context.rig,
        context.table,
        recorder,
        context.clock,
        context.data,
        cameras=camera_overrides(context.config),
        camera_timeout_s=interlocks.camera_timeout_s,
        lamp=lamp_of(context.config),
    )
    measurer = context.measurer(pool, context.journal) if context.measurer is not None else PoolMeasurer(pool)
    engine = Engine(
        acquisition,
        MeasurementQueue(recorder, measurer, context.clock, context.data, depth=2 * pool.workers),
        planner,
        InterlockLimits(**interlocks.model_dump(exclude={"accept_no_enable"})),
        folder_files=_folder_files(context.config),
        free_bytes=lambda: shutil.disk_usage(context.data).free,
        policy=RetryPolicy(
            accept_changed_rig=context.options.accept_changed_rig,
            window_s=context.config.trigger.window_s,
            accept_no_enable=interlocks.accept_no_enable,
        ),
    )
    exposures = [camera.exposure_s for camera in context.config.cameras.values() if camera.exposure_s is not None]
    engine.manual.exposure_s = exposures[0] if exposures else 1.0
    return engine


def _plan(context: DaemonContext, steps: ExposureSteps, toml: str, *, check_disk: bool = False) -> Plan:
    """A campaign's plan for this rig, as its cameras are set now."""
    free = None
    if check_disk:
        free = max(shutil.disk_usage(context.data).free - context.config.interlocks.min_disk_bytes, 0)
    return make_plan(load_campaign(toml), plan_rig(context.config, exposure_steps_s=steps, free_bytes=free))


def _folder_files(config: RigConfig) -> dict[str, str]:
    """What makes a campaign's folder a data-set folder."""
    files = {
        "rig.toml": config.source.read_text(encoding="utf-8"),
        "control.csv": config.path(config.control.file).read_text(encoding="utf-8"),
    }
    if config.targets.file is not None:
        files["targets.csv"] = config.path(config.targets.file).read_text(encoding="utf-8")
    if config.targets.patches is not None:
        files["patches.csv"] = config.path(config.targets.patches).read_text(encoding="utf-8")
    return files


def _describe_rig(context: DaemonContext, identities: dict[str, str], addresses: dict[str, str]) -> dict[str, Any]:
    """The answer to `rig`."""
    config = context.config
    return {
        "version": __version__,
        "pid": os.getpid(),
        "config": str(config.source),
        "service": {
            "commands": context.commands.address,
            **addresses,
            "data": str(context.data),
            "local_operators": config.service.local_policy,
        },
        "campaigns": str(context.data / "campaigns"),
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
