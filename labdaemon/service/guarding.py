"""The daemon's side of the guardian: starts it, sends it heartbeats from the event loop, replaces it when it ends.

The table moves only while a guardian listens. What the guardian does is in `labdaemon.guardian`.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial

import labdaemon
from labdaemon.clock import Clock
from labdaemon.errors import DeviceError
from labdaemon.guardian import __main__ as program
from labdaemon.guardian.recipe import StopRecipe, read_message, to_json
from labdaemon.guardian.silence import Silence, now
from labdaemon.service.shaker_lock import LockHeld, ShakerLock

log = logging.getLogger(__name__)

BEAT_S = 0.2
DEAF_S = 5.0
"""A guardian that answers no heartbeat for so long is taken for dead. Longer than its own limit for the daemon: a busy
machine must not cost a campaign."""
GOODBYE_S = 2.0
START_S, START_POLL_S = 30.0, 0.02
"""A guardian starts in a tenth of a second, where the disk answers and the machine is not busy."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 30.0


@dataclass(frozen=True, slots=True)
class GuardianSettings:
    """How a guardian behaves.

    Attributes
    ----------
    rig
        Path of the rig file, for messages.
    report
        Where it leaves what it did, for the next daemon.
    silence_s
        Silence of the daemon, with the table moving, after which it is ended.
    patience_s
        How long it tries to stop a table that does not confirm.
    """

    rig: str
    report: Path
    silence_s: float = 2.0
    patience_s: float = 600.0


class Guardian:
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
        self._process: subprocess.Popen[bytes] | None = None
        self._silence = Silence(now())
        self._beats, self._rest, self._hears = 0, b"", False
        self.on_lost: Callable[[str], None] = lambda reason: log.warning("%s", reason)
        self.longest_s = 0.0

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
        process = await asyncio.to_thread(self._launch)
        self._process, self._silence, self._rest, self._hears = process, Silence(now()), b"", False
        self._send({"beat": self._beats, "moving": self._may_move()})
        end_s = self._clock.monotonic() + START_S
        while not self._hears:
            if not self._hear() or self._clock.monotonic() > end_s:
                self._process = None
                await asyncio.to_thread(_end, process)
                raise OSError(f"the guardian did not answer ({_in_words(process.returncode)})")
            await self._clock.sleep(START_POLL_S)

    def arm(self) -> None:
        """The table is about to move.

        Raises
        ------
        DeviceError
            There is no guardian at this moment.
        """
        if not (self._hears and self._send({"beat": self._beats, "moving": True})):
            raise DeviceError("no guardian listens, so nothing moves; a new one is started", device="guardian")

    async def run(self) -> None:
        """Send heartbeats, hear the answers, and start a new guardian when one is lost, until cancelled."""
        while True:
            lost = self._beat()
            if lost is not None:
                self.on_lost(f"{lost}; the table is stopped and a new guardian is started")
                await self._replace()
            await self._clock.sleep(BEAT_S)

    async def release(self) -> None:
        """The table is at rest and the daemon ends: the guardian may go."""
        process = self._process
        if process is None:
            return
        self._send({"bye": True})
        with suppress(subprocess.TimeoutExpired):
            await asyncio.to_thread(process.wait, GOODBYE_S)
        self._forget()

    def _launch(self) -> subprocess.Popen[bytes]:
        locks: list[int] = []
        lock = None
        try:
            lock = ShakerLock(self._recipe.port, "guardian", config=self._settings.rig)
            locks = lock.descriptors
        except LockHeld as exc:
            log.warning("an earlier guardian still holds the shaker: %s", exc)
        folders = {str(Path(module.__file__).parents[1]) for module in (labdaemon, serial) if module.__file__}
        try:
            process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(program.__file__), *sorted(folders)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=_standard_error(),
                bufsize=0,
                pass_fds=locks,
                start_new_session=True,
            )
            if lock is not None:
                lock.note(pid=process.pid)
        finally:
            if lock is not None:
                lock.release()  # the guardian's own copy holds it from now on
        assert process.stdin is not None
        assert process.stdout is not None
        setup = {
            "recipe": to_json(self._recipe),
            "silence_s": self._settings.silence_s,
            "patience_s": self._settings.patience_s,
            "report": str(self._settings.report),
            "rig": self._settings.rig,
        }
        with suppress(BrokenPipeError):  # it has ended already, which `start` reports
            process.stdin.write(json.dumps(setup).encode() + b"\n")
        os.set_blocking(process.stdin.fileno(), False)
        os.set_blocking(process.stdout.fileno(), False)
        return process

    def _beat(self) -> str | None:
        """One heartbeat; why the guardian is lost, None while it is there."""
        if self._process is None:
            return "there is no guardian"
        self._beats += 1
        self._send({"beat": self._beats, "moving": self._may_move()})
        if not self._hear():
            status = self._process.poll()
            return f"the guardian (process {self._process.pid}) has ended ({_in_words(status)})"
        if self._silence.tick(now()) > DEAF_S:
            return f"the guardian (process {self._process.pid}) has not answered for {DEAF_S:g} s"
        return None

    def _send(self, message: dict[str, Any]) -> bool:
        """Write a line to it; False if it could not be written."""
        if self._process is None or self._process.stdin is None:
            return False
        try:
            os.write(self._process.stdin.fileno(), json.dumps(message).encode() + b"\n")
        except (OSError, ValueError):  # full or closed: `_beat` finds out why
            return False
        return True

    def _hear(self) -> bool:
        """Read its answers; False when it has closed its end."""
        assert self._process is not None
        assert self._process.stdout is not None
        try:
            data = os.read(self._process.stdout.fileno(), 1 << 16)
        except BlockingIOError:
            return True
        except (OSError, ValueError):
            return False
        *lines, self._rest = (self._rest + data).split(b"\n")
        for message in map(read_message, lines):
            self._hears = True
            self._silence.heard(now())
            self.longest_s = max(self.longest_s, float(message.get("longest_s", 0.0)))
        return bool(data)

    async def _replace(self) -> None:
        process, pause_s = self._process, FIRST_PAUSE_S
        self._process = None
        if process is not None:
            await asyncio.to_thread(_end, process)
        while self._process is None:
            try:
                await self.start()
            except OSError as exc:
                log.critical("no guardian can be started (%s): the table stays at rest", exc)
                await self._clock.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def _forget(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            _close_pipes(process)


def _standard_error() -> int | None:
    """Ours, unless it is a pipe: who reads it waits for its end, and would wait for the guardian's too."""
    try:
        return subprocess.DEVNULL if stat.S_ISFIFO(os.fstat(2).st_mode) else None
    except OSError:
        return subprocess.DEVNULL


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    with suppress(subprocess.TimeoutExpired):
        process.wait(GOODBYE_S)
    _close_pipes(process)


def _close_pipes(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


def _in_words(status: int | None) -> str:
    if status is None:
        return "its pipe is closed"
    return f"signal {-status}" if status < 0 else f"exit status {status}"
