"""Noticing new files, whoever tells of them: the interrupt endpoint, Nikon's GetEvent, or the card's own list.

Bodies differ in which of these work, and an event may be lost; a file is reported once, however often it is told.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator

from labdaemon.capture.devices import CardFile
from labdaemon.errors import DeviceRefused
from labdrivers.ptp.codes import EventCode, Op
from labdrivers.ptp.events import NEWS, EventListener, parse_nikon_events
from labdrivers.ptp.objects import list_handles, object_info
from labdrivers.ptp.session import PtpSession

POLL_S = 0.1
LIST_EVERY_S = 2.0
MOST_POLLS = 50
"""GetEvent answers in a row before something else gets its turn."""


class FileWatch:
    """New files of one connection.

    Parameters
    ----------
    session
        The open session.
    events
        Its interrupt endpoint.
    known
        (name, capture time) of the files that are no news, shared over reconnections; None at the very first
        connection, when everything on the card is old.
    """

    def __init__(self, session: PtpSession, events: EventListener, known: set[tuple[str, str]] | None) -> None:
        self._session, self._events = session, events
        self._files: dict[int, CardFile | None] = {}
        self._candidates: deque[int] = deque()
        self._forget_events()  # told before; the list says what is there now
        present = self.files()
        self.known = {(file.name, file.captured_at) for file in present} if known is None else known
        self._fresh = deque(file for file in present if (file.name, file.captured_at) not in self.known)
        self._listed_at = time.monotonic()

    def files(self) -> list[CardFile]:
        """All files on the camera, folders left out, oldest first."""
        found = [file for handle in list_handles(self._session) if (file := self._look_at(handle)) is not None]
        return sorted(found, key=lambda file: (file.captured_at, file.name))

    def forget(self, handle: int) -> None:
        """A file was deleted; its handle may come again for another."""
        self._files.pop(handle, None)

    def next(self, timeout_s: float) -> CardFile | None:
        """Next new file; None when none came in time."""
        deadline = time.monotonic() + timeout_s
        while True:
            file = self._next_fresh()
            if file is not None:
                return file
            self._ask_events(max(0.0, deadline - time.monotonic()))
            if not self._candidates and time.monotonic() > self._listed_at + LIST_EVERY_S:
                self._compare_list()
            if self._candidates or self._fresh:
                continue
            left = deadline - time.monotonic()
            if left <= 0:
                return None
            heard = self._events.next(min(left, POLL_S))
            if heard is not None:
                self._take(heard)
            if self._events.fault is not None:
                raise self._events.fault

    def _next_fresh(self) -> CardFile | None:
        while self._candidates:
            file = self._look_at(self._candidates.popleft())
            if file is not None and (file.name, file.captured_at) not in self.known:
                self._fresh.append(file)
        while self._fresh:
            file = self._fresh.popleft()
            if (file.name, file.captured_at) not in self.known:
                self.known.add((file.name, file.captured_at))
                return file
        return None

    def _look_at(self, handle: int) -> CardFile | None:
        """The file behind a handle, asked once; None for a folder or a handle that is gone."""
        if handle not in self._files:
            info = object_info(self._session, handle)
            if info is None:
                return None
            file = None if info.is_folder else CardFile(handle, info.name, info.size_bytes, info.captured_at)
            self._files[handle] = file
        return self._files[handle]

    def _ask_events(self, patience_s: float) -> None:
        for event in self._told(patience_s):
            self._take(event)

    def _forget_events(self) -> None:
        for _ in self._told(0.0):
            pass

    def _told(self, patience_s: float) -> Iterator[tuple[int, int]]:
        """Everything that either way of telling holds now; a body may be busy with the exposure itself."""
        while (event := self._events.next(0.0)) is not None:
            yield event
        if self._session.supports(Op.NIKON_GET_EVENT):
            for _ in range(MOST_POLLS):
                told = parse_nikon_events(self._session.call(Op.NIKON_GET_EVENT, patience_s=patience_s).data)
                if not told:
                    break
                yield from told

    def _take(self, event: tuple[int, int]) -> None:
        if event[0] not in NEWS:
            return
        if event[0] == EventCode.STORE_FULL:
            raise DeviceRefused("card full: empty it or change it", device=self._session.device)
        if event[0] == EventCode.NIKON_ADDED_IN_SDRAM:
            self._files.pop(event[1], None)  # memory's one place has one handle, for each shot the same
        self._candidates.append(event[1])

    def _compare_list(self) -> None:
        self._listed_at = time.monotonic()
        self._candidates.extend(handle for handle in list_handles(self._session) if handle not in self._files)
