"""The daemon from its first moment to its last: it holds the table.

First the data folder and the commands socket, which prove that no other daemon holds this rig; then the table to rest,
before anything else; then everything that serves (`labdaemon.service.serving`, which takes a second to load). On every
way out, asked for or not, the table comes to rest first.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from labdaemon.capture.rig import Rig, bring_to_rest
from labdaemon.capture.table import Table
from labdaemon.clock import Clock, SystemClock
from labdaemon.errors import LabdaemonError
from labdaemon.journal.journal import Journal
from labdaemon.journal.storage import DataLock
from labdaemon.service.config import RigConfig
from labdaemon.service.desk import Desk
from labdaemon.service.devices import build_rig, connect_stoppers
from labdaemon.service.guardian_context import guarded_table, wait_for_guardian
from labdaemon.service.guarding import Guardian
from labdaemon.service.signals import ending_signals, exit_status, forbid_core_dumps, ignore_suspension, name_of
from labdaemon.service.watchdog import notify
from labdaemon.stream.commands import CommandServer

if TYPE_CHECKING:
    from labdaemon.campaign.measuring import Measurer
    from labdaemon.processing import WorkerPool

log = logging.getLogger(__name__)

Ready = Callable[[str, str], None]
"""Called with the addresses of commands and events once both are served."""


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


MakeMeasurer = Callable[["WorkerPool", Journal], "Measurer"]
"""What measures stored captures; a crash test has it measured cheaply."""


@dataclass(slots=True)
class Held:
    """What the daemon holds while it serves."""

    config: RigConfig
    options: Options
    data: Path
    clock: Clock
    rig: Rig
    table: Table
    journal: Journal
    commands: CommandServer
    desk: Desk
    guardian: Guardian | None
    identities: dict[str, str]
    ready: Ready
    measurer: MakeMeasurer | None


def run_daemon(
    config: RigConfig,
    options: Options | None = None,
    *,
    ready: Ready = lambda *_: None,
    measurer: MakeMeasurer | None = None,
) -> int:
    """Run until told to end, and return the exit status.

    Parameters
    ----------
    measurer
        Makes what measures; None for the worker pool's own.

    Raises
    ------
    LabdaemonError
        It could not start, or a part of it failed for good. The table is at rest.
    """
    return asyncio.run(_run(config, options or Options(), ready, measurer))


async def _run(config: RigConfig, options: Options, ready: Ready, measurer: MakeMeasurer | None) -> int:
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
    data = (options.data or config.data).resolve()
    rig = build_rig(config)
    lock = DataLock(data)
    desk = Desk()
    commands = CommandServer(config.service.commands, desk.handlers(), desk)
    try:
        commands.bind()
        async with AsyncExitStack() as afterwards:
            return await _hold_table(config, options, data, rig, lock, commands, desk, ready, measurer, end, afterwards)
    finally:
        commands.close()
        lock.release()


async def _hold_table(
    config: RigConfig,
    options: Options,
    data: Path,
    rig: Rig,
    lock: DataLock,
    commands: CommandServer,
    desk: Desk,
    ready: Ready,
    measurer: MakeMeasurer | None,
    end: asyncio.Future[int],
    afterwards: AsyncExitStack,
) -> int:
    """From the first word to the table until the last; the guardian is let go `afterwards`."""
    clock = SystemClock()
    table = Table(rig, clock, config.interlocks.gauge_disagreement)
    last_resort = _last_resort(rig)
    if config.shaker is not None:
        await asyncio.to_thread(wait_for_guardian, config.shaker.port)
    try:
        identities = await connect_stoppers(rig)
        atexit.register(last_resort)
        guardian = await afterwards.enter_async_context(guarded_table(config, rig, table, data, clock))
        rest = await bring_to_rest(rig, at_once=True)
        table.may_move = False  # the imports below hold up the heartbeat for seconds on a busy machine
        log.info("table at rest (%s)", rest.by)
        journal = Journal(data, clock, replace_damaged=options.new_journal, lock=lock)
        try:
            # Loading what measures takes longer than bringing the table to rest, so it comes after; in a thread, so
            # that the heartbeat goes out meanwhile.
            serving = await asyncio.to_thread(import_module, "labdaemon.service.serving")
            held = Held(
                config, options, data, clock, rig, table, journal, commands, desk, guardian, identities, ready, measurer
            )
            status: int = await serving.serve(held, end)
            return status
        finally:
            journal.close()
    finally:
        notify("STOPPING=1")
        try:
            await table.stop()
        except LabdaemonError as exc:
            log.critical("%s", exc)
        else:
            atexit.unregister(last_resort)
        await rig.close()


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
