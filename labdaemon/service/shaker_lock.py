"""One daemon a shaker: a lock file keyed by the shaker's port, which says who holds it and how to reach them.

A serial device file can be locked by itself, a port behind ``socket://`` or ``rfc2217://`` cannot. So the lock is a
file of ours in a folder that lies in memory, and works while disks are full or read-only. The system lets go of it when
its process ends, however it ends; the file stays and is taken again. Whoever wants to stop the table is never held up
by a lock that cannot be made: that is a warning. Standard library only, so that a guardian process may use it.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import logging
import os
import re
import socket
import stat
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from labdaemon.errors import ConfigError

log: logging.Logger = logging.getLogger(__name__)

Role = Literal["daemon", "guardian"]

IN_PROCESS = ("sim", "loop")
"""URL schemes of devices that live in the daemon's own process: no other process can reach them."""

FOLDER_VARIABLE = "LABDAEMON_LOCKS"
POLL_S = 0.05  # a lock is waited for while its holder ends
NOTE_BYTES = 1024  # a path of any length is cut to fit
LONGEST_NOTE = 8192  # of another version's


class ShakerLockConflict(ConfigError):
    """Another process holds the shaker; `holder` says which."""

    def __init__(self, message: str, holder: LockHolder) -> None:
        self.holder = holder
        super().__init__(message, key="shaker.port")


@dataclass(frozen=True, slots=True)
class LockHolder:
    """Who holds a lock.

    Attributes
    ----------
    pid
        Its process, None if the file does not say.
    commands
        Address of its command socket, empty before it is bound.
    config
        The rig file it was started with.
    """

    pid: int | None
    role: str = ""
    commands: str = ""
    config: str = ""


def is_in_process(port: str) -> bool:
    """Whether a port's device lives in the process that opens it."""
    return port.partition("://")[0].lower() in IN_PROCESS and "://" in port


def lock_keys(port: str) -> tuple[str, ...]:
    """Names under which a port is locked; two ports that share one are the same port.

    A device file counts by the name that was written and by the file that it leads to now, since a link of
    ``/dev/serial/by-id`` is gone while its device is. A network port counts by host and number, whatever protocol.

    >>> lock_keys("socket://localhost:4001?logging=debug") == lock_keys("rfc2217://127.0.0.1:4001")
    True
    """
    scheme, separator, rest = port.partition("://")
    if separator:
        place = re.split(r"[/?#]", rest, maxsplit=1)[0].lower()
        host, _, number = place.rpartition(":")
        if host in ("localhost", "[::1]", "::1", "ip6-localhost", socket.gethostname().lower()):
            host = "127.0.0.1"
        written = f"{host}:{number}"
        # schemes other than the network's may name anything: they keep their own name
        if scheme.lower() not in ("socket", "rfc2217", "tcp", "telnet", "ssl"):
            written = f"{scheme.lower()}://{rest}"
        return (_name(written),)
    return tuple(sorted({_name(os.path.abspath(port)), _name(os.path.realpath(port))}))


