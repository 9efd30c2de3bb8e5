"""A guardian for as long as the daemon holds the table, and what an earlier daemon's guardian left."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from labdaemon.capture.devices import StopRecipeSource
from labdaemon.capture.rig import Rig
from labdaemon.capture.table import Table
from labdaemon.clock import Clock
from labdaemon.service.config import RigConfig
from labdaemon.service.guardian_process import GuardianSettings
from labdaemon.service.guardian_supervisor import GuardianSupervisor
from labdaemon.service.shaker_lock import lock_holder, wait_free

log: logging.Logger = logging.getLogger(__name__)

WAIT_S = 15.0
"""Longest wait for the guardian of an earlier daemon; it hands over after some seconds without success."""
REPORT_NAME = "guardian.json"


@asynccontextmanager
async def guarded_table(
    config: RigConfig, rig: Rig, table: Table, data: Path, clock: Clock
) -> AsyncIterator[GuardianSupervisor | None]:
    """Guard the table; the guardian is let go only once the table was confirmed at rest, else it takes over.

    Enter it when the shaker was reached and nothing has moved, leave it after the last stop. It yields None where the
    shaker cannot be guarded: there is none, it is simulated in this process, or its driver cannot say how (the log
    names it).
    """
    guardian = _make(config, rig, table, data, clock)
    if guardian is None:
        yield None
        return
    table.guard = guardian
    try:
        await guardian.start()
    except Exception as exc:  # whatever is short at the moment: until there is one, nothing moves
        log.critical("no guardian can be started yet (%s)", exc)
    heartbeat = asyncio.create_task(guardian.run())
    try:
        yield guardian
    finally:
        heartbeat.cancel()
        await asyncio.gather(heartbeat, return_exceptions=True)
        if table.may_move:
            guardian.leave()
        else:
            await guardian.release()


def _make(config: RigConfig, rig: Rig, table: Table, data: Path, clock: Clock) -> GuardianSupervisor | None:
    if rig.shaker is None:
        return None
    driver = rig.shaker.driver
    if not isinstance(driver, StopRecipeSource):
        log.warning(
            "%s: its driver gives no stop recipe, so no guardian stops the table when this process dies; wire the "
            "amplifier's enable line to the trigger box",
            driver.name,
        )
        return None
    recipe = driver.stop_recipe()
    if recipe is None:
        log.info("%s: no guardian, the device is simulated in this process", driver.name)
        return None
    settings = GuardianSettings(
        str(config.source), data / REPORT_NAME, config.guardian.silence_s, config.guardian.patience_s
    )
    return GuardianSupervisor(recipe, settings, clock, lambda: table.may_move)


def wait_for_guardian(port: str) -> None:
    """Wait until the guardian of an earlier daemon has finished with this shaker. Blocks: for a thread."""
    holder = lock_holder(port, "guardian")
    if holder is None:
        return
    log.warning("a guardian (process %s) is bringing the table to rest; waiting for it", holder.pid)
    if holder.pid is not None:
        with suppress(ProcessLookupError, PermissionError):
            os.kill(holder.pid, signal.SIGUSR1)  # `labdaemon.guardian.heartbeat_monitor.HAND_OVER`
    if wait_free(port, "guardian", WAIT_S) is not None:
        log.critical("the guardian (process %s) is still at it after %g s; going on", holder.pid, WAIT_S)


def take_report(file: Path) -> str | None:
    """What a guardian did since the last daemon, read once; None if it had nothing to do."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        file.unlink()
        how = (
            f"and saw it at rest after {found['after_s']:.2f} s"
            if found["is_at_rest"]
            else f"and did NOT see it at rest ({found['trouble']})"
        )
        return f"at {found['at']} {found['why']}; a guardian stopped the table {how}"
    except (OSError, ValueError, KeyError, TypeError):
        return None
