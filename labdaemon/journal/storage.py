"""The data folder's disk: who may write to it, and what a failed write means."""

from __future__ import annotations

import errno
import fcntl
import os
import sqlite3
from pathlib import Path
from typing import IO

from labdaemon.durable import make_folder, probe_folder, storage_error, warn_once
from labdaemon.errors import StorageError, StorageFull, StorageUnavailable

LOCK_NAME = "journal.lock"

HELD = frozenset({errno.EWOULDBLOCK, errno.EACCES})
"""What flock answers when another process has the lock; all else means that it knows no locks."""

PRIMARY = 0xFF
"""SQLite's extended result codes carry the primary one in their lowest byte."""


class JournalError(StorageError):
    """The journal is damaged, another program's, a newer version's, or another daemon's: a person must decide."""


class JournalLocked(StorageUnavailable):
    """Another process, a backup for example, holds the journal's lock."""


def as_data_error(exc: sqlite3.Error | OSError, file: Path, *, is_read: bool = False) -> StorageError:
    """Say what a failed read or write means and what to do about it.

    A read may be the event loop's, so the disk is not asked by writing to it.
    """
    if isinstance(exc, OSError):
        return storage_error(exc, file)
    text = str(exc).lower()
    match getattr(exc, "sqlite_errorcode", 0) & PRIMARY:
        case sqlite3.SQLITE_FULL:
            return StorageFull("the disk is full; free some space, the daemon then continues by itself", file=file)
        case sqlite3.SQLITE_BUSY | sqlite3.SQLITE_LOCKED | sqlite3.SQLITE_PROTOCOL:
            return JournalLocked("another process has locked the journal; the daemon waits until it lets go", file=file)
        case sqlite3.SQLITE_READONLY | sqlite3.SQLITE_CANTOPEN | sqlite3.SQLITE_PERM:
            return StorageUnavailable(
                "cannot be written (read-only disk, missing permission or moved away); remount, chown or put it back",
                file=file,
            )
        case sqlite3.SQLITE_IOERR if not is_read:
            return _of_disk(exc, file)
        case sqlite3.SQLITE_IOERR:
            return StorageUnavailable(f"the disk does not answer ({exc}); check that it is connected", file=file)
    if "closed database" in text:
        return StorageUnavailable("the journal is closed: this daemon is ending; nothing is lost", file=file)
    if any(word in text for word in ("malformed", "not a database", "corrupt")):
        return JournalError(
            "the journal is damaged and was left as it is; start with --new-journal to set it aside and begin another",
            file=file,
        )
    return JournalError(f"{exc}; check the disk", file=file)


def probe_disk(journal: Path) -> None:
    """Show that the disk takes a file now that is as long as the journal's longest.

    Raises
    ------
    StorageError
        It does not.
    """
    lengths = [path.stat().st_size for path in journal.parent.glob(f"{journal.name}*")]
    probe_folder(journal.parent, max(lengths, default=0))


def _of_disk(exc: sqlite3.Error, file: Path) -> StorageError:
    """SQLite calls a used up quota, a failed sync and a lost disk all an I/O error: ask the disk itself."""
    try:
        probe_disk(file)
    except StorageError as cause:
        return cause if cause.retryable else StorageUnavailable(str(cause))
    except OSError as cause:
        return StorageUnavailable(f"the disk does not answer ({cause}); check that it is connected", file=file)
    return StorageUnavailable(f"the disk does not answer ({exc}); check that it is connected", file=file)


class DataLock:
    """Holds a data folder for one daemon; the system lets go of it when the process dies, however it does.

    Parameters
    ----------
    folder
        Made if absent.

    Raises
    ------
    JournalError
        Another process holds it.
    StorageError
        It cannot be made or written.
    """

    def __init__(self, folder: Path) -> None:
        path = folder / LOCK_NAME
        make_folder(folder)
        try:
            self._file: IO[str] = path.open("a+", encoding="ascii")
        except OSError as exc:
            raise storage_error(exc, folder) from exc
        try:
            self._take(folder)
            os.ftruncate(self._file.fileno(), 0)
            os.write(self._file.fileno(), f"{os.getpid()}\n".encode())
        except OSError as exc:
            # The number is for people only: a full disk must not keep the daemon from the folder's lock.
            if storage_error(exc, folder).retryable:
                return
            self._file.close()
            raise storage_error(exc, folder) from exc
        except BaseException:
            self._file.close()
            raise

    def _take(self, folder: Path) -> None:
        for lock in (fcntl.flock, fcntl.lockf):  # shares often know the second kind only
            try:
                lock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as exc:
                if exc.errno in HELD:
                    self._file.seek(0)
                    holder = self._file.read().strip() or "unknown"
                    raise JournalError(
                        f"another labdaemon (process {holder}) uses this data folder; stop it or give another --data",
                        file=folder,
                    ) from exc
            else:
                return
        warn_once(folder, "this file system knows no locks: nothing keeps a second daemon from this folder")

    def release(self) -> None:
        """Let another daemon have it."""
        self._file.close()
