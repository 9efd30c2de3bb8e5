"""Long messages of many peers: few on their way at a time, in turn, and what all make the daemon hold is bounded."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field

import pytest
import zmq

from labdaemon.stream.client import Client
from labdaemon.stream.long_messages import LOST_SWEEPS, MOST_LONG, SLOW_SWEEPS, LongMessages
from labdaemon.stream.sockets import COMMANDS_LIMITS
from labdaemon.stream.zmtp import LONG_BYTES, MORE, PeerInspector
from labdaemon.testing.stream_daemon import FakeKeys, StreamDaemon

FRAME = 900_000
PEERS = 60
GREETING = (b"\xff" + b"\0" * 8 + b"\x7f\x03\x00NULL").ljust(64, b"\0")
READY = b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER"
CHILD = """
import sys
from labdaemon.service.free_memory import release_free_memory, resident_bytes
from labdaemon.testing.stream_daemon import StreamDaemon
daemon = StreamDaemon()
daemon.start()
print(daemon.commands, flush=True)
for line in sys.stdin:
    if line == "release\\n":
        release_free_memory()
    print(resident_bytes(), flush=True)
"""


@dataclass(eq=False)
class Sender:
    """A connection, and what was done with it."""

    messages: LongMessages
    turns: int = 0
    ends: list[str] = field(default_factory=list)

    def go_on(self) -> None:
        self.turns += 1

    def close(self, why: str = "") -> None:
        self.ends.append(why)
        self.messages.leave(self)


def senders(messages: LongMessages, count: int) -> list[Sender]:
    return [Sender(messages) for _ in range(count)]


def test_so_many_at_a_time_and_the_others_in_turn() -> None:
    messages = LongMessages(2)
    first, second, third, fourth = senders(messages, 4)
    assert [messages.begin(one) for one in (first, second, third, fourth)] == [True, True, False, False]
    assert messages.begin(first)  # its own place is kept
    messages.complete(first)
    assert third.turns == 0  # libzmq has it now, and the daemon not yet
    messages.was_taken()
    assert (third.turns, fourth.turns, len(messages)) == (1, 0, 2)
    messages.leave(second)
    assert (fourth.turns, len(messages)) == (1, 2)


def test_a_slow_one_leaves_where_others_wait() -> None:
    messages = LongMessages(1)
    slow, waiting = senders(messages, 2)
    assert messages.begin(slow)
    for _ in range(2 * SLOW_SWEEPS):
        messages.sweep()
    assert not slow.ends
    assert not messages.begin(waiting)
    messages.sweep()
    assert "while others waited" in slow.ends[0]
    assert waiting.turns == 1
    assert not waiting.ends


def test_a_place_of_a_message_that_never_came_out_is_given_back() -> None:
    messages = LongMessages(1)
    lost, waiting = senders(messages, 2)
    messages.begin(lost)
    messages.complete(lost)
    assert not messages.begin(waiting)
    for _ in range(LOST_SWEEPS + 1):
        messages.sweep()
    assert waiting.turns == 1


@pytest.mark.parametrize(
    ("frames", "expected"),
    [([LONG_BYTES], 1), ([LONG_BYTES // 2] * 2, 1), ([100] * 3, 0), ([LONG_BYTES - 64], 0)],
)
def test_long_messages_are_counted_by_all_their_frames(frames: list[int], expected: int) -> None:
    inspector = PeerInspector(COMMANDS_LIMITS)
    inspector.feed(GREETING + READY)
    for place, size in enumerate(frames):
        flags = 2 | (MORE if place < len(frames) - 1 else 0)
        inspector.feed(bytes([flags]) + size.to_bytes(8, "big") + bytes(size))
    assert (inspector.long_messages, inspector.message_bytes) == (expected, 0)


@pytest.fixture
def child() -> Iterator[subprocess.Popen[str]]:
    """A daemon in a process of its own, whose memory is its own as well."""
    child = subprocess.Popen([sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    yield child
    child.terminate()
    child.communicate()


def memory_mb(child: subprocess.Popen[str], what: str = "say") -> float:
    assert child.stdin is not None
    assert child.stdout is not None
    print(what, file=child.stdin, flush=True)
    return int(child.stdout.readline()) / (1 << 20)


def test_a_crowd_of_unfinished_long_messages_costs_no_more_than_a_few(child: subprocess.Popen[str]) -> None:
    assert child.stdout is not None
    address = child.stdout.readline().strip()
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    header = bytes([2 | MORE]) + FRAME.to_bytes(8, "big")
    unfinished = (header + bytes(FRAME)) * 2
    with Client(address, timeout_s=60.0) as client, ExitStack() as stack:
        client.call("status")
        before = memory_mb(child)
        for _ in range(PEERS):
            peer = stack.enter_context(socket.create_connection((host, int(port)), timeout=60.0))
            peer.sendall(GREETING + READY)
            peer.settimeout(0.05)  # most of it is not read from most of them
            with suppress(OSError):
                peer.sendall(unfinished[:-1])
            assert client.call("status")["state"] == "idle"  # who asks for little waits for none of it
        held = memory_mb(child) - before
        stack.close()
        with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:  # their places are free again
            dealer.set(zmq.LINGER, 0)
            dealer.connect(address)
            for _ in range(2 * MOST_LONG):
                dealer.send(b"x" * FRAME)
            answers = [json.loads(dealer.recv()) for _ in range(2 * MOST_LONG) if dealer.poll(60_000)]
        assert len(answers) == 2 * MOST_LONG
        left = memory_mb(child, "release") - before
    most = MOST_LONG * COMMANDS_LIMITS.message_bytes / (1 << 20)
    assert held < most + 0.4 * PEERS, "long messages of all peers together have no bound"
    assert left < 20.0, "what they sent is still held"


def test_long_requests_with_keys_are_answered_in_turn(guarded: StreamDaemon, keys: FakeKeys) -> None:
    with Client(guarded.commands, guarded.events, timeout_s=60.0, key=keys.operator) as client:
        for _ in range(MOST_LONG + 2):
            assert client.call("capture", label="x" * 4 * LONG_BYTES)["capture"] == "0001-a"
    assert guarded.server._gate is not None
    assert len(guarded.server._gate.long_messages) == 0
