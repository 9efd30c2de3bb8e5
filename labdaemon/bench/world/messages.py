"""Hostile and broken messages to both sockets of a running daemon, raw TCP among them: it lives and answers."""

from __future__ import annotations

import os
import random
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import zmq

from labdaemon.bench.kill import DaemonUnderTest, small_rig
from labdaemon.bench.world.mutations import message
from labdaemon.bench.world.row import WorldOptions, WorldRow
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client import Client

MEMORY_MB = 500.0  # what a flood of messages may cost
SILENT_S = 10.0  # a daemon that answers nothing for so long counts as hung
GREETING = (b"\xff" + b"\0" * 8 + b"\x7f\x03\x00NULL").ljust(64, b"\0")
# the second half of ZMTP's greeting of a client, as libzmq writes it
READY = b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER"
PROBE_EVERY = 500  # messages between two questions whether an ordinary client is still answered
GOAL = f"alive, 0 tracebacks, no answer later than {SILENT_S:g} s, <= {MEMORY_MB:g} MB"


def rows(options: WorldOptions) -> Iterator[WorldRow]:
    """One row for both sockets."""
    tries = 2000 if options.quick else 50_000
    source = random.Random(options.seed)
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-messages-"))
    try:
        with small_rig(options.seed) as rig:
            daemon = DaemonUnderTest(rig, folder)
            daemon.start()
            try:
                slowest_s = _attack(daemon, source, tries)
                memory_mb = _memory_mb(daemon.process.pid)
                is_alive = daemon.process.poll() is None
            finally:
                daemon.end()
        tracebacks = (folder / "daemon.log").read_text(errors="replace").count("Traceback")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    holds = is_alive and not tracebacks and slowest_s <= SILENT_S and memory_mb <= MEMORY_MB
    result = (
        f"{'alive' if is_alive else 'dead'}, {tracebacks} tracebacks, slowest status {slowest_s:.2f} s, "
        f"at most {memory_mb:.0f} MB"
    )
    yield WorldRow("messages", "surrogates, bombs, rubbish, raw TCP to both sockets", tries, result, GOAL, holds)


def _attack(daemon: DaemonUnderTest, source: random.Random, tries: int) -> float:
    """Send so many messages; the slowest answer to a `status` in between, infinite where one did not come."""
    slowest_s = 0.0
    with Client(daemon.commands, timeout_s=SILENT_S * 3) as probe:
        address = probe.call("rig")["service"]["events"]
        sent = 0
        while sent < tries:
            with zmq.Context() as context:
                dealer, subscriber = context.socket(zmq.DEALER), context.socket(zmq.XSUB)
                for one, where in ((dealer, daemon.commands), (subscriber, address)):
                    one.set(zmq.LINGER, 0)
                    one.set(zmq.SNDTIMEO, 2000)
                    one.connect(where)
                for _ in range(min(PROBE_EVERY, tries - sent)):
                    _send(source, dealer, subscriber, (daemon.commands, address))
                    sent += 1
                context.destroy(linger=0)
            began_s = time.monotonic()
            try:
                probe.call("status")
            except LabdaemonError:  # no answer at all: longer than any limit
                return float("inf")
            slowest_s = max(slowest_s, time.monotonic() - began_s)
    return slowest_s


def _send(
    source: random.Random, dealer: zmq.Socket[bytes], subscriber: zmq.Socket[bytes], ports: tuple[str, str]
) -> None:
    kind = source.random()
    with suppress(zmq.Again, OSError):  # it was hung up on, or its queue is full: that is what is tried
        if kind < 0.80:
            dealer.send_multipart(message(source))
            while dealer.poll(0):
                dealer.recv_multipart()
        elif kind < 0.90:
            subscriber.send(bytes([source.randrange(3)]) + os.urandom(source.choice((0, 3, 20, 2000))))
        else:
            _send_raw(source, source.choice(ports))


def _send_raw(source: random.Random, address: str) -> None:
    """Bytes as a port scanner, a browser or a broken peer sends them."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    frame = bytes([source.choice((0, 1, 2, 3, 4, 6, 0x80)), source.randrange(256)]) + source.randbytes(40)
    endless = b"\x02" + b"\xff" * 8
    sent = source.choice(
        (b"GET / HTTP/1.1\r\n\r\n", source.randbytes(100), GREETING[: source.randrange(64)], GREETING + frame,
         GREETING + READY + frame * 20, GREETING + READY + endless, GREETING + READY + b"\x01\x01x" * 3000)
    )  # fmt: skip
    with socket.create_connection((host, int(port)), timeout=5.0) as sock:
        sock.sendall(sent)


def _memory_mb(pid: int) -> float:
    """Most memory that a process has used."""
    found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) / 1024.0 if found else 0.0
