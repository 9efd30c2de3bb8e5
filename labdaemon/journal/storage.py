"""The data folder's disk: who may write to it, and what a failed write means."""

from __future__ import annotations

import errno
import fcntl
import os
import sqlite3
from pathlib import Path
from typing import IO

from labdaemon.errors import DataError

LOCK_NAME = "journal.lock"
FULL = (errno.ENOSPC, errno.EDQUOT)
FORBIDDEN = (errno.EACCES, errno.EROFS, errno.EPERM)


class JournalError(DataError):
    """The journal cannot be read or written."""


class StorageFull(DataError):
    """No space is left. Nothing was lost: what had been committed stays, what had not is repeated."""

    retryable = True
    exit_status = 1


def as_data_error(exc: sqlite3.Error | OSError, file: Path) -> DataError:
    """Say what a failed read or write means and what to do about it."""
    text, number = str(exc).lower(), getattr(exc, "errno", None)
    if number in FULL or "full" in text:
        return StorageFull("the disk is full; free some space, the daemon then goes on by itself", file=file)
    if number in FORBIDDEN or "readonly" in text or "unable to open" in text:
        return JournalError("cannot be written (read-only disk or missing permission); remount or chown it", file=file)
    if any(word in text for word in ("malformed", "not a database", "corrupt")):
        return JournalError(
            "the journal is damaged and was left as it is; start with --new-journal to set it aside and begin another",
            file=file,
        )
    return JournalError(f"{exc}; check the disk", file=file)


class DataLock:
    """Holds a data folder for one daemon; the system lets go of it when the process dies, however it does.

    Parameters
    ----------
    folder
        Made if absent.

    Raises
    ------
    JournalError
        Another process holds it, or it cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        path = folder / LOCK_NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file: IO[str] = path.open("a+", encoding="ascii")
        except OSError as exc:
            raise as_data_error(exc, folder) from exc
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as exc:
            self._file.seek(0)
            holder = self._file.read().strip() or "unknown"
            self._file.close()
            raise JournalError(
                f"another labdaemon (process {holder}) is using this data folder; stop it or give another --data",
                file=folder,
            ) from exc
        self._file.truncate(0)
        self._file.write(f"{os.getpid()}\n")
        self._file.flush()

    def release(self) -> None:
        """Let another daemon have it."""
        self._file.close()
