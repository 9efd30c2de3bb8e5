"""The daemon's side of the guardian: starts it, sends it heartbeats from the event loop, replaces it when it ends.

The table moves only while a guardian listens. What the guardian does is in `labdaemon.guardian`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from labdaemon.clock import Clock
from labdaemon.errors import DeviceError
from labdaemon.guardian.recipe import StopRecipe, read_message
from labdaemon.guardian.silence_timer import SilenceTimer, now
from labdaemon.service.guardian_process import GuardianProcess, GuardianSettings

log: logging.Logger = logging.getLogger(__name__)

BEAT_S = 0.2  # several in the shortest silence that a rig file may allow
DEAF_S = 5.0
"""A guardian that answers no heartbeat for so long is taken for dead. Longer than its own limit for the daemon: a busy
machine must not cost a campaign."""
START_S, START_POLL_S = 30.0, 0.02
"""A guardian starts in a tenth of a second, where the disk answers and the machine is not busy."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 30.0


class GuardianSupervisor:
    """A guardian process, and the next one when it ends.

    Parameters
    ----------
    recipe
        How the shaker is stopped.
    settings
        How it behaves.
    clock
        For the heartbeat.
    may_move
        Whether the table moves, or may.

    Attributes
    ----------
    on_lost
        Called with the reason when it has ended or does not answer; a new one is then started.
    longest_s
        Longest time between two heartbeats that it saw with the table moving, seconds.
    """

    def __init__(
        self, recipe: StopRecipe, settings: GuardianSettings, clock: Clock, may_move: Callable[[], bool]
    ) -> None:
        self._recipe, self._settings, self._clock, self._may_move = recipe, settings, clock, may_move
        self._process: GuardianProcess | None = None
        self._launching: asyncio.Task[GuardianProcess] | None = None
        self._silence = SilenceTimer(now())
        self._beats, self._rest, self._is_listening = 0, b"", False
        self.on_lost: Callable[[str], None] = lambda reason: log.warning("%s", reason)
        self.longest_s: float = 0.0

    def describe(self) -> dict[str, Any]:
        """For `status`: its process (None while there is none), and the longest gap between heartbeats, seconds."""
        pid = self._process.pid if self._process is not None else None
        return {"pid": pid, "longest_gap_s": round(self.longest_s, 3)}

    async def start(self) -> None:
        """Start it, and wait until it listens.

        Raises
        ------
        OSError
            No process can be started, or it ended or did not answer.
        """
        self._launching = asyncio.create_task(asyncio.to_thread(GuardianProcess, self._recipe, self._settings))
        process = await asyncio.shield(self._launching)
        self._launching = None
        self._process, self._silence, self._rest, self._is_listening = process, SilenceTimer(now()), b"", False
        self._send({"beat": self._beats, "moving": self._may_move()})
        end_s = self._clock.monotonic() + START_S
        while not self._is_listening:
            if not self._hear() or self._clock.monotonic() > end_s:
                self._process = None
                await asyncio.to_thread(process.kill)
                raise OSError(f"the guardian did not answer ({process.describe_end()})")
            await self._clock.sleep(START_POLL_S)

    def arm(self) -> None:
        """The table is about to move.

        Raises
        ------
        DeviceError
            There is no guardian at this moment.
        """
        if not (self._is_listening and self._send({"beat": self._beats, "moving": True})):
            raise DeviceError("no guardian listens, so nothing moves; a new one is started", device="guardian")

    async def run(self) -> None:
        """Send heartbeats, hear the answers, and start a new guardian when one is lost, until cancelled."""
        while True:
            lost = self._beat()
            if lost is not None:
                try:
                    self.on_lost(f"{lost}; the table is stopped and a new guardian is started")
                except Exception:
                    log.exception("the loss of the guardian could not be reported")  # a new one matters more
                await self._replace()
            await self._clock.sleep(BEAT_S)

    async def release(self) -> None:
        """The table is at rest and the daemon ends: the guardian may go."""
        if self._launching is not None:  # a heartbeat that was cancelled in the middle of a replacement
            with suppress(OSError):
                self._process = await self._launching
        process = self._process
        if process is None:
            return
        process.send({"bye": True})
        self._process = None
        await asyncio.to_thread(process.wait)

    def leave(self) -> None:
        """The daemon ends with a table that was not seen to rest: the guardian continues when this process is gone.

        Its pipe stays open until then: closed any earlier, it would end us before our exit status says what is wrong.
        """
        if self._process is not None:
            self._process.send({"leaves": True})

    def _beat(self) -> str | None:
        """One heartbeat; why the guardian is lost, None while it is there."""
        if self._process is None:
            return "there is no guardian"
        self._beats += 1
        self._send({"beat": self._beats, "moving": self._may_move()})
        if not self._hear():
            return f"the guardian (process {self._process.pid}) has ended ({self._process.describe_end()})"
        if self._silence.tick(now()) > DEAF_S:
            return f"the guardian (process {self._process.pid}) has not answered for {DEAF_S:g} s"
        return None

    def _send(self, message: dict[str, Any]) -> bool:
        return self._process is not None and self._process.send(message)

    def _hear(self) -> bool:
        """Read its answers; False when it has closed its end."""
        data = self._process.read() if self._process is not None else None
        if data is None:
            return False
        *lines, self._rest = (self._rest + data).split(b"\n")
        for message in map(read_message, lines):
            self._is_listening = True
            self._silence.record_heartbeat(now())
            self.longest_s = max(self.longest_s, float(message.get("longest_s", 0.0)))
        return True

    async def _replace(self) -> None:
        process, pause_s = self._process, FIRST_PAUSE_S
        self._process = None
        if process is not None:
            await asyncio.to_thread(process.kill)
        while self._process is None:
            try:
                await self.start()
            except Exception as exc:  # no memory, threads, processes or descriptors: all of that may pass
                log.critical("no guardian can be started (%s): the table stays at rest", exc)
                await self._clock.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
