"""The memory card of a simulated camera: folders and files with handles, kept on disk so that memory stays flat."""

from __future__ import annotations

import os
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

STORAGE_ID = 0x00010001
FORMAT_FOLDER, FORMAT_FILE = 0x3001, 0x3000
DCIM, FIRST_FOLDER, FIRST_FILE = 0x10000001, 0x10000064, 0x20000001
NO_PARENT = 0
FILES_A_FOLDER = 9999
MEMORY_HANDLE = 0xFFFF0001


@dataclass(frozen=True, slots=True)
class CardObject:
    """A folder or file as the camera describes it."""

    handle: int
    format: int
    name: str
    size_bytes: int
    parent: int
    captured_at: str
    path: Path | None
    added_s: float = 0.0
    """`time.monotonic` when it was announced."""


class MemoryCardFull(Exception):
    """No room for another file."""


class MemoryCard:
    """A card.

    Parameters
    ----------
    directory
        Where its files lie; a temporary one if None.
    capacity_bytes
        Its size.
    suffix
        Of the files it takes.
    """

    def __init__(self, directory: Path | None = None, *, capacity_bytes: int = 8 * 10**9, suffix: str = ".DNG") -> None:
        self._temporary = tempfile.TemporaryDirectory(prefix="simcard-") if directory is None else None
        self._directory = directory or Path(self._temporary.name if self._temporary else ".")
        self._directory.mkdir(parents=True, exist_ok=True)
        self.capacity_bytes, self._suffix = capacity_bytes, suffix
        self._lock = threading.Lock()
        self._objects: dict[int, CardObject] = {}
        self._free_handles: list[int] = []
        self._next = self._next_handle = 0

    def add(
        self,
        content: bytes,
        captured_at: str | None = None,
        *,
        name: str | None = None,
        form: int = FORMAT_FILE,
        reuse_handle: bool = False,
    ) -> list[int]:
        """Store a file; return the handles that are new: first the folders, if it is the first file, then its own.

        Parameters
        ----------
        content, captured_at
            The file, and the body's time stamp.
        name
            Its name; None for the next number's.
        form
            PTP's object format.
        reuse_handle
            Take the handle that was freed last, if any.

        Raises
        ------
        MemoryCardFull
            It does not fit.
        """
        stamp = time.strftime("%Y%m%dT%H%M%S") if captured_at is None else captured_at
        with self._lock:
            if len(content) > self._free():
                raise MemoryCardFull
            new = []
            folder = FIRST_FOLDER + self._next // FILES_A_FOLDER
            folder_name = f"{100 + self._next // FILES_A_FOLDER}NCD80"
            for handle, title, parent in ((DCIM, "DCIM", NO_PARENT), (folder, folder_name, DCIM)):
                if handle not in self._objects:
                    self._objects[handle] = CardObject(handle, FORMAT_FOLDER, title, 0, parent, stamp, None)
                    new.append(handle)
            if reuse_handle and self._free_handles:
                handle = self._free_handles.pop()
            else:
                handle = FIRST_FILE + self._next_handle
                self._next_handle += 1
            if name is None:
                self._next += 1
                name = f"DSC_{(self._next - 1) % FILES_A_FOLDER + 1:04d}{self._suffix}"
            path = self._directory / f"{handle:08x}"
            path.write_bytes(content)
            self._objects[handle] = CardObject(handle, form, name, len(content), folder, stamp, path, time.monotonic())
            return [*new, handle]

    def hold(self, content: bytes, captured_at: str) -> int:
        """Keep a file in the body's memory instead: one place, in no list, taken by the next."""
        with self._lock:
            self._next += 1
            path = self._directory / "memory"
            path.write_bytes(content)
            name = f"DSC_{self._next:04d}{self._suffix}"
            self._objects[MEMORY_HANDLE] = CardObject(
                MEMORY_HANDLE, FORMAT_FILE, name, len(content), NO_PARENT, captured_at, path
            )
            return MEMORY_HANDLE

    def handles(self) -> list[int]:
        """All handles of the card, folders included."""
        with self._lock:
            return [handle for handle in self._objects if handle != MEMORY_HANDLE]

    def get(self, handle: int) -> CardObject | None:
        """The object behind a handle."""
        with self._lock:
            return self._objects.get(handle)

    def read(self, item: CardObject, offset: int, size: int) -> bytes:
        """Part of a file."""
        if item.path is None:
            return b""
        with item.path.open("rb") as stream:
            stream.seek(offset)
            return stream.read(size)

    def delete(self, handle: int) -> bool:
        """Remove a file; False if there is none of this handle."""
        with self._lock:
            item = self._objects.pop(handle, None)
            if item is not None and handle != MEMORY_HANDLE:
                self._free_handles.append(handle)
        if item is not None and item.path is not None:
            os.unlink(item.path)
        return item is not None

    def free_bytes(self) -> int:
        """Room left."""
        with self._lock:
            return self._free()

    def _free(self) -> int:
        on_card = (item.size_bytes for handle, item in self._objects.items() if handle != MEMORY_HANDLE)
        return self.capacity_bytes - sum(on_card)
