"""A publisher in a process of its own: the daemon's, or a bare PUB socket that sends the same bytes.

``python -m labdaemon.bench.stream.publisher_child ours|bare EVENTS [KEYS]`` prints its address and sends a greeting
until a line comes on standard input. At each line it prints what it has used, CPU seconds and megabytes, and at each
line "go" it then sends EVENTS envelopes as fast as it can. With a folder of KEYS everything is encrypted.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from labdaemon.clock import SystemClock
from labdaemon.journal.event import EventText
from labdaemon.processing import ENVELOPE_COLUMNS
from labdaemon.stream.access import KeyAccess, own_pair
from labdaemon.stream.publisher import EventPublisher
from labdaemon.stream.sockets import ANYBODY, EVENTS_HIGH_WATER, DoorPolicy

TARGETS = 360
GREETING_MS = 20
GO = "go\n"


class BenchOutbox:
    """Events that are committed as soon as they are added."""

    uuid = "bench"

    def __init__(self) -> None:
        self.events: list[EventText] = []

    @property
    def last_seq(self) -> int:
        return len(self.events)

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        return self.events[seq : seq + limit]

    history = recent

    def latest(self) -> list[EventText]:
        return self.events[-1:]


def envelopes(count: int) -> Iterator[EventText]:
    """Envelopes of 360 targets each, as the journal gives them."""
    row = dict.fromkeys(ENVELOPE_COLUMNS, 0.123456) | {"flags": ["at_rest"], "sign": 1, "residual_ratio": None}
    targets = [row | {"target": f"T{place:03d}", "capture": "00001-steps-12.000hz-01"} for place in range(TARGETS)]
    data = json.dumps({"capture": "c", "frequency_hz": 12.0, "targets": targets}, separators=(",", ":"))
    for seq in range(1, count + 1):
        head = f'{{"v":1,"seq":{seq},"at":"2026-01-01T00:00:00Z","kind":"envelope","campaign":"0001","journal":"bench"'
        yield EventText(seq, "envelope", f'{head},"data":{data}}}'.encode())


def used() -> str:
    """CPU seconds and megabytes of this process."""
    found = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    return json.dumps({"cpu_s": time.process_time(), "memory_mb": int(found[1]) / 1024.0 if found else 0.0})


def send_bare(count: int, keys: Path | None) -> None:
    """A PUB socket with the same high-water mark, encrypted where a folder of keys is given, and nothing else."""
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        socket.set(zmq.SNDHWM, EVENTS_HIGH_WATER)
        socket.set(zmq.LINGER, 0)
        if keys is not None:
            pair = own_pair(keys)
            socket.set(zmq.CURVE_SERVER, 1)
            socket.set(zmq.CURVE_PUBLICKEY, pair.public.encode())
            socket.set(zmq.CURVE_SECRETKEY, pair.secret.encode())
        port = socket.bind_to_random_port("tcp://127.0.0.1")
        prepared = list(envelopes(count))
        print(f"tcp://127.0.0.1:{port}", flush=True)
        poller = zmq.Poller()
        poller.register(sys.stdin.fileno(), zmq.POLLIN)
        while not poller.poll(GREETING_MS):
            socket.send_multipart([b"status", b"{}"])
        while line := sys.stdin.readline():
            print(used(), flush=True)
            for event in prepared if line == GO else ():
                socket.send_multipart([event.kind.encode(), event.json])


async def send_ours(count: int, keys: Path | None) -> None:
    """The daemon's publisher."""
    outbox = BenchOutbox()
    policy = DoorPolicy(KeyAccess(keys)) if keys is not None else ANYBODY
    publisher = EventPublisher("tcp://127.0.0.1:*", outbox, lambda: {"campaign": None}, SystemClock(), policy)
    publisher.bind()
    running = asyncio.create_task(publisher.run())
    prepared = list(envelopes(count))
    print(publisher.address, flush=True)
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        print(used(), flush=True)
        if line == GO:
            last = outbox.last_seq
            outbox.events.extend(EventText(last + event.seq, event.kind, event.json) for event in prepared)
            publisher.wake()
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    publisher.close()


if __name__ == "__main__":
    which, number = sys.argv[1], int(sys.argv[2])
    folder = Path(sys.argv[3]) if len(sys.argv) > 3 else None
    if which == "bare":
        send_bare(number, folder)
    else:
        asyncio.run(send_ours(number, folder))
