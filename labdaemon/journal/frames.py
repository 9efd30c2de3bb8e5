"""Frames on disk: written as ``.part``, synced, renamed, their folder synced, and only then vouched for.

Whoever finds a file under its final name can trust it to be whole; whatever ends in ``.part`` is an accident's trace.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from labdaemon.durable import PART, is_being_written, make_folder, storage_error, sync_file, sync_folder
from labdaemon.errors import DataError

BLOCK_BYTES = 1 << 20


def part_of(path: Path) -> Path:
    """Where a file is written before it is whole; its folder is made."""
    make_folder(path.parent)
    return path.with_name(path.name + PART)


def seal(path: Path, size_bytes: int | None = None) -> tuple[int, str]:
    """Make a written ``.part`` durable under its final name.

    Parameters
    ----------
    path
        The final name.
    size_bytes
        What its size must be; None if unknown.

    Returns
    -------
    Size in bytes and SHA-256 (hex) of what is on disk.

    Raises
    ------
    DataError
        The size is not what it must be; the ``.part`` is removed, so that it can be fetched again.
    """
    part = part_of(path)
    digest = hashlib.sha256()
    try:
        with part.open("rb") as file:
            while block := file.read(BLOCK_BYTES):
                digest.update(block)
            written = file.tell()
            if size_bytes is not None and written != size_bytes:
                part.unlink()
                raise DataError(f"has {written} bytes, the camera said {size_bytes}; fetch it again", file=path)
            sync_file(file.fileno(), path)
        part.rename(path)
        sync_folder(path.parent)
    except OSError as exc:
        raise storage_error(exc, path) from exc
    return written, digest.hexdigest()


def remove_parts(root: Path) -> list[Path]:
    """Remove every ``.part`` under `root` and tell which they were.

    After a power cut a part's length may promise bytes that never reached the disk, so none is gone on with.
    """
    parts = [part for part in sorted(root.rglob(f"*{PART}")) if not is_being_written(part)]
    for part in parts:
        part.unlink(missing_ok=True)
    return parts
