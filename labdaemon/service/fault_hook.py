"""Carries faults and pauses to a person who is not there: runs the command of ``[service] on_fault``.

The command gets one JSON object on stdin. Several events that come together make one run, and runs keep a distance, so
that a night of retries is no night of messages; nothing is left out, it comes with the next run. Whatever the command
does, fails, prints or never ends, the daemon is not held up by it.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import shutil
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labdaemon.clock import Clock, rfc3339
from labdaemon.errors import ConfigError, LabdaemonError
from labdaemon.events import FaultData
from labdaemon.hook import HookError, run_hook
from labdaemon.journal.journal import Journal
from labdaemon.off_loop import off_loop

KINDS = ("fault", "campaign.paused", "campaign.failed", "campaign.aborted")
GATHER_S = 1.0
"""A fault and the pause that follows from it are one message."""
GAP_S = 10.0
"""Least time between the end of one run and the next."""
TIMEOUT_S = 30.0  # a mail takes seconds; the next faults wait for it
LAST_TIMEOUT_S = 5.0
"""For what is still unsent when the daemon ends."""
MOST_EVENTS = 50  # a storm of faults must fit into one message

log: logging.Logger = logging.getLogger(__name__)


def resolve_command(command: Sequence[str], rig: Path) -> tuple[str, ...]:
    """The command with its program's place; a relative path starts at the rig file's folder.

    Raises
    ------
    ConfigError
        There is no such program: a night's pause would reach no person.
    """
    program = command[0]
    if os.sep in program:
        program = str((rig.parent / program).resolve())
    found = shutil.which(program)
    if found is None:
        raise ConfigError(
            f"{command[0]} is no program that can be run here; a fault would reach no person",
            source=rig,
            key="service.on_fault",
        )
    return (found, *command[1:])


class FaultHook:
    """Runs a command for faults and pauses.

    Parameters
    ----------
    command
        Program and arguments; no shell is involved.
    journal
        Where events are read from.
    place
        Which daemon this is, for the message.
    """

    def __init__(
        self,
        command: Sequence[str],
        journal: Journal,
        place: Mapping[str, Any],
        clock: Clock,
        *,
        gather_s: float = GATHER_S,
        gap_s: float = GAP_S,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self._command, self._journal, self._place, self._clock = tuple(command), journal, dict(place), clock
        self._gather_s, self._gap_s, self._timeout_s = gather_s, gap_s, timeout_s
        self._changed = asyncio.Event()
        self._seq = journal.last_seq
        self._unsent: deque[dict[str, Any]] = deque(maxlen=MOST_EVENTS)

    def wake(self) -> None:
        """Something was committed. Cheap; call it on the loop's thread."""
        self._changed.set()

    def fault_unrecorded(self, campaign: str | None, data: FaultData) -> None:
        """A fault that the journal could not take, as of a full disk."""
        event = {"v": 1, "seq": None, "at": rfc3339(self._clock.now()), "kind": "fault", "campaign": campaign}
        self._unsent.append({**event, "data": data.to_json_dict()})
        self._changed.set()

    async def run(self) -> None:
        """Send until cancelled."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            await self._read()
            if not self._unsent:
                continue
            await self._clock.sleep(self._gather_s)
            await self._read()
            await self._send(self._timeout_s)
            await self._clock.sleep(self._gap_s)

    async def flush(self) -> None:
        """Send what is left, in a short time: the daemon ends."""
        await self._read()
        if self._unsent:
            await self._send(min(LAST_TIMEOUT_S, self._timeout_s))

    async def _read(self) -> None:
        """Take up what the journal has since the last look."""
        if self._journal.last_seq <= self._seq:
            return
        last = self._journal.last_seq
        try:
            self._unsent.extend(await off_loop(self._events, self._seq))
        except (LabdaemonError, RuntimeError) as exc:  # RuntimeError: no thread is left at this moment
            log.warning("on_fault: events cannot be read: %s", exc)
            return
        self._seq = last

    def _events(self, after: int) -> list[dict[str, Any]]:
        marks = ",".join("?" * len(KINDS))
        rows = self._journal.read(
            f"SELECT seq, at, kind, campaign, data FROM events WHERE seq > ? AND kind IN ({marks}) "
            "ORDER BY seq DESC LIMIT ?",
            after,
            *KINDS,
            MOST_EVENTS,
        )
        return [
            {"v": 1, "seq": seq, "at": at, "kind": kind, "campaign": campaign, "data": json.loads(data)}
            for seq, at, kind, campaign, data in reversed(rows)
        ]

    async def _send(self, timeout_s: float) -> None:
        events = list(self._unsent)
        self._unsent.clear()
        message = json.dumps(message_of(events, self._place)).encode()
        try:
            result = await off_loop(run_hook, self._command, timeout_s, message)
        except HookError as exc:
            log.error("on_fault: %s: %s", self._command[0], exc)
        except RuntimeError as exc:  # no thread is left
            log.error("on_fault was not run: %s", exc)
        else:
            if result.status:
                log.error("on_fault: %s ended with %d: %s", self._command[0], result.status, result.last_line)


def message_of(events: Sequence[Mapping[str, Any]], place: Mapping[str, Any]) -> dict[str, Any]:
    """What the command reads: the weightiest event, as published, and all of them.

    Returns
    -------
    dict
        The last change of a campaign's state, else the last fault, with its ``kind``, ``campaign``, ``data``;
        ``text``, a sentence for a short message; ``daemon`` (rig, data, host, pid); ``events``, all of them.
    """
    campaigns = [event for event in events if event["kind"] != "fault"]
    chosen = (campaigns or list(events))[-1]
    data = chosen["data"]
    reason = str(data.get("message") or data.get("reason") or "")
    subject = chosen["campaign"] or data.get("device") or "labdaemon"
    text = f"{place.get('host')}: {subject}: {chosen['kind'].rpartition('.')[2]}" + (f": {reason}" if reason else "")
    return {**chosen, "text": text, "daemon": dict(place), "events": list(events)}
