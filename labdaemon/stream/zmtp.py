"""What a peer sends, seen frame by frame (ZMTP 3): enough to refuse what would cost the daemon more than a peer may.

libzmq bounds a single frame. It keeps a message of endless frames until the last, and every topic of a subscriber for
as long as that is connected; a port scanner's bytes occupy a connection until a timeout. Only lengths, flags and topics
are looked at here. Of an encrypted connection only lengths can be seen.
"""

from __future__ import annotations

from collections.abc import Sequence, Sized
from dataclasses import dataclass

SIGNATURE_BYTES = 10  # of ZMTP: 0xFF, eight bytes, 0x7F
GREETING_BYTES = 64  # of ZMTP 3, signature included
MORE, LONG, COMMAND = 1, 2, 4
"""Flags of a frame."""
LONG_BYTES = 64 << 10
"""A message beyond this is long: see `labdaemon.stream.long_messages`."""
FRAME_COST = 64
"""What libzmq keeps for a frame in addition to its bytes."""
PREFIX_BYTES = 10
"""Enough of a frame's body to see a subscription in it."""
MECHANISM = slice(12, 32)
"""Where a greeting names how its peer wants to prove who it is."""
CURVE = b"CURVE".ljust(20, b"\0")
CURVE_HELLO, CURVE_INITIATE = b"\x05HELLO", b"\x08INITIATE"
"""What the two commands of an encrypted handshake begin with."""
CURVE_BYTES = 33
"""By which encryption makes a frame longer."""
IDENTITY, NO_IDENTITY = b"\x08Identity", b"\x08X-Origin"
"""A property of a client's first command, and one of the same length that libzmq does not know."""
HANDSHAKE_BYTES = 4096
"""The longest command of a handshake; CURVE's have some hundred bytes and a socket's properties."""


class PeerRefusal(Exception):
    """The peer is none, or asks for more than it may have."""


@dataclass(frozen=True, slots=True)
class PeerLimits:
    """What one peer may send.

    Attributes
    ----------
    frame_bytes, message_bytes
        Of one frame, and of all frames of one message, each with `FRAME_COST` added.
    topics
        Subscriptions at a time; None where there are none to count.
    bytes_per_s, burst_bytes
        How fast it is read, and how much at once; None for as fast as it comes.
    """

    frame_bytes: int
    message_bytes: int
    topics: int | None = None
    bytes_per_s: float | None = None
    burst_bytes: int = 0


