"""The table to rest without a daemon, and before one: needs [shaker] and [trigger] of the rig file and nothing else.

`safe-stop` is what a person types, and what systemd runs after the daemon however it ended. `run` does the same before
it reads the rest of its rig file. While a daemon lives, `safe-stop` asks it to stop.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass
from pathlib import Path

from labdaemon.capture.table_evidence import describe
from labdaemon.capture.table_observer import TableObserver
from labdaemon.capture.table_stop import PATIENCE_S, RestConfirmation, bring_to_rest, rest_unconfirmed
from labdaemon.clock import SystemClock
from labdaemon.errors import InterlockError, LabdaemonError
from labdaemon.service.guardian_context import wait_for_guardian
from labdaemon.service.shaker_lock import LockHolder, ShakerLock, lock_holder
from labdaemon.service.signals import ending_signals
from labdaemon.service.stop_actuators import StopActuators, read_stop_actuators
from labdaemon.service_section import keys_folder, read_service
from labdaemon.stream.access import OWN_KEY
from labdaemon.stream.key_files import KeyPair, read_pair

log: logging.Logger = logging.getLogger(__name__)

ASK_S = 10.0
"""How long a living daemon may take to stop its table before it is stopped past it."""


@dataclass(frozen=True, slots=True)
class TableClaim:
    """A table that was brought to rest before its daemon began.

    Attributes
    ----------
    lock
        Keeps other daemons off; None where the shaker's port is not known.
    unconfirmed
        Why rest was not confirmed; None where it was, or there is no shaker.
    signal
        A signal that came meanwhile and asks to end; None if none came.
    """

    lock: ShakerLock | None
    unconfirmed: InterlockError | None
    signal: int | None


def claim_table(path: Path) -> TableClaim:
    """Bring the table of a rig file to rest before the file is read in full, and keep other daemons off it.

    Raises
    ------
    ShakerLockConflict
        Another daemon holds the shaker; its table was left alone.
    ConfigError
        The file cannot be read at all.
    """
    stop_actuators = read_stop_actuators(path)
    lock = None
    if stop_actuators.port is not None:
        lock = ShakerLock(stop_actuators.port, "daemon", config=str(path))
        wait_for_guardian(stop_actuators.port)
    signals: list[int] = []
    try:
        rest = asyncio.run(_stop(stop_actuators, signals))
    except InterlockError as exc:
        log.critical("%s", exc)
        return TableClaim(lock, exc, signals[0] if signals else None)
    log.info("%s", _sentence(rest))
    return TableClaim(lock, None, signals[0] if signals else None)


def stop_table(path: Path) -> str:
    """Bring the table of a rig file to rest, and say what was seen of it.

    Raises
    ------
    InterlockError
        Nothing that can see confirmed it. The message names the emergency stop.
    ConfigError
        The file cannot be read at all.
    """
    stop_actuators = read_stop_actuators(path)
    holder = lock_holder(stop_actuators.port, "daemon") if stop_actuators.port is not None else None
    if holder is not None:
        answer = _ask(holder, path)
        if answer is not None:
            return answer
        log.warning("the daemon (process %s) does not answer: the table is stopped past it", holder.pid)
        stop_actuators = read_stop_actuators(path, exclusive=False)
    elif stop_actuators.port is not None:
        wait_for_guardian(stop_actuators.port)
    return _sentence(asyncio.run(_stop(stop_actuators, [])))


def _ask(holder: LockHolder, path: Path) -> str | None:
    """Ask a living daemon to stop; what it saw, None when it does not answer.

    Raises
    ------
    InterlockError
        It stopped all that it can, and rest is not confirmed.
    """
    from labdaemon.stream.client import Client, NoDaemon

    if not holder.commands:
        return None  # it has only just begun, and that with a stop
    try:
        with Client(holder.commands, timeout_s=ASK_S, key=_key(path)) as client:
            result = client.call("stop")
    except NoDaemon:  # it holds the shaker and does not answer: the stop goes over the wire without it
        return None
    except LabdaemonError as exc:
        if "use the emergency stop" in str(exc):
            raise InterlockError(f"the daemon (process {holder.pid}) says: {exc}") from exc
        return None
    seen = result.get("seen") if isinstance(result, dict) else None
    return f"table at rest, by the daemon (process {holder.pid}; {seen or 'no shaker'})"


def _key(path: Path) -> KeyPair | None:
    """The daemon's own key, with which who runs it may stop it; None where it has none, or that cannot be read."""
    try:
        service = read_service(path)
        if not service.needs_keys(service.commands):
            return None
        pair = read_pair(keys_folder(path, service) / OWN_KEY, is_client=False)
    except LabdaemonError as exc:
        log.warning("the daemon cannot be asked by its own key: %s", exc)
        return None
    return KeyPair(pair.public, pair.secret, pair.public)


async def _stop(stop_actuators: StopActuators, signals: list[int]) -> RestConfirmation:
    """Stop to the end; signals that would end the process meanwhile are noted."""
    loop = asyncio.get_running_loop()
    for number in ending_signals():
        loop.add_signal_handler(number, signals.append, number)
    for trouble in stop_actuators.troubles:
        log.warning("%s", trouble)
    if stop_actuators.rig.shaker is None and not stop_actuators.is_without_shaker:
        return await _stop_by_line_alone(stop_actuators)
    try:
        return await bring_to_rest(
            stop_actuators.rig,
            TableObserver(stop_actuators.rig, SystemClock()),
            SystemClock(),
            at_once=True,
            patience_s=PATIENCE_S,
        )
    finally:
        await stop_actuators.rig.close()


async def _stop_by_line_alone(stop_actuators: StopActuators) -> RestConfirmation:
    """[shaker] cannot be read: the enable line is all that is left, and it was never proven here."""
    troubles = list(stop_actuators.troubles) or ["[shaker] cannot be read"]
    observer = TableObserver(stop_actuators.rig, SystemClock())
    if stop_actuators.rig.trigger is not None:
        try:
            await stop_actuators.rig.trigger.urgent(lambda driver: driver.drop_enable())
            troubles.append("the enable line was dropped")
        except LabdaemonError as exc:
            troubles.append(str(exc))
        finally:
            await stop_actuators.rig.close()
    raise rest_unconfirmed(observer.evidence(), troubles)


def _sentence(rest: RestConfirmation) -> str:
    if rest.by == "none":
        return "the rig has no shaker"
    troubles = f"; {'; '.join(rest.troubles)}" if rest.troubles else ""
    return f"table at rest ({rest.by}; {describe(rest.seen)}{troubles})"
