"""Large answers that libzmq still holds because their client has not read them: how many a client may have."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Protocol

LARGE_BYTES = 64 << 10
"""Smaller answers are bounded by their number (`labdaemon.stream.sockets.ANSWERS_HIGH_WATER`)."""
MOST_OF_ONE = 8 << 20  # a few replays; more is kept for no client that does not read
MOST_OF_ALL = 48 << 20
"""Bytes of large answers that are held for one client, and for all of them."""
PATIENCE_S = 10.0
"""How long a command waits for its client to read earlier answers before it is refused as busy."""
POLL_S = 0.01  # libzmq reports no change of what is unread


class MessageTracker(Protocol):
    """Knows whether libzmq has let go of a message: pyzmq's `MessageTracker`."""

    @property
    def done(self) -> bool:
        """Whether the message was sent, or its client is gone."""
        ...


class UnreadAnswers:
    """Bytes of large answers in libzmq's hands, by client."""

    def __init__(self) -> None:
        self._held: deque[tuple[bytes, int, MessageTracker]] = deque()

    def add(self, client: bytes, size: int, tracker: MessageTracker) -> None:
        """Note an answer that was handed to libzmq."""
        self._held.append((client, size, tracker))

    def has_room(self, client: bytes) -> bool:
        """Whether this client may get one more."""
        self._held = deque(held for held in self._held if not held[2].done)
        of_all = sum(size for _, size, _ in self._held)
        of_one = sum(size for other, size, _ in self._held if other == client)
        return of_all < MOST_OF_ALL and of_one < MOST_OF_ONE

    async def wait_for_room(self, client: bytes) -> bool:
        """Wait until it may; False when its earlier answers were not read in time."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + PATIENCE_S
        while not self.has_room(client):
            if loop.time() > deadline:
                return False
            await asyncio.sleep(POLL_S)
        return True
