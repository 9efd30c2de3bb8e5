"""Noticing new files, whatever reports them: the interrupt endpoint, Nikon's GetEvent, or the card's own list.

Bodies differ in which of these work, and an event may be lost; a file is reported once, however often the body does.
Many bodies announce a file before they have written it, and then say 0 bytes, or half of them: a file is reported when
the body was asked twice and said the same size. One object that cannot be described never hides the others.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from labdaemon.capture.devices import CardFile
from labdaemon.errors import DeviceRefused
from labdrivers.ptp.codes import EventCode, Op, Response
from labdrivers.ptp.container import BadContainer
from labdrivers.ptp.events import NEWS, EventListener, parse_nikon_events
from labdrivers.ptp.objects import as_card_file, list_handles, object_info
from labdrivers.ptp.session import PtpRefused, PtpSession

log: logging.Logger = logging.getLogger(__name__)

POLL_S = 0.1  # a file is noticed within this time
LIST_EVERY_S = 2.0  # bodies that report no event are asked for their list
MOST_POLLS = 50
"""GetEvent answers in a row before something else gets its turn."""

SETTLE_S = 0.2
"""A size that the body said twice, so far apart, is believed for now; whoever fetches the file asks again."""

MOST_ASKED = 20
"""Times that an object is asked for whose description makes no sense: some bodies send no data at first."""

OF_THE_SESSION = frozenset({Response.SESSION_NOT_OPEN, Response.BAD_TRANSACTION})
"""Refusals that are not about the object that was asked for."""


@dataclass(slots=True)
class _Entry:
    """What the body said of a handle, and since when it has said the same; `file` is None for a folder."""

    file: CardFile | None
    since_s: float
    is_settled: bool = False


class FileWatch:
    """New files of one connection.

    Parameters
    ----------
    session
        The open session.
    events
        Its interrupt endpoint.
    known
        Files that are no news, shared over reconnections; None at the very first connection, when everything that is
        on the card, written to its end, is old.
    """

    def __init__(self, session: PtpSession, events: EventListener, known: set[CardFile] | None) -> None:
        self._session, self._events = session, events
        self._entries: dict[int, _Entry] = {}
        self._candidates: deque[int] = deque()
        self._listed: frozenset[int] = frozenset()
        self._unreadable: dict[int, int] = {}
        self.known: set[CardFile] = set() if known is None else known
        self._forget_events()  # reported before; the list says what is there now
        present = self.files()
        if known is None:
            self.known.update(file for file in present if file.size_bytes > 0)
        self._candidates.extend(file.handle for file in present if file not in self.known)
        self._listed_at = time.monotonic()

    def files(self) -> list[CardFile]:
        """All files on the camera, folders left out, oldest first; one that is still written has the size so far."""
        found = [file for handle in self._list() if (file := self._look_at(handle)) is not None]
        return sorted(found, key=lambda file: (file.captured_at, file.name, file.handle))

    def forget(self, handle: int) -> None:
        """A file was deleted; its handle and its name may come again for another."""
        self._entries.pop(handle, None)
        self.known.difference_update({file for file in self.known if file.handle == handle})

    def ask_again(self, handle: int) -> None:
        """What is behind a handle has changed since it was asked for."""
        self._entries.pop(handle, None)

    def next(self, timeout_s: float) -> CardFile | None:
        """Next new file; None when none came in time."""
        deadline = time.monotonic() + timeout_s
        while True:
            file = self._next_settled()
            if file is not None:
                return file
            self._ask_events(max(0.0, deadline - time.monotonic()))
            if time.monotonic() > self._listed_at + LIST_EVERY_S:
                self._compare_list()
            left = deadline - time.monotonic()
            if left <= 0:
                return self._next_settled()
            heard = self._events.next(min(left, POLL_S))
            if heard is not None:
                self._take(heard)
            if self._events.fault is not None:
                raise self._events.fault

    def _next_settled(self) -> CardFile | None:
        """The first candidate that is new and written; those still being written stay candidates."""
        for _ in range(len(self._candidates)):
            handle = self._candidates.popleft()
            file = self._look_at(handle)
            if file is None and 0 < self._unreadable.get(handle, 0) < MOST_ASKED:
                self._candidates.append(handle)  # what is kept in memory stands in no list, and comes up no more
                continue
            if file is None or file in self.known:
                continue
            if self._entries[handle].is_settled:
                self.known.add(file)
                return file
            self._candidates.append(handle)
        return None

    def _look_at(self, handle: int) -> CardFile | None:
        """The file behind a handle, asked until its size has settled; None for a folder or what cannot be described."""
        entry, now_s = self._entries.get(handle), time.monotonic()
        if entry is not None and (entry.is_settled or now_s < entry.since_s + SETTLE_S):
            return entry.file
        try:
            info = object_info(self._session, handle)
        except (BadContainer, PtpRefused) as exc:
            self._pass_over(handle, exc)
            return None
        self._unreadable.pop(handle, None)
        if info is None:
            self._entries.pop(handle, None)
            return None
        file = None if info.is_folder else as_card_file(handle, info)
        if entry is None or entry.file != file:
            self._entries[handle] = _Entry(file, now_s, is_settled=file is None)
        else:
            entry.is_settled = file is None or file.size_bytes > 0
        return file

    def _pass_over(self, handle: int, exc: Exception) -> None:
        """Leave out one object, of which the body makes no sense; raises what is about all of them."""
        if isinstance(exc, PtpRefused) and exc.code in OF_THE_SESSION:
            raise exc
        asked = self._unreadable[handle] = self._unreadable.get(handle, 0) + 1
        if asked == 1:
            log.warning(
                "%s: object %#010x is passed over, it cannot be described (%s)", self._session.device, handle, exc
            )

    def _ask_events(self, patience_s: float) -> None:
        for event in self._reported(patience_s):
            self._take(event)

    def _forget_events(self) -> None:
        for _ in self._reported(0.0):
            pass

    def _reported(self, patience_s: float) -> Iterator[tuple[int, int]]:
        """All events that either way of reporting holds now; a body may be busy with the exposure itself."""
        while (event := self._events.next(0.0)) is not None:
            yield event
        if self._session.supports(Op.NIKON_GET_EVENT):
            for _ in range(MOST_POLLS):
                events = parse_nikon_events(self._session.call(Op.NIKON_GET_EVENT, patience_s=patience_s).data)
                if not events:
                    break
                yield from events

    def _take(self, event: tuple[int, int]) -> None:
        code, handle = event
        if code not in NEWS:
            return
        if code == EventCode.STORE_FULL:
            raise DeviceRefused("card full: empty it or change it", device=self._session.device)
        if code == EventCode.OBJECT_REMOVED:
            self.forget(handle)
            return
        entry = self._entries.get(handle)
        if code == EventCode.NIKON_ADDED_IN_SDRAM or (entry is not None and entry.is_settled):
            # Memory's one place has one handle, for each shot the same; a card's handle may have been given away anew.
            self._entries.pop(handle, None)
        if code == EventCode.OBJECT_ADDED:
            self._listed |= {handle}  # it is on the card: when it is in no list any more, it is gone
        if handle not in self._candidates:
            self._candidates.append(handle)

    def _list(self) -> tuple[int, ...]:
        """Handles on the card now; those that have gone since the last list are forgotten."""
        handles = list_handles(self._session)
        for handle in self._listed.difference(handles):
            self.forget(handle)
            self._unreadable.pop(handle, None)
        self._listed = frozenset(handles)
        return handles

    def _compare_list(self) -> None:
        self._listed_at = time.monotonic()
        for handle in self._list():
            entry = self._entries.get(handle)
            is_open = (entry is None or not entry.is_settled) and self._unreadable.get(handle, 0) < MOST_ASKED
            if is_open and handle not in self._candidates:
                self._candidates.append(handle)
