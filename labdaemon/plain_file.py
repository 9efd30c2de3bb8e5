"""Files and folders as they are found: pipes that make a reader wait for a writer, folders that may not be read."""

from __future__ import annotations

import os
from pathlib import Path

from labdaemon.errors import DataError


def check_plain_file(path: Path) -> None:
    """Refuse a folder, a pipe, a socket or a device; a path that leads nowhere is left to whoever opens it.

    Raises
    ------
    DataError
        It is no file.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # Path's own tests raise where a folder may not be entered
        raise DataError("cannot be read: it is no file, but a folder or a device", file=path)


def entries(folder: Path) -> list[tuple[Path, bool]]:
    """What lies in a folder, in order of names, and whether it is a folder itself.

    Raises
    ------
    DataError
        The folder cannot be read.
    """
    try:
        with os.scandir(folder) as found:
            return sorted(
                (folder / one.name, os.path.isdir(one) if one.is_symlink() else one.is_dir()) for one in found
            )
    except OSError as exc:
        raise DataError(f"the folder cannot be read ({exc.strerror or exc})", file=folder) from None