class PeerInspector:
    """Follows the bytes of one peer.

    Parameters
    ----------
    limits
        What it may send.
    is_encrypted
        Whether it must encrypt (CURVE). Then messages all look the same and show no topic: each frame
        is bounded here, and the rest is counted where it is decrypted.

    Attributes
    ----------
    is_peer
        It began as a peer begins.
    is_ready
        Its part of the handshake has come.
    messages
        How many have come since.
    long_messages
        How many long ones have come; of an encrypted connection that cannot be seen.
    message_bytes
        Of the message that is coming, up to the end of the frame that has begun, with `FRAME_COST` for each frame.
    """

    def __init__(self, limits: PeerLimits, *, is_encrypted: bool = False) -> None:
        self._limits, self._is_encrypted = limits, is_encrypted
        self._said_hello = False
        self.is_peer: bool = False
        self.is_ready: bool = False
        self.messages: int = 0
        self._greeting = b""
        self._header = b""
        self._flags = 0
        self._left = 0
        self._prefix = b""
        self.message_bytes: int = 0
        self.long_messages: int = 0
        self._topics = 0
        self._hello = b""
        self._unpassed = GREETING_BYTES

    def feed(self, data: bytes) -> bytes:
        """Look at the next bytes; what of them, and of earlier ones, is to be passed on now.

        The identity that a client gives itself is not: two clients with one identity would get one another's answers,
        or libzmq would serve the first one only, which may be dead without a trace. An encrypted one cannot be seen.

        Raises
        ------
        PeerRefusal
            They are none of a peer's, or too many.
        """
        at = 0
        was_ready = self.is_ready
        if len(self._greeting) < GREETING_BYTES:
            at = GREETING_BYTES - len(self._greeting)
            self._greeting += data[:at]
            self._check_greeting()
        size = len(data)
        while at < size:
            if self._left:
                taken = min(self._left, size - at)
                if len(self._prefix) < PREFIX_BYTES:
                    self._prefix += data[at : at + min(taken, PREFIX_BYTES - len(self._prefix))]
                self._left -= taken
                at += taken
                if not self._left:
                    self._end_frame()
                continue
            self._header += data[at : at + 1]
            at += 1
            if len(self._header) == (9 if self._header[0] & LONG else 2):
                self._begin_frame()
        if was_ready or self._is_encrypted:
            return data
        self._hello += data
        if self.is_ready:
            hello, self._hello = self._hello.replace(IDENTITY, NO_IDENTITY, 1), b""
            return hello
        # What has come of the greeting; the command after it waits until it is whole.
        passed, self._hello = self._hello[: self._unpassed], self._hello[self._unpassed :]
        self._unpassed -= len(passed)
        return passed

    def _check_greeting(self) -> None:
        seen = self._greeting
        self.is_peer = len(seen) >= SIGNATURE_BYTES
        if seen[:1] not in {b"", b"\xff"} or (self.is_peer and not seen[SIGNATURE_BYTES - 1] & 1):
            raise PeerRefusal("no ZeroMQ peer")
        if len(seen) > SIGNATURE_BYTES and seen[SIGNATURE_BYTES] < 3:
            raise PeerRefusal("a ZeroMQ peer older than version 4")
        if self._is_encrypted and seen[MECHANISM] != CURVE[: len(seen[MECHANISM])]:
            raise PeerRefusal("a peer without a key")

    def _begin_frame(self) -> None:
        self._flags, self._left = self._header[0], int.from_bytes(self._header[1:], "big")
        self._header = self._prefix = b""
        if self._flags & ~(MORE | LONG | COMMAND):
            raise PeerRefusal("bytes that are no frame")
        longest = self._limits.frame_bytes + CURVE_BYTES * self._is_encrypted if self.is_ready else HANDSHAKE_BYTES
        if self._left > longest:
            raise PeerRefusal(f"a frame of more than {longest} bytes")
        self.message_bytes += self._left + FRAME_COST
        if self.message_bytes > self._limits.message_bytes + HANDSHAKE_BYTES:
            raise PeerRefusal(f"a message of more than {self._limits.message_bytes} bytes")
        if not self._left:
            self._end_frame()

    def _end_frame(self) -> None:
        if not self._flags & MORE:
            self.long_messages += self.message_bytes > LONG_BYTES and not self._flags & COMMAND
            self.message_bytes = 0
        self.messages += self.is_ready and (self._is_encrypted or not self._flags & (MORE | COMMAND))
        if not self.is_ready:
            self.is_ready = self._ends_handshake()
        elif self._limits.topics is not None and not self._is_encrypted:
            self._count_topics(self._limits.topics)

    def _ends_handshake(self) -> bool:
        """Whether this command was its part's last: the first where nothing is encrypted, else the second."""
        if not self._is_encrypted:
            return True
        expected = CURVE_INITIATE if self._said_hello else CURVE_HELLO
        if not self._flags & COMMAND or not self._prefix.startswith(expected):
            raise PeerRefusal("no handshake of a peer with a key")
        was_hello, self._said_hello = not self._said_hello, True
        return not was_hello

    def _count_topics(self, most: int) -> None:
        """A subscription is a message that begins with 1 (its end: with 0), or a command of that name."""
        if self._flags & COMMAND:
            change = (self._prefix == b"\x09SUBSCRIBE") - self._prefix.startswith(b"\x06CANCEL")
        else:
            change = self._prefix.startswith(b"\x01") - self._prefix.startswith(b"\x00")
        self._topics = max(self._topics + change, 0)
        if self._topics > most:
            raise PeerRefusal(f"more than {most} subscriptions")


def message_cost(frames: Sequence[Sized]) -> int:
    """Bytes that a message of these frames is counted as."""
    return sum(len(frame) + FRAME_COST for frame in frames)