def lock_folders() -> tuple[Path, ...]:
    """Where lock files may lie, best first. All are searched, since not every user can write to each."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named:
        return (Path(named),)
    return (Path("/run/lock"), Path("/dev/shm"), Path(tempfile.gettempdir()))


class ShakerLock:
    """Holds a shaker's port for one process of a role; `release`, or the end of the process, lets go of it.

    Parameters
    ----------
    port
        The shaker's port as the rig file names it.
    role
        A daemon and its guardian hold a lock each.
    commands, config
        For whoever finds the lock held, see `LockHolder`; `note` changes them later.

    Raises
    ------
    ShakerLockConflict
        Another process holds it.
    """

    def __init__(self, port: str, role: Role, *, commands: str = "", config: str = "") -> None:
        self.port: str = port
        self.role = role
        self._note = LockHolder(os.getpid(), role, commands, config)
        self._files: list[int] = []
        if is_in_process(port):
            return
        try:
            for key in lock_keys(port):
                self._take(f"{key}.{role}")
        except ShakerLockConflict:
            self.release()
            raise
        self._write()

    @property
    def descriptors(self) -> list[int]:
        """Its open files: a process that inherits them holds the lock until it ends, too."""
        return list(self._files)

    def note(self, *, commands: str = "", pid: int | None = None) -> None:
        """Say where the holder takes commands, and who it is where another process inherits the lock."""
        self._note = LockHolder(pid or self._note.pid, self.role, commands, self._note.config)
        self._write()

    def release(self) -> None:
        """Let another process have it; harmless when it is not held."""
        files, self._files = self._files, []
        for file in files:
            os.close(file)

    def _take(self, name: str) -> None:
        """Lock every file of this name, and make one in the first folder that takes it if there is none."""
        paths = [folder / name for folder in lock_folders()]
        existing = [path for path in paths if os.path.lexists(path)]
        reasons = [reason for path in existing if (reason := self._lock(path)) is not None]
        if len(reasons) < len(existing):
            return
        for path in paths:
            reason = self._lock(path)
            if reason is None:
                return
            reasons.append(reason)
        # Stopping the table matters more than keeping a second daemon off, so this is no refusal.
        log.warning("the shaker's lock cannot be made, so no second daemon is kept off (%s)", "; ".join(reasons))

    def _lock(self, path: Path) -> str | None:
        """Lock one file; why it cannot be done, None once it is locked."""
        try:
            file = _open(path)
        except OSError as exc:
            return f"{path}: {exc.strerror or exc}"
        for tries_left in range(2, -1, -1):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if tries_left:  # `lock_holder` of a third process holds it for a moment
                    time.sleep(POLL_S)
                    continue
                holder = _read(file)
                os.close(file)
                raise _held(self.port, holder) from None
            except OSError as exc:
                os.close(file)
                return f"{path}: {exc.strerror or exc}"
            break
        self._files.append(file)
        return None

    def _write(self) -> None:
        note = {"pid": self._note.pid, "role": self.role, "commands": self._note.commands, "config": self._note.config}
        text = json.dumps(note).encode()
        for file in self._files:
            with suppress(OSError):  # another user's file, or no room: then the holder is not named
                # One write of one length, blanks at the end, so that no reader meets half of it.
                os.pwrite(file, text.ljust(NOTE_BYTES), 0)


def lock_holder(port: str, role: Role) -> LockHolder | None:
    """Who holds a port's lock now; None when it is free. Takes nothing for longer than a moment."""
    if is_in_process(port):
        return None
    for key in lock_keys(port):
        for folder in lock_folders():
            try:
                file = os.open(folder / f"{key}.{role}", os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            except OSError:
                continue
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:  # the daemon or guardian holds it
                return _read(file)
            except OSError:
                continue
            finally:
                os.close(file)
    return None


def wait_free(port: str, role: Role, timeout_s: float) -> LockHolder | None:
    """Wait until the lock is free; who still holds it after `timeout_s` seconds, None if it is free."""
    end_s = time.monotonic() + timeout_s
    while (holder := lock_holder(port, role)) is not None and time.monotonic() < end_s:
        time.sleep(POLL_S)
    return holder


def _name(written: str) -> str:
    readable = re.sub(r"[^A-Za-z0-9]+", "-", written).strip("-")[-40:]
    return f"labdaemon-{readable}-{hashlib.sha256(written.encode()).hexdigest()[:12]}"


def _open(path: Path) -> int:
    """Open a lock file, made if absent; another user's is opened for reading, which is enough to lock it."""
    flags = os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        file = os.open(path, flags | os.O_RDWR)
    except FileNotFoundError:
        file = os.open(path, flags | os.O_RDWR | os.O_CREAT, 0o644)
        with suppress(OSError):
            os.fchmod(file, 0o644)  # the service's umask must not hide it from a person's `safe-stop`
    except PermissionError:
        file = os.open(path, flags | os.O_RDONLY)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise OSError(0, "is no regular file")
    return file


def _read(file: int) -> LockHolder:
    # a note that is being written: nothing is known of it
    with suppress(OSError, ValueError, TypeError, AttributeError):
        note = json.loads(os.pread(file, LONGEST_NOTE, 0).decode())
        pid = note.get("pid")
        return LockHolder(
            pid if isinstance(pid, int) else None,
            *(str(note.get(key, ""))[:LONGEST_NOTE] for key in ("role", "commands", "config")),
        )
    return LockHolder(None)


def _held(port: str, holder: LockHolder) -> ShakerLockConflict:
    pid = "unknown" if holder.pid is None else holder.pid
    of = f" for {holder.config}" if holder.config else ""
    return ShakerLockConflict(
        f"another labdaemon (process {pid}{of}) holds the shaker on {port}, and its table was left alone; "
        "end that one first",
        holder,
    )
