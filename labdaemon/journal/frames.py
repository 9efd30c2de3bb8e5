"""Frames on disk: written as ``.part``, synced, renamed, their folder synced, and only then vouched for.

A file under its final name can be trusted to be whole; one that ends in ``.part`` is left from an interrupted copy.
"""

from __future__ import annotations

import errno
import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

from labdaemon.durable import PART, is_being_written, make_folder, storage_error, sync_file, sync_folder
from labdaemon.errors import DataError
from labdaemon.file_hash import sha256_of

BLOCK_BYTES = 1 << 20  # hashing is as quick as with larger ones

NO_LINKS = frozenset(
    {errno.EPERM, errno.EACCES, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL, errno.EMLINK, errno.EXDEV}
)
"""What a file system without hard links says (Linux: EPERM)."""

_RENAMES = threading.Lock()


class NameTaken(DataError):
    """A frame's final name belongs to another frame. Nothing was changed."""


def part_of(path: Path) -> Path:
    """Where a file is written before it is whole; its folder is made."""
    make_folder(path.parent)
    return path.with_name(path.name + PART)


def seal_new(path: Path, size_bytes: int | None = None) -> tuple[Path, int, str]:
    """Make a written ``.part`` durable under the first name of `numbered` that no other frame has.

    Parameters
    ----------
    path
        The wanted name. A file of the same content that has it already is that frame, sealed before a crash.
    size_bytes
        What its size must be; None if unknown.

    Returns
    -------
    The name it has, its size in bytes and the SHA-256 (hex) of what is on disk.

    Raises
    ------
    DataError
        The size is not what it must be; the ``.part`` is removed, so that it can be fetched again.
    StorageError
        The disk does not take it.
    """
    part = part_of(path)
    try:
        written, sha256 = _read_and_sync(part, path, size_bytes)
        for place in numbered(path):
            with suppress(NameTaken):  # another frame's file stays as it is: the next number may be free
                _place(part, place, sha256)
                return place, written, sha256
    except OSError as exc:
        raise storage_error(exc, path) from exc
    raise AssertionError("numbers do not end")


def numbered(path: Path) -> Iterator[Path]:
    """`path`, then ``STEM~2``, ``STEM~3`` … of the same ending (``-2`` is the second frame of a sharp set)."""
    yield path
    for number in count(2):
        yield path.with_name(f"{path.stem}~{number}{path.suffix}")


def move_new(path: Path, to: Path) -> Path:
    """Move a frame to the first free name of `to` and those after it, synced; returns which.

    Raises
    ------
    StorageError
        It cannot be moved.
    """
    make_folder(to.parent)
    try:
        for place in numbered(to):
            with suppress(FileExistsError):  # another frame has this number: the next one may be free
                _rename_new(path, place)
                sync_folder(to.parent)
                sync_folder(path.parent)
                return place
    except OSError as exc:
        raise storage_error(exc, path) from exc
    raise AssertionError("numbers do not end")


def holds(path: Path, size_bytes: int, sha256: str) -> bool:
    """Whether this file is that frame; False where it is not there."""
    try:
        return path.stat().st_size == size_bytes and sha256_of(path) == sha256
    except OSError:  # not there or not readable: it cannot be vouched for
        return False


def _read_and_sync(part: Path, path: Path, size_bytes: int | None) -> tuple[int, str]:
    """Size and SHA-256 of a ``.part`` that is synced when this returns."""
    digest = hashlib.sha256()
    with part.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            digest.update(block)
        written = file.tell()
        if size_bytes is not None and written != size_bytes:
            part.unlink()
            raise DataError(f"has {written} bytes, the camera said {size_bytes}; fetch it again", file=path)
        sync_file(file.fileno(), path)
    return written, digest.hexdigest()


def _place(part: Path, path: Path, sha256: str) -> None:
    """Give a synced ``.part`` its final name, if no other file has it."""
    try:
        _rename_new(part, path)
    except FileExistsError:
        if sha256_of(path) != sha256:
            raise NameTaken("another frame has this name", file=path) from None
        part.unlink()
    sync_folder(path.parent)


def _rename_new(path: Path, to: Path) -> None:
    """Rename, but never over a file; raises `FileExistsError`."""
    try:
        os.link(path, to)
    except FileExistsError:
        raise
    except OSError as exc:
        if exc.errno not in NO_LINKS:
            raise
        # No links here (exFAT, some shares): no other process writes to a locked data folder, so looking is enough.
        with _RENAMES:
            if to.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(to)) from None
            path.rename(to)
    else:
        path.unlink()


def remove_parts(root: Path) -> list[Path]:
    """Remove every ``.part`` under `root` and return their paths.

    After a power cut a part's length may promise bytes that never reached the disk, so none is gone on with.
    """
    parts = [part for part in sorted(root.rglob(f"*{PART}")) if not is_being_written(part)]
    for part in parts:
        part.unlink(missing_ok=True)
    return parts
