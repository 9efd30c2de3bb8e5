"""The order of events, without any socket: what is missing before a message, and what is delivered when."""

from __future__ import annotations

from collections import deque
from typing import Any

from labdaemon.stream.client_errors import HistoryCut, JournalChanged

Message = dict[str, Any]


class EventOrder:
    """Puts messages in order: each event once, none missing. A status is no event, and passes as it comes.

    Parameters
    ----------
    after
        Deliver everything after this `seq`; None for what comes from now on.
    journal
        The history that `after` belongs to, if known.

    Attributes
    ----------
    last
        `seq` of the last event delivered; None before the first message.
    journal
        UUID of the history it follows.
    """

    def __init__(self, after: int | None = None, journal: str | None = None) -> None:
        self.last: int | None = after
        self.journal: str | None = journal
        self._ready: deque[Message] = deque()

    def missing(self, message: Message) -> tuple[int, int] | None:
        """What has to be replayed before this message: events after the first `seq`, up to the second.

        Raises
        ------
        JournalChanged
            It is of another history, which is followed from its beginning from now on.
        """
        journal, seq = message["journal"], message["seq"]
        if self.journal is not None and journal != self.journal:
            before, self.journal, self.last = self.journal, journal, 0
            self._ready.clear()
            raise JournalChanged(before, journal)
        self.journal = journal
        before_it = seq if message["kind"] == "status" else seq - 1
        if self.last is None:
            self.last = before_it
        return (self.last, before_it) if self.last < before_it else None

    def add_replayed(self, answer: Message, after: int) -> int | None:
        """Take an answer of ``events.replay`` to a request for what is `after`.

        Returns
        -------
        int | None
            `seq` of its last event; None where it has none, or is of another history.

        Raises
        ------
        HistoryCut
            Events are gone. Those after them are replayed by the next request.
        """
        if answer["journal"] != self.journal:
            return None
        gone_before = answer.get("gone_before")
        if gone_before is not None and gone_before > after + 1:
            self.last = gone_before - 1
            self._ready.clear()
            raise HistoryCut(after, gone_before)
        self._ready.extend(answer["events"])
        return int(answer["events"][-1]["seq"]) if answer["events"] else None

    def add(self, message: Message) -> None:
        """Take a message before which nothing is missing (any more)."""
        if message["kind"] == "status" or message["seq"] > (self.last or 0):
            self._ready.append(message)

    def pop(self) -> Message | None:
        """The next message to deliver."""
        if not self._ready:
            return None
        message = self._ready.popleft()
        if message["kind"] != "status":
            self.last = message["seq"]
        return message
