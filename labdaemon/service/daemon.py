"""The daemon from its first moment to its last: it holds the table.

First the shaker's lock, which keeps other daemons off this table, then the table to rest; then the data folder, the
commands socket, the journal and everything that serves (`labdaemon.service.serve`, which takes a second to load). On
every way out, asked for or not, the table comes to rest first, and the exit status says whether it was seen to.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from labdaemon.capture.rig import Rig
from labdaemon.capture.table import Table
from labdaemon.capture.table_monitor import TableMonitor
from labdaemon.clock import Clock, SystemClock
from labdaemon.errors import RestUnconfirmed
from labdaemon.journal.journal import Journal
from labdaemon.service.config import RigConfig
from labdaemon.service.deferred_commands import DeferredCommands
from labdaemon.service.devices import build_rig, connect_stop_actuators
from labdaemon.service.doors import Doors, open_doors
from labdaemon.service.free_memory import give_memory_back
from labdaemon.service.guardian_context import guarded_table, wait_for_guardian
from labdaemon.service.guardian_supervisor import GuardianSupervisor
from labdaemon.service.presence import PresenceNote
from labdaemon.service.shaker_lock import ShakerLock
from labdaemon.service.signals import ending_signals, exit_status, forbid_core_dumps, ignore_suspension, name_of
from labdaemon.service.startup import EndRequest, StartupSequence
from labdaemon.service.status import place_of
from labdaemon.service.supervise import supervise
from labdaemon.service.watchdog import feed, log_stalled, notify
from labdaemon.stream.commands import CommandServer

if TYPE_CHECKING:
    from labdaemon.campaign.measurement_queue import CaptureMeasurer
    from labdaemon.processing import WorkerPool

log: logging.Logger = logging.getLogger(__name__)

SWITCH_S = 0.001
"""How long a busy thread keeps the interpreter to itself: a stop passes three threads on its way to the wire."""

ReadyCallback = Callable[[str, str], None]
"""Called with the addresses of commands and events once both are served."""


@dataclass(frozen=True, slots=True)
class DaemonOptions:
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


MeasurerFactory = Callable[["WorkerPool", Journal], "CaptureMeasurer"]
"""What measures stored captures; a crash test has it measured cheaply."""


@dataclass(frozen=True, slots=True)
class TableContext:
    """The table as the daemon holds it from its first moment to its last."""

    config: RigConfig
    options: DaemonOptions
    doors: Doors
    data: Path
    clock: Clock
    rig: Rig
    table: Table
    table_monitor: TableMonitor
    keeping: asyncio.Task[None]
    guardian: GuardianSupervisor | None
    ready: ReadyCallback
    measurer: MeasurerFactory | None


@dataclass(slots=True)
class DaemonContext:
    """What the daemon holds while it serves: the table as `TableContext` says, and what it has opened since."""

    config: RigConfig
    options: DaemonOptions
    doors: Doors
    data: Path
    clock: Clock
    rig: Rig
    table: Table
    table_monitor: TableMonitor
    keeping: asyncio.Task[None]
    journal: Journal
    commands: CommandServer
    deferred: DeferredCommands
    guardian: GuardianSupervisor | None
    identities: dict[str, str]
    ready: ReadyCallback
    measurer: MeasurerFactory | None


def run_daemon(
    config: RigConfig,
    options: DaemonOptions | None = None,
    *,
    ready: ReadyCallback = lambda *_: None,
    measurer: MeasurerFactory | None = None,
    lock: ShakerLock | None = None,
) -> int:
    """Run until it is asked to end, and return the exit status.

    Parameters
    ----------
    lock
        The shaker's, where the caller holds it; else it is taken here.
    measurer
        Makes what measures; None for the worker pool's own.

    Raises
    ------
    ShakerLockConflict
        Another daemon holds the shaker; its table was left alone.
    RestUnconfirmed
        The table was not seen to come to rest, however the daemon ended.
    LabdaemonError
        It could not start, or a part of it failed for good. The table is at rest.
    """
    own: ShakerLock | None = None
    doors = open_doors(config)
    if lock is None and config.shaker is not None:
        lock = own = ShakerLock(config.shaker.port, "daemon", config=str(config.source))
    try:
        return asyncio.run(_run_with_table(config, options or DaemonOptions(), doors, ready, measurer, lock))
    finally:
        if own is not None:
            own.release()


async def _run_with_table(
    config: RigConfig,
    options: DaemonOptions,
    doors: Doors,
    ready: ReadyCallback,
    measurer: MeasurerFactory | None,
    lock: ShakerLock | None,
) -> int:
    loop = asyncio.get_running_loop()
    end: asyncio.Future[int] = loop.create_future()

    def ask_to_end(number: int) -> None:
        if not end.done():
            log.info("%s: the table comes to rest, then the daemon ends", name_of(number))
            end.set_result(exit_status(number))

    for number in ending_signals():
        loop.add_signal_handler(number, ask_to_end, number)
    ignore_suspension()
    forbid_core_dumps()
    sys.setswitchinterval(SWITCH_S)
    clock, rig = SystemClock(), build_rig(config)
    table = Table(rig, clock, config.interlocks.gauge_disagreement)
    data = (options.data or config.data).resolve()
    last_resort = _last_resort(rig)
    atexit.register(last_resort)
    if config.shaker is not None:
        await asyncio.to_thread(wait_for_guardian, config.shaker.port)
    async with AsyncExitStack() as afterwards:  # the guardian is let go after the last stop
        try:
            await _come_to_rest(table)
            guardian = await afterwards.enter_async_context(guarded_table(config, rig, table, data, clock))
            table_monitor = TableMonitor(rig, table, clock)
            keeping = asyncio.create_task(supervise("table monitor", table_monitor.run, clock))
            afterwards.callback(keeping.cancel)
            context = TableContext(
                config, options, doors, data, clock, rig, table, table_monitor, keeping, guardian, ready, measurer
            )
            return await _serve_commands(context, lock, end)
        finally:
            notify("STOPPING=1")
            try:
                await table.stop()  # what it raises is how the process ends, whatever came before
            finally:
                atexit.unregister(last_resort)  # all that it does was tried; a guardian still tries
                await rig.close()


async def _come_to_rest(table: Table) -> None:
    """The table to rest, before anything else; where that is not confirmed, the table monitor tries on."""
    try:
        rest = await table.stop(at_once=True)
    except RestUnconfirmed as exc:
        log.critical("%s", exc)
    else:
        log.info("table at rest (%s)", rest.by)


async def _serve_commands(context: TableContext, lock: ShakerLock | None, end: asyncio.Future[int]) -> int:
    """Take data folder, commands socket and journal, and serve until the end."""
    start = StartupSequence(context.clock, context.table, place_of(context.config.source, context.data), end)
    deferred = DeferredCommands()
    deferred.serve_early(start.handlers(), start.refusal)
    doors, present = context.doors, None
    commands = CommandServer(context.config.service.commands, deferred.handlers(), deferred, doors.commands)
    try:
        commands.bind()
        if lock is not None:
            lock.note(commands=commands.address)
        present = PresenceNote(commands.address, str(context.config.source))
        start.parts.append(asyncio.create_task(supervise("commands", commands.run, context.clock)))
        if doors.access is not None:
            follow = partial(doors.access.run, context.clock)
            start.parts.append(asyncio.create_task(supervise("list of clients", follow, context.clock)))
        give_back = partial(give_memory_back, context.clock)
        start.parts.append(asyncio.create_task(supervise("free memory", give_back, context.clock)))
        start.parts.append(asyncio.create_task(feed(context.clock, start.checks, log_stalled)))
        notify(f"READY=1\nSTATUS=commands on {commands.address}")
        return await _open_data(context, start, deferred, commands)
    except EndRequest:
        return end.result()
    finally:
        for part in start.parts:
            part.cancel()
        commands.close()
        if present is not None:
            present.remove()


async def _open_data(
    context: TableContext, start: StartupSequence, deferred: DeferredCommands, commands: CommandServer
) -> int:
    """Wait for the journal, and serve until the end."""
    journal = await start.open_journal(context.data, context.options.new_journal)
    try:
        # Loading what measures takes longer than bringing the table to rest, so it comes after, and off the loop: on a
        # busy machine it takes seconds, and a table that is not confirmed needs its heartbeat meanwhile.
        serving = await asyncio.to_thread(import_module, "labdaemon.service.serve")
        identities = await connect_stop_actuators(context.rig)
        daemon_context = DaemonContext(
            context.config, context.options, context.doors, context.data, context.clock, context.rig, context.table,
            context.table_monitor, context.keeping, journal, commands, deferred, context.guardian, identities,
            context.ready, context.measurer,
        )  # fmt: skip
        status: int = await serving.serve(daemon_context, start)
        return status
    finally:
        journal.close()


def _last_resort(rig: Rig) -> Callable[[], None]:
    """Stop the table by plain calls, for a process that ends without its event loop."""

    def stop() -> None:
        for device, how in ((rig.shaker, "stop_now"), (rig.trigger, "drop_enable")):
            if device is not None:
                try:
                    getattr(device.driver, how)()
                except Exception as exc:
                    log.critical("%s of the last resort failed: %s", how, exc)

    return stop
