"""Whether a path leads to a file that can be read to its end: a pipe makes its reader wait for a writer."""

from __future__ import annotations

from pathlib import Path

from labdaemon.errors import DataError


def check_plain_file(path: Path) -> None:
    """Refuse a folder, a pipe, a socket or a device; a path that leads nowhere is left to whoever opens it.

    Raises
    ------
    DataError
        It is no file.
    """
    if path.exists() and not path.is_file():
        raise DataError("cannot be read: it is no file, but a folder or a device", file=path)
