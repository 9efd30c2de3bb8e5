"""The events of a daemon in order, for programs that wait: gaps are found by `seq` and filled by ``events.replay``."""

from __future__ import annotations

import json
import time
from types import TracebackType
from typing import Any, Protocol, Self

import zmq

from labdaemon.stream.client_errors import NoDaemon, refuse_closed
from labdaemon.stream.event_order import EventOrder, Message

REPLAYED_AT_A_TIME = 1000
READY_S = 10.0


class EventSource(Protocol):
    """What a stream needs of a client."""

    events_address: str

    def subscribe(self) -> zmq.Socket[bytes]:
        """A subscription to everything."""
        ...

    def replay(self, after: int, limit: int = REPLAYED_AT_A_TIME) -> dict[str, Any]:
        """An answer of ``events.replay``."""
        ...


class EventStream:
    """The events of a daemon, through its restarts.

    Parameters
    ----------
    client
        Whose addresses it uses, and by whose commands it replays.
    after
        Deliver everything after this `seq`; None for what comes from now on.
    journal
        The history that `after` belongs to, if known.
    """

    def __init__(self, client: EventSource, *, after: int | None = None, journal: str | None = None) -> None:
        self._order = EventOrder(after, journal)
        self._client = client
        self._socket = client.subscribe()
        self._message: Message | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def last(self) -> int | None:
        """`seq` of the last event delivered; None before the first message."""
        return self._order.last

    @property
    def journal(self) -> str | None:
        """UUID of the history it follows."""
        return self._order.journal

    def wait_ready(self, timeout_s: float = READY_S) -> None:
        """Wait until the subscription is known to be active: what is published after this is delivered.

        Raises
        ------
        NoDaemon
            No sign of the daemon in time.
        """
        if self._message is None and not self._read(timeout_s):
            raise NoDaemon(f"no events from {self._client.events_address} within {timeout_s:g} s: is a daemon there?")

    def receive(self, timeout_s: float) -> Message | None:
        """The next message, or None when none came in time.

        Raises
        ------
        JournalChanged, HistoryCut
            Once for each change; the next call continues with the first event that there is.
        NoDaemon
            A gap could not be filled; the next call tries again.
        ClientClosed
            The client was closed meanwhile.
        """
        deadline = time.monotonic() + timeout_s
        while (event := self._order.pop()) is None:
            if self._message is None and not self._read(deadline - time.monotonic()):
                return None
            self._take()
        return event

    def close(self) -> None:
        """End the subscription."""
        self._socket.close(linger=0)

    def _read(self, timeout_s: float) -> bool:
        """Keep the next message from the socket until it can be taken."""
        with refuse_closed():
            if timeout_s <= 0 or not self._socket.poll(int(timeout_s * 1000) + 1):
                return False
            self._message = json.loads(self._socket.recv_multipart()[1])
        return True

    def _take(self) -> None:
        """Queue the message, after whatever was missed before it; one that cannot be queued yet is kept."""
        message = self._message
        if message is None:
            return
        missing = self._order.missing(message)
        if missing is not None:
            seq, last = missing
            while seq < last:
                answer = self._client.replay(seq, min(REPLAYED_AT_A_TIME, last - seq))
                found = self._order.add_replayed(answer, seq)
                if found is None:
                    break
                seq = found
        self._order.add(message)
        self._message = None
