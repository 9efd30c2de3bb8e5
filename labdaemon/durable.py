"""The one way to put files on a disk so that a power cut leaves them whole or absent.

A file is written under a temporary name that ends in ``.part``, synced, renamed, and its folder synced; a new folder is
synced into its parent. Whoever finds a file under its final name can trust it to be whole. Everything here blocks: call
it off the event loop.
"""

from __future__ import annotations

import errno
import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import BinaryIO

from labdaemon.errors import StorageError, StorageFull, StorageUnavailable

log: logging.Logger = logging.getLogger(__name__)

PART = ".part"

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""EFBIG is what RLIMIT_FSIZE and the quotas of some network shares answer."""

FORBIDDEN = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})

ABSENT = frozenset(
    {errno.EIO, errno.EBUSY, errno.EAGAIN, errno.ESTALE, errno.ENODEV, errno.ENXIO, errno.ENOMEDIUM, errno.ENOTCONN}
    | {errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT, errno.EREMOTEIO, errno.ECONNRESET}
)
"""What a disk that is unplugged, busy or on a network without answer says: it may come back."""

CANNOT_SYNC = frozenset(
    {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.ENOTTY, errno.EBADF, errno.EISDIR}
)
"""A file system that knows no fsync of a directory (CIFS, VirtualBox, some FUSE) says one of these. Its renames are as
durable as the server makes them, and no program can do better; an I/O error is something else and is raised."""

CANNOT_OPEN_FOLDER = CANNOT_SYNC | {errno.EACCES, errno.EPERM}
"""A folder may be writable and yet not readable: then it cannot be opened to be synced."""

PROBE_BYTES = 1 << 16  # larger than what a full file system still finds room for in its metadata

_warned: set[tuple[int, str]] = set()
"""File systems (device number) about which a warning was logged, and which warning."""


def storage_error(exc: OSError, file: Path) -> StorageError:
    """Say what a failed read or write means and what to do about it."""
    if exc.errno in FULL:
        return StorageFull("the disk is full; free some space, the daemon then continues by itself", file=file)
    if exc.errno in FORBIDDEN:
        return StorageError("cannot be written (read-only disk or missing permission); remount or chown it", file=file)
    if exc.errno in ABSENT:
        return StorageUnavailable(f"the disk does not answer ({exc.strerror}); check that it is connected", file=file)
    return StorageError(f"cannot be written: {exc.strerror or exc}", file=file)


def sync_file(handle: int, path: Path) -> None:
    """Sync an open file; a file system that knows no fsync is used with one warning."""
    try:
        os.fsync(handle)
    except OSError as exc:
        if exc.errno not in CANNOT_SYNC:
            raise
        _warn_of_files(path.parent, exc)


def sync_folder(folder: Path) -> None:
    """Make what was created, renamed or removed in a folder durable; where that cannot be done, warn once."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as exc:
        if exc.errno not in CANNOT_OPEN_FOLDER:
            raise
        _warn_of_folder(folder, exc)
        return
    try:
        os.fsync(handle)
    except OSError as exc:
        if exc.errno not in CANNOT_SYNC:
            raise
        _warn_of_folder(folder, exc)
    finally:
        os.close(handle)


def make_folder(folder: Path) -> None:
    """Make a folder with its parents, each synced into the one above it.

    Raises
    ------
    StorageError
        It cannot be made.
    """
    absent: list[Path] = []
    place = folder
    try:
        while not place.is_dir():
            absent.append(place)
            if place.parent == place:
                break
            place = place.parent
        for path in reversed(absent):
            path.mkdir(exist_ok=True)
            sync_folder(path.parent)
    except OSError as exc:
        raise storage_error(exc, folder) from exc


def check_place(folder: Path, files: Iterable[str]) -> None:
    """Check that files can be written in a folder, before the work whose results they are to hold; nothing is made.

    Raises
    ------
    StorageError
        The folder, or the nearest one above it, is a file or may not be written, or one of the files is a folder.
    """
    place = folder
    while not os.path.lexists(place) and place.parent != place:  # a link that leads nowhere is in the way as well
        place = place.parent
    number = 0
    if not place.is_dir():
        number = errno.ENOTDIR
    elif not os.access(place, os.W_OK | os.X_OK):
        number = errno.EACCES
    taken = [folder / name for name in files if (folder / name).is_dir()]
    if number or taken:
        number, place = (number, place) if number else (errno.EISDIR, taken[0])
        raise storage_error(OSError(number, os.strerror(number)), place)


