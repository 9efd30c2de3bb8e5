"""One peer's connection: its TCP socket on one side, libzmq on the other, and bounded bytes in between."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable
from itertools import count

from labdaemon.stream.long_messages import LongMessages
from labdaemon.stream.zmtp import LONG_BYTES, PeerInspector, PeerLimits, PeerRefusal

BLOCK_BYTES = 128 << 10
"""Bytes moved at a time: a fraction of a millisecond of the event loop."""
MOST_LAST_BLOCKS = 64  # of a peer that has closed: what it said last is still passed on, within bounds
UNRECEIVED = 4
"""So many messages' bytes of an encrypted connection may be passed on of which no whole message has come yet."""
ENDLESS_S = 5.0
"""A connection that has reached that, and of which nothing comes for so long, is sending one message without end."""
_numbers = count(1)
NOT_NOW = (BlockingIOError, InterruptedError)
"""What a socket says that has nothing to read, or no room."""


class ByteRelay:
    """Moves bytes from one socket to another, and reads no more than the other side takes.

    Parameters
    ----------
    source, target
        Non-blocking sockets.
    inspect
        Looks at the bytes first, and returns those to be moved.
    on_end
        Called once with why there is nothing more to move: the source has ended, or one of them failed.
    """

    def __init__(
        self,
        source: socket.socket,
        target: socket.socket,
        inspect: Callable[[bytes], bytes],
        on_end: Callable[[str], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._source, self._target = source, target
        self._inspect, self._on_end = inspect, on_end
        self._pending = memoryview(b"")
        self._is_reading = self._is_held = self._has_ended = False

    def start(self) -> None:
        """Read whenever there is something to read."""
        self._is_held = False
        self._read_on()

    def hold(self) -> None:
        """Read no more until `start`."""
        self._is_held = True
        self._pause()

    def close(self) -> None:
        """Move nothing more. The sockets are their owner's."""
        self._has_ended = True
        self._pause()
        self._loop.remove_writer(self._target)

    def finish(self) -> None:
        """Move what is there without waiting for anything."""
        for _ in range(MOST_LAST_BLOCKS):
            if self._pending:
                self._write()
            else:
                self._read()
            if self._pending or self._has_ended:
                return

    def put(self, data: bytes) -> None:
        """Send these bytes, now or as soon as the target takes them."""
        try:
            sent = self._target.send(data)
        except NOT_NOW:  # spurious readiness: the loop calls again
            sent = 0
        except OSError as exc:
            self._end(str(exc.strerror))
            return
        if sent < len(data):
            self._pending = memoryview(data)[sent:]
            self._pause()
            self._loop.add_writer(self._target, self._write)

    def _read(self) -> None:
        try:
            data = self._source.recv(BLOCK_BYTES)
        except NOT_NOW:  # the target takes no more now: the loop calls again when it does
            return
        except OSError as exc:
            self._end(str(exc.strerror))
            return
        if not data:
            self._end("")
            return
        try:
            data = self._inspect(data)
        except PeerRefusal as exc:
            self._end(str(exc))
            return
        if data and not self._has_ended:
            self.put(data)

    def _write(self) -> None:
        try:
            self._pending = self._pending[self._target.send(self._pending) :]
        except NOT_NOW:  # spurious readiness: the loop calls again
            return
        except OSError as exc:
            self._end(str(exc.strerror))
            return
        if not self._pending:
            self._loop.remove_writer(self._target)
            self._read_on()

    def _read_on(self) -> None:
        if not (self._is_reading or self._is_held or self._has_ended or self._pending):
            self._is_reading = True
            self._loop.add_reader(self._source, self._read)

    def _pause(self) -> None:
        if self._is_reading:
            self._is_reading = False
            self._loop.remove_reader(self._source)

    def _end(self, why: str) -> None:
        if not self._has_ended:
            self.close()
            self._on_end(why)


class PeerConnection:
    """A peer, from its first byte to its last.

    Parameters
    ----------
    peer
        Its accepted socket.
    limits
        What it may send.
    connect
        Makes a connection to libzmq; raises `OSError` when it cannot.
    on_close
        Called once with this connection and the reason, empty where the peer has simply left.
    long_messages
        Shared by all connections of a socket.
    is_encrypted
        Whether the peer has to have a key.

    Attributes
    ----------
    number
        Unique in this process.
    public
        The key that it has proved to have, once that is so.
    accepted_s, active_s
        When it came, and when bytes last moved, on the monotonic clock.
    is_waiting
        It has sent a message and got nothing since: it may wait for an answer.
    """

    def __init__(
        self,
        peer: socket.socket,
        limits: PeerLimits,
        connect: Callable[[PeerConnection], socket.socket],
        on_close: Callable[[PeerConnection, str], None],
        long_messages: LongMessages,
        *,
        is_encrypted: bool = False,
    ) -> None:
        self._peer, self._limits, self._connect, self._on_close = peer, limits, connect, on_close
        self._long_messages = long_messages
        self._is_encrypted = is_encrypted
        self._inspector = PeerInspector(limits, is_encrypted=is_encrypted)
        self.number: int = next(_numbers)
        self.public: str | None = None
        self._holds: set[str] = set()
        self._unreceived = 0
        self._full_s: float | None = None
        self._topics = 0
        self._inner: socket.socket | None = None
        self._pipes: list[ByteRelay] = []
        self._first = b""
        self._tokens = float(limits.burst_bytes)
        self._resume: asyncio.TimerHandle | None = None
        self.accepted_s: float = time.monotonic()
        self.active_s: float = self.accepted_s
        self._seen_s = self.accepted_s
        self.is_waiting: bool = False
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(peer, self._read_signature)

    @property
    def is_ready(self) -> bool:
        """Whether its handshake has come, and its key is one that is listed."""
        return self._inspector.is_ready and (not self._is_encrypted or self.public is not None)

    @property
    def is_endless(self) -> bool:
        """Whether it has sent more than a message may have, and no message came of it for a while."""
        return self._full_s is not None and time.monotonic() - self._full_s > ENDLESS_S

    def note_received(self) -> None:
        """A whole message of it has come out of libzmq: what was sent before it is no part of an endless one."""
        self._unreceived, self._full_s = 0, None
        self._long_messages.leave(self)
        self._release("unreceived")
        self._release("long")

    def go_on(self) -> None:
        """The rest of its long message may come now."""
        self._release("long")

    def count_topic(self, change: int) -> None:
        """Count a subscription (1) or its end (-1) of an encrypted connection, whose own bytes do not show it."""
        self._topics = max(self._topics + change, 0)
        if self._limits.topics is not None and self._topics > self._limits.topics:
            self.close(f"more than {self._limits.topics} subscriptions")

    def deliver(self) -> None:
        """Send what libzmq left for the peer, as far as it takes it at once: the daemon ends."""
        if self._pipes:
            self._pipes[1].finish()

    def close(self, why: str = "") -> None:
        """End it, on both sides."""
        if self._peer.fileno() < 0:
            return
        if self._resume is not None:
            self._resume.cancel()
        for pipe in self._pipes:
            pipe.close()
        if self._inner is None:
            self._loop.remove_reader(self._peer)
        else:
            self._inner.close()
        self._peer.close()
        self._long_messages.leave(self)
        self._on_close(self, why)

    def _read_signature(self) -> None:
        """Until the first bytes are a peer's, libzmq hears nothing of it."""
        try:
            data = self._peer.recv(BLOCK_BYTES)
        except NOT_NOW:
            return
        except OSError as exc:
            self.close(str(exc.strerror))
            return
        if not data:
            self.close()
            return
        try:
            self._first += self._seen(data)
            if not self._inspector.is_peer:
                return
            self._inner = self._connect(self)
        except (OSError, PeerRefusal) as exc:
            self.close(str(exc))
            return
        self._loop.remove_reader(self._peer)
        inward = ByteRelay(self._peer, self._inner, self._seen, self.close)
        outward = ByteRelay(self._inner, self._peer, self._sent, self.close)
        self._pipes = [inward, outward]
        first, self._first = self._first, b""
        inward.put(first)
        outward.start()
        self._release("")

    def _sent(self, data: bytes) -> bytes:
        self.active_s = time.monotonic()
        self.is_waiting = False
        return data

    def _seen(self, data: bytes) -> bytes:
        now_s = time.monotonic()
        messages, long_messages = self._inspector.messages, self._inspector.long_messages
        passed = self._inspector.feed(data)
        self.is_waiting = self.is_waiting or self._inspector.messages > messages
        if self._limits.bytes_per_s is not None:
            self._tokens += (now_s - self._seen_s) * self._limits.bytes_per_s
            self._tokens = min(self._tokens, self._limits.burst_bytes) - len(data)
            if self._tokens < 0 and self._pipes and self._resume is None:
                self._hold("rate")
                self._resume = self._loop.call_later(-self._tokens / self._limits.bytes_per_s, self._read_again)
        self.active_s = self._seen_s = now_s
        if self._is_encrypted and self._inspector.is_ready:
            self._unreceived += len(data)
            if self._unreceived > UNRECEIVED * self._limits.message_bytes and self._full_s is None:
                self._full_s = now_s
                self._hold("unreceived")
        self._take_turn(self._inspector.long_messages - long_messages)
        return passed

    def _take_turn(self, ended: int) -> None:
        """Wait where a message becomes long while others are on their way; so many long ones have just ended.

        Of an encrypted connection that is not seen: there bytes are counted until a message has come out of libzmq.
        """
        for _ in range(0 if self._is_encrypted else ended):
            self._long_messages.complete(self)
        coming = self._unreceived if self._is_encrypted else self._inspector.message_bytes
        if coming <= LONG_BYTES:
            self._long_messages.leave(self)
        elif not self._long_messages.begin(self):
            self._hold("long")

    def _hold(self, why: str) -> None:
        self._holds.add(why)
        if self._pipes:
            self._pipes[0].hold()

    def _release(self, why: str) -> None:
        self._holds.discard(why)
        if not self._holds and self._pipes and self._peer.fileno() >= 0:
            self._pipes[0].start()

    def _read_again(self) -> None:
        self._resume = None
        self._release("rate")
