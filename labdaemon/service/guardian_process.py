"""One guardian as a process: started with its pipes and the shaker's lock, written to, read from, ended."""

from __future__ import annotations

import json
import logging
import os
import stat
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial

import labdaemon
from labdaemon.guardian import __main__ as program
from labdaemon.guardian.recipe import StopRecipe, to_json
from labdaemon.service.shaker_lock import ShakerLock, ShakerLockConflict

log: logging.Logger = logging.getLogger(__name__)

END_S = 2.0
"""Longest wait for its end, after a goodbye or a kill."""


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


class GuardianProcess:
    """Starts a guardian; blocks for as long as the system takes to start a process.

    Its pipes are bare descriptors: the interpreter closes file objects while it ends, and a closed pipe means to the
    guardian that the daemon is gone.

    Parameters
    ----------
    recipe
        How the shaker is stopped.
    settings
        How it behaves.

    Raises
    ------
    OSError
        No process can be started.
    """

    def __init__(self, recipe: StopRecipe, settings: GuardianSettings) -> None:
        lock = _lock(recipe.port, settings.rig)
        theirs, self._to = os.pipe()
        self._from, answers = os.pipe()
        folders = {str(Path(module.__file__).parents[1]) for module in (labdaemon, serial) if module.__file__}
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(program.__file__), *sorted(folders)],
                stdin=theirs,
                stdout=answers,
                stderr=_standard_error(),
                pass_fds=lock.descriptors if lock is not None else (),
                start_new_session=True,
            )
            if lock is not None:
                lock.note(pid=self._process.pid)
        except OSError:  # standard error is closed: there is nothing to write to
            self._close()
            raise
        finally:
            os.close(theirs)
            os.close(answers)
            if lock is not None:
                lock.release()  # the guardian's own copy holds it from now on
        self.send(
            {
                "daemon": os.getpid(),
                "recipe": to_json(recipe),
                "silence_s": settings.silence_s,
                "patience_s": settings.patience_s,
                "report": str(settings.report),
                "rig": settings.rig,
            }
        )
        os.set_blocking(self._to, False)
        os.set_blocking(self._from, False)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def send(self, message: dict[str, Any]) -> bool:
        """Write a line to it, without waiting; False if it could not be written."""
        try:
            os.write(self._to, json.dumps(message).encode() + b"\n")
        except OSError:  # full, or nothing reads it any more
            return False
        return True

    def read(self) -> bytes | None:
        """What it has answered, without waiting; None once it has closed its end."""
        try:
            return os.read(self._from, 1 << 16) or None
        except BlockingIOError:  # nothing has come since
            return b""
        except OSError:  # its end of the pipe is gone, as after its death
            return None

    def describe_end(self) -> str:
        """How it ended, in words."""
        status = self._process.poll()
        if status is None:
            return "its pipe is closed"
        return f"signal {-status}" if status < 0 else f"exit status {status}"

    def wait(self) -> None:
        """Let it end by itself after a goodbye, and give the pipes back. Blocks."""
        with suppress(subprocess.TimeoutExpired):  # it ends by itself once its pipes are closed
            self._process.wait(END_S)
        self._close()

    def kill(self) -> None:
        """End it at once, and give the pipes back. Blocks."""
        self._process.kill()
        self.wait()

    def _close(self) -> None:
        os.close(self._to)
        os.close(self._from)


def _lock(port: str, rig: str) -> ShakerLock | None:
    try:
        return ShakerLock(port, "guardian", config=rig)
    except ShakerLockConflict as exc:
        log.warning("an earlier guardian still holds the shaker: %s", exc)
        return None


def _standard_error() -> int | None:
    """Ours, unless it is a pipe: who reads it waits for its end, and would wait for the guardian's too."""
    try:
        return subprocess.DEVNULL if stat.S_ISFIFO(os.fstat(2).st_mode) else None
    except OSError:
        return subprocess.DEVNULL
