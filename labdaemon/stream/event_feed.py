"""Committed events for servers of other protocols: whoever has seen `seq` waits for what comes after it.

The journal is read off the event loop, once for all who wait; the last events stay in memory, within bounds.
"""

from __future__ import annotations

import asyncio
from collections import deque

from labdaemon.journal.event import EventText
from labdaemon.off_loop import off_loop
from labdaemon.stream.publisher import Outbox

BATCH = 100  # events of one read, so that a reader who is far behind does not hold up the others
BATCH_BYTES = 1 << 20  # of one read, since envelopes may be large
KEPT = 64  # the latest, from which readers who keep up are served without the disk
KEPT_BYTES = 4 << 20  # of these


class EventFeed:
    """Events of one journal for the tasks of one event loop.

    Parameters
    ----------
    outbox
        The journal.
    """

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._changed = asyncio.Event()
        self._reading = asyncio.Lock()
        self._kept: deque[EventText] = deque()
        self._kept_bytes = 0

    @property
    def journal(self) -> str:
        """UUID of the journal."""
        return self._outbox.uuid

    @property
    def last_seq(self) -> int:
        """`seq` of the last committed event."""
        return self._outbox.last_seq

    def wake(self) -> None:
        """Something was committed. Call it on the feed's own loop."""
        self._changed.set()
        self._changed = asyncio.Event()

    async def after(self, seq: int) -> list[EventText]:
        """The next events after this `seq`, ascending, at least one; waits until there is one.

        Raises
        ------
        StorageUnavailable
            The journal cannot be read now.
        """
        while True:
            changed = self._changed
            if self._outbox.last_seq > seq:
                async with self._reading:
                    events = self._kept_after(seq) or await self._read(seq)
                if events:
                    return events
            await changed.wait()

    def _kept_after(self, seq: int) -> list[EventText]:
        if not self._kept or self._kept[0].seq > seq + 1:
            return []
        return [event for event in self._kept if event.seq > seq]

    async def _read(self, seq: int) -> list[EventText]:
        events = await off_loop(self._outbox.history, seq, BATCH, BATCH_BYTES)
        last = self._kept[-1].seq if self._kept else 0
        if events and events[-1].seq > last:
            if events[0].seq != last + 1:
                self._kept.clear()
                self._kept_bytes = 0
            for event in events:
                if not self._kept or event.seq > self._kept[-1].seq:
                    self._kept.append(event)
                    self._kept_bytes += len(event.json)
            while len(self._kept) > KEPT or (self._kept_bytes > KEPT_BYTES and len(self._kept) > 1):
                self._kept_bytes -= len(self._kept.popleft().json)
        return events
