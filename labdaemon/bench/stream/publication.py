"""One publication: a child that publishes, and subscribers here that receive all of it, or never read."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import zmq

from labdaemon.bench.stream.publisher_child import GO
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client_sockets import secure
from labdaemon.stream.key_files import KeyPair
from labdaemon.testing.stream_daemon import FakeKeys

CHILD = [sys.executable, "-m", "labdaemon.bench.stream.publisher_child"]
DEADLINE_S = 120.0


@dataclass(frozen=True, slots=True)
class Publication:
    """What it took.

    Attributes
    ----------
    events, bytes_each
        Sent to each subscriber.
    took_s
        From the first event's release until each subscriber had all.
    cpu_s
        CPU time of the publisher meanwhile.
    memory_mb
        How much the publisher grew.
    """

    events: int
    bytes_each: int
    took_s: float
    cpu_s: float
    memory_mb: float


def publish(
    which: Literal["ours", "bare"],
    events: int,
    subscribers: int,
    *,
    stalled: int = 0,
    rounds: int = 1,
    has_keys: bool = False,
) -> Publication:
    """Publish so many events.

    Parameters
    ----------
    stalled
        Subscribers that never read, in addition.
    rounds
        How often that many are published, each time after all have come.
    has_keys
        Whether all of it is encrypted, with keys that ours checks.

    Raises
    ------
    LabdaemonError
        A subscriber did not get all in time.
    """
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-keys-"))
    keys = FakeKeys(folder) if has_keys else None
    pair = keys.observer if keys is not None else None
    arguments = [which, str(events), *([] if keys is None else [str(folder)])]
    child = subprocess.Popen([*CHILD, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdin is not None
    assert child.stdout is not None
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    try:
        address = child.stdout.readline().strip()
        idle = [_subscriber(context, address, pair, high_water=1) for _ in range(stalled)]
        poller, left = zmq.Poller(), dict[zmq.Socket[bytes], int]()
        for _ in range(subscribers):
            socket = _subscriber(context, address, pair, high_water=0)
            poller.register(socket, zmq.POLLIN)
            left[socket] = events
        _wait_for_greetings([*left, *idle])
        before: dict[str, float] = {}
        began_s, size = time.monotonic(), 0
        for _ in range(rounds):
            left = dict.fromkeys(left, events)
            child.stdin.write(GO)
            child.stdin.flush()
            used = json.loads(child.stdout.readline())
            before = before or used
            size = _receive(poller, left)
        took_s = time.monotonic() - began_s
        child.stdin.write("used\n")
        child.stdin.flush()
        after = json.loads(child.stdout.readline())
        cpu_s, memory_mb = (after[name] - before[name] for name in ("cpu_s", "memory_mb"))
        return Publication(events * rounds, size, took_s, cpu_s, memory_mb)
    finally:
        context.destroy(linger=0)
        child.stdin.close()
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        child.stdout.close()
        shutil.rmtree(folder, ignore_errors=True)


def _receive(poller: zmq.Poller, left: dict[zmq.Socket[bytes], int]) -> int:
    """Receive as many envelopes on each socket as are left; bytes of the last one."""
    end_s, size = time.monotonic() + DEADLINE_S, 0
    while any(left.values()):
        if time.monotonic() > end_s:
            raise LabdaemonError(f"{sum(left.values())} events did not come within {DEADLINE_S:g} s")
        for socket, _ in poller.poll(1000):
            for _ in range(8):
                topic, frame = socket.recv_multipart(copy=False)
                if topic.bytes == b"envelope":
                    left[socket] -= 1
                    size = len(frame)
                if not socket.poll(0):
                    break
    return size


def _subscriber(
    context: zmq.Context[zmq.Socket[bytes]], address: str, pair: KeyPair | None, *, high_water: int
) -> zmq.Socket[bytes]:
    socket = context.socket(zmq.SUB)
    if pair is not None:
        secure(socket, pair)
    socket.set(zmq.RCVHWM, high_water)
    if high_water:
        socket.set(zmq.RCVBUF, 64 << 10)
    socket.connect(address)
    socket.subscribe(b"")
    return socket


def _wait_for_greetings(sockets: list[zmq.Socket[bytes]]) -> None:
    for socket in sockets:
        if not socket.poll(20_000):
            raise LabdaemonError("a subscriber did not get in")
        socket.recv_multipart()