def write_durably(path: Path, content: bytes | str) -> None:
    """Replace a small file whole or not at all, synced; its folder is made.

    Raises
    ------
    StorageError
        It cannot be written; what was there stays.
    """
    with whole_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Write a file of any length: it takes its name, whole and synced, when the block is left without an error.

    Raises
    ------
    StorageError
        It cannot be written; what was there stays.
    """
    make_folder(path.parent)
    # The process' number keeps two processes that write the same file from renaming each other's half.
    part = path.with_name(f".{path.name}.{os.getpid()}{PART}")
    try:
        with part.open("wb") as file:
            yield file
            file.flush()
            sync_file(file.fileno(), path)
        part.replace(path)
        sync_folder(path.parent)
    except OSError as exc:
        _discard(part)
        raise storage_error(exc, path) from exc
    except BaseException:
        _discard(part)
        raise


def is_being_written(part: Path) -> bool:
    """Whether another process that lives writes this temporary file of `whole_file`."""
    number = part.name.removesuffix(PART).rpartition(".")[2]
    if not (part.name.startswith(".") and number.isdecimal()) or int(number) == os.getpid():
        return False
    try:
        os.kill(int(number), 0)
    except PermissionError:  # it lives, as another user's process
        return True
    except (OSError, OverflowError):  # no process has this number
        return False
    return True


def append_durably(path: Path, content: bytes | str) -> None:
    """Add to a file's end and sync it; a write that fails halfway is taken back.

    Raises
    ------
    StorageError
        It cannot be written; the file is as it was, where the disk allows even that.
    """
    make_folder(path.parent)
    data = content.encode() if isinstance(content, str) else content
    try:
        is_new = not path.exists()
        # Without a buffer, since closing one would write again what was just taken back.
        with path.open("ab", buffering=0) as file:
            end = file.seek(0, os.SEEK_END)
            try:
                _write_all(file, data)
                sync_file(file.fileno(), path)
            except OSError:
                with suppress(OSError):  # the journal has the rows, and the file is written anew from it
                    os.ftruncate(file.fileno(), end)
                raise
        if is_new:
            sync_folder(path.parent)
    except OSError as exc:
        raise storage_error(exc, path) from exc


def move_durably(path: Path, to: Path) -> None:
    """Rename a file into another folder of the same file system, synced.

    Raises
    ------
    StorageError
        It cannot be moved.
    """
    make_folder(to.parent)
    try:
        path.rename(to)
        sync_folder(to.parent)
        sync_folder(path.parent)
    except OSError as exc:
        raise storage_error(exc, path) from exc


def probe_folder(folder: Path, at_byte: int = 0) -> None:
    """Show that a folder takes a file now, and nothing else: free space says nothing of quotas.

    Parameters
    ----------
    folder
        It must be there.
    at_byte
        Where in the file to write: past the length of the longest file that must still grow, for limits on length.

    Raises
    ------
    StorageError
        It does not; `StorageFull` if there is no room.
    """
    part = folder / f".probe.{os.getpid()}{PART}"
    try:
        with part.open("wb", buffering=0) as file:
            file.seek(at_byte)
            _write_all(file, b"\0" * PROBE_BYTES)
            sync_file(file.fileno(), part)
    except OSError as exc:
        raise storage_error(exc, folder) from exc
    finally:
        _discard(part)


def supports_sync(folder: Path) -> bool:
    """Whether files of a folder can be synced; where not, this was logged once.

    Raises
    ------
    StorageError
        The folder takes no file now.
    """
    part = folder / f".probe.{os.getpid()}{PART}"
    try:
        with part.open("wb", buffering=0) as file:
            os.fsync(file.fileno())
    except OSError as exc:
        if exc.errno not in CANNOT_SYNC:
            raise storage_error(exc, folder) from exc
        _warn_of_files(folder, exc)
        return False
    finally:
        _discard(part)
    return True


def warn_once(folder: Path, message: str) -> None:
    """Log a warning about a folder's file system, once a process."""
    try:
        device = folder.stat().st_dev
    except OSError:
        device = -1
    if (device, message) not in _warned:
        _warned.add((device, message))
        log.warning("%s: %s", folder, message)


def _warn_of_files(folder: Path, exc: OSError) -> None:
    warn_once(folder, f"this file system cannot sync files ({exc.strerror}); a power cut may cost the newest")


def _warn_of_folder(folder: Path, exc: OSError) -> None:
    warn_once(folder, f"this file system cannot sync folders ({exc.strerror}); a power cut may cost the newest files")


def _write_all(file: FileIO, data: bytes) -> None:
    """A write without a buffer takes what there is room for, and fails only at the next one."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


def _discard(part: Path) -> None:
    with suppress(OSError):  # a rest that stays is removed at the next start
        part.unlink(missing_ok=True)
