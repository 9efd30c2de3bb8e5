"""Long messages on their way in: few at a time, so that what all peers together make the daemon hold has a bound.

libzmq keeps a message of a megabyte for each peer that sends one, until the last byte has come and the daemon has
taken it. With a hundred such peers that is more than everything else that the daemon holds. Here so many long messages
are on their way at a time and the others wait in their senders' systems; short ones, every command but a long campaign,
pass at any time.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Protocol

MOST_LONG = 16
"""Long messages on their way at a time; each has at most the bytes of a message (`PeerLimits.message_bytes`)."""
SLOW_SWEEPS = 5
"""A long message that takes more seconds loses its connection, if others wait. Sweeps are counted and not the clock, so
that a machine which stood still takes no one's time."""
LOST_SWEEPS = 10
"""A message that was complete for so long and was not taken is none: libzmq has dropped it with its peer."""


class LongSender(Protocol):
    """A connection that sends a long message."""

    def go_on(self) -> None:
        """Its turn has come."""

    def close(self, why: str = "") -> None:
        """End it."""


class LongMessages:
    """Whose turn it is. Connections ask when their message has become long, and get their turns in that order.

    Parameters
    ----------
    most
        Long messages on their way at a time.
    """

    def __init__(self, most: int = MOST_LONG) -> None:
        self._most = most
        self._coming: dict[LongSender, int] = {}
        self._complete: deque[int] = deque()
        self._waiting: OrderedDict[LongSender, None] = OrderedDict()
        self._sweeps = 0

    def __len__(self) -> int:
        """Long messages on their way now."""
        return len(self._coming) + len(self._complete)

    def begin(self, sender: LongSender) -> bool:
        """Whether the rest of this connection's long message may come now; else its `go_on` is called in its turn."""
        if sender in self._coming:
            return True
        if len(self) < self._most:
            self._coming[sender] = self._sweeps
            return True
        self._waiting[sender] = None
        return False

    def complete(self, sender: LongSender) -> None:
        """All of its message has come; its place is free once that `was_taken`."""
        self._coming.pop(sender, None)
        self._complete.append(self._sweeps)

    def was_taken(self) -> None:
        """The daemon is done with a long message, whoever sent it."""
        if self._complete:
            self._complete.popleft()
            self._call_next()

    def leave(self, sender: LongSender) -> None:
        """The connection has ended, or nothing of its message is on its way any more."""
        self._waiting.pop(sender, None)
        if self._coming.pop(sender, None) is not None:
            self._call_next()

    def sweep(self) -> None:
        """Take places back from messages that do not end and from those that never came out; call it every second."""
        self._sweeps += 1
        while self._complete and self._sweeps - self._complete[0] > LOST_SWEEPS:
            self.was_taken()
        slow = [one for one, since in self._coming.items() if self._sweeps - since > SLOW_SWEEPS]
        for sender in slow if self._waiting else ():
            sender.close(f"a long message that took more than {SLOW_SWEEPS} s while others waited")

    def _call_next(self) -> None:
        while self._waiting and len(self) < self._most:
            sender, _ = self._waiting.popitem(last=False)
            self._coming[sender] = self._sweeps
            sender.go_on()
