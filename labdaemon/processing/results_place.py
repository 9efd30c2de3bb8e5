"""Where a folder's results are written: one writer a file, also while a daemon keeps the folder of its campaign."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from labdaemon.journal.journal import FILE_NAME
from labdaemon.journal.storage import LOCK_NAME

RESULTS = "results"
FILES = ("envelope.csv", "measurements.csv")
ENDED = ("completed", "aborted", "failed")

Stamp = tuple[int, int, int]
"""Inode, size in bytes and time of change (ns) of a file: another's write changes one of them."""


def stamps(folder: Path) -> tuple[Stamp | None, ...]:
    """The state of a data-set folder's result files, None for one that is not there."""
    return tuple(_stamp(folder / RESULTS / name) for name in FILES)


def process_in_use(folder: Path) -> int | None:
    """The process of the daemon that still writes to a campaign's folder; None where there is none.

    The daemon's lock is not tried, since a daemon that starts in that moment would take it for another's.
    """
    data = folder.resolve().parent.parent
    try:
        holder = int((data / LOCK_NAME).read_text(encoding="ascii"))
        os.kill(holder, 0)
    except PermissionError:
        pass  # it runs, as another user
    except (OSError, ValueError, OverflowError):
        return None
    try:
        place = f"{(data / FILE_NAME).as_uri()}?mode=ro"
        with closing(sqlite3.connect(place, 2.0, uri=True)) as journal:
            states = journal.execute("SELECT state FROM campaigns WHERE id = ?", (folder.resolve().name,)).fetchall()
    except sqlite3.Error:
        return holder  # it cannot be asked, so it may be
    return holder if states and states[0][0] not in ENDED else None


@dataclass(frozen=True, slots=True)
class ResultsFolders:
    """Where results go, chosen when work begins and looked at once more when it is done.

    Attributes
    ----------
    folder
        The data-set folder.
    found
        State of its result files when work began.
    """

    folder: Path
    found: tuple[Stamp | None, ...]

    @classmethod
    def of(cls, folder: Path) -> ResultsFolders:
        """The usual place in a folder, as it is now."""
        return cls(folder, stamps(folder))

    def choose(self) -> tuple[Path, str | None]:
        """Where to write now, and why it is not the usual place."""
        holder = process_in_use(self.folder)
        if holder is not None:
            reason = f"the daemon (process {holder}) still writes to {self.folder / RESULTS}"
        elif stamps(self.folder) != self.found:
            reason = f"{self.folder / RESULTS} was written to meanwhile"
        else:
            return self.folder / RESULTS, None
        places = (self.folder / f"{RESULTS}-{number}" for number in count(2))
        place = next(place for place in places if not place.exists())
        return place, f"{reason}: these results are in {place.name}"


def _stamp(path: Path) -> Stamp | None:
    try:
        about = path.stat()
    except OSError:  # not there (any more): it has no state to compare
        return None
    return about.st_ino, about.st_size, about.st_mtime_ns
