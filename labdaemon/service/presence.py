"""Which daemons live on this computer: each keeps a locked note in a folder in memory while it takes commands.

A person with two rigs who names no address learns from it that there are two. The system lets go of the lock when the
process ends, however it ends; a note without a lock is one of a daemon that is gone.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from labdaemon.service.shaker_lock import lock_folders

log: logging.Logger = logging.getLogger(__name__)

PREFIX, SUFFIX = "labdaemon-present-", ".note"
LONGEST_NOTE = 8192  # of another version's
MOST_NOTES = 200  # looked at; other users may have put anything there


@dataclass(frozen=True, slots=True)
class PresentDaemon:
    """A daemon that lives.

    Attributes
    ----------
    commands
        Address of its commands socket.
    config
        Its rig file.
    """

    pid: int
    commands: str
    config: str


class PresenceNote:
    """Says that this process is a daemon, until `remove` or its end. Where no note can be made, none is."""

    def __init__(self, commands: str, config: str) -> None:
        self._file: int | None = None
        self._path = Path()
        note = json.dumps({"pid": os.getpid(), "commands": commands, "config": config}).encode()
        for folder in lock_folders():
            self._path = folder / f"{PREFIX}{os.getpid()}{SUFFIX}"
            with suppress(OSError):
                self._path.unlink()  # of an earlier process of this number
            try:
                flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
                self._file = os.open(self._path, flags, 0o644)
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.fchmod(self._file, 0o644)  # the service's umask must not hide it from other users
                os.write(self._file, note)
            except OSError as exc:
                log.info("no note of this daemon in %s: %s", folder, exc.strerror)
            else:
                return

    def remove(self) -> None:
        """The daemon ends."""
        if self._file is not None:
            with suppress(OSError):
                self._path.unlink()
            os.close(self._file)
            self._file = None


def present_daemons() -> list[PresentDaemon]:
    """The daemons of this computer that take commands, by process number."""
    found: dict[int, PresentDaemon] = {}
    for folder in lock_folders():
        for path in sorted(folder.glob(f"{PREFIX}*{SUFFIX}"))[:MOST_NOTES]:
            daemon = _read(path)
            if daemon is not None:
                found[daemon.pid] = daemon
    return [found[pid] for pid in sorted(found)]


def _read(path: Path) -> PresentDaemon | None:
    """The daemon of a note; None where it is gone, or what lies there is no note."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        with suppress(OSError, ValueError, KeyError, TypeError):
            note = json.loads(os.pread(file, LONGEST_NOTE, 0))
            return PresentDaemon(int(note["pid"]), str(note["commands"]), str(note["config"]))
        return None
    except OSError:
        return None
    else:
        return None
    finally:
        os.close(file)
