"""Mutated messages over all sockets: DEALER, REQ, raw ZMTP frames with right lengths, HTTP, text."""

from __future__ import annotations

import random
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress

import zmq

from labdaemon.bench.stream.options import StreamOptions
from labdaemon.bench.stream.served_daemon import ServedDaemon, served_daemon
from labdaemon.bench.world.messages import GREETING, READY
from labdaemon.bench.world.mutations import SPECIAL_BYTES, message, mutated_bytes
from labdaemon.bench.world.row import WorldRow
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client import Client

SILENT_S = 10.0
PROBE_EVERY = 1000
MOST_GROWTH_MB = 50.0
GOAL = f"alive, memory flat (<= {MOST_GROWTH_MB:g} MB), one log line a peer and minute, no answer after {SILENT_S:g} s"
SERVERS = ("labdaemon.stream", "labdaemon.gateway", "labdaemon.web")
"""Loggers of the sockets."""
REQUESTS = (
    b"GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /events?after=3 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
    b"POST /rpc HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n{}",
    b"POST /command/status HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
    b"GET /latest/envelope.csv HTTP/1.1\r\nHost: evil.example\r\nOrigin: http://evil.example\r\n\r\n",
)
LINES = (
    b"*IDN?\n", b"CAPT:FREQ 5 HZ;AMPL 2 MM;PHAS 90 DEG\n", b'CAPT:LAB "a;b";GRO \'c\'\n', b"ENV?;:STAT?\n",
    b"SYST:ERR:ALL?\n", b"SYST:HELP:HEAD?\n", b"*ESE 255;*SRE 255;*STB?\n", b"ENV? 'T1'\n", b"*CLS;*RST\n",
)  # fmt: skip
"""Nothing that would fire or stop."""


def rows(options: StreamOptions) -> Iterator[WorldRow]:
    """One row for all sockets."""
    with served_daemon(options.seed) as served:
        sent, slowest_s, grown_mb = _attack(served, random.Random(options.seed), options.messages)
        is_alive = served.process.poll() is None
        most_lines = _most_lines_a_minute(served)
    holds = is_alive and slowest_s <= SILENT_S and grown_mb <= MOST_GROWTH_MB and most_lines <= 1
    result = (
        f"{'alive' if is_alive else 'dead'}, {grown_mb:+.0f} MB, at most {most_lines} lines of one server and peer a "
        f"minute, slowest status {slowest_s:.2f} s"
    )
    kinds = ", ".join(f"{name} {count}" for name, count in sent.items())
    yield WorldRow("hostile", kinds, sum(sent.values()), result, GOAL, holds)


def _most_lines_a_minute(served: ServedDaemon) -> int:
    """Most lines that the log has of one server within a clock minute; all peers here are one address."""
    lines = [line for line in served.log_lines() if line["level"] in {"warning", "error"}]
    lines = [line for line in lines if line["logger"].startswith(SERVERS)]
    counts = Counter((line["at"][:16], line["message"].partition(": ")[0]) for line in lines)
    return max(counts.values(), default=0)


def _attack(served: ServedDaemon, source: random.Random, tries: int) -> tuple[Counter[str], float, float]:
    """Send so many; how many of each kind, the slowest status meanwhile, and the growth after the first tenth."""
    kinds: dict[str, Callable[[ServedDaemon, random.Random], int]] = {
        "DEALER": _by_dealer,
        "REQ": _by_req,
        "ZMTP": _by_zmtp,
        "HTTP": _by_http,
        "text": _by_text,
    }
    sent: Counter[str] = Counter()
    slowest_s, first_mb, grown_mb, probed = 0.0, 0.0, 0.0, 0
    with Client(served.commands, timeout_s=SILENT_S * 3) as probe:
        while sent.total() < tries:
            name = min(kinds, key=lambda kind: sent[kind])
            with suppress(OSError, zmq.ZMQError):  # the daemon has no place for it now
                sent[name] += kinds[name](served, source)
            if sent.total() >= probed:
                probed = sent.total() + PROBE_EVERY
                began_s = time.monotonic()
                try:
                    probe.call("status")
                except LabdaemonError:
                    return sent, float("inf"), grown_mb
                slowest_s = max(slowest_s, time.monotonic() - began_s)
                if sent.total() >= tries // 10:
                    first_mb = first_mb or served.memory_mb()
                    grown_mb = served.memory_mb() - first_mb
    return sent, slowest_s, grown_mb


BURST, HTTP_BURST = 50, 5
"""Messages over one connection, unless the daemon ends it earlier; only what was sent is counted."""
TAKEN_S = 0.1
"""A message that is not taken in that time is the connection's last."""


def _by_dealer(served: ServedDaemon, source: random.Random) -> int:
    with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:
        dealer.set(zmq.LINGER, 200)
        dealer.set(zmq.SNDTIMEO, 500)
        dealer.connect(served.commands)
        for _ in range(BURST):
            dealer.send_multipart(message(source))
            while dealer.poll(0):
                dealer.recv_multipart()
    return BURST


def _by_req(served: ServedDaemon, source: random.Random) -> int:
    with zmq.Context() as context, context.socket(zmq.REQ) as req:
        req.set(zmq.LINGER, 200)
        req.set(zmq.REQ_RELAXED, 1)
        req.set(zmq.SNDTIMEO, 500)
        req.connect(served.commands)
        for _ in range(BURST):
            req.send(message(source)[-1])
            if req.poll(20):
                req.recv_multipart()
    return BURST


def _by_zmtp(served: ServedDaemon, source: random.Random) -> int:
    """A right greeting, then frames with right lengths and wrong everything else."""
    return _send_until_refused(
        served, source.choice((served.commands, served.events)), (_zmtp_frame(source) for _ in range(BURST)),
        GREETING + READY,
    )  # fmt: skip


def _zmtp_frame(source: random.Random) -> bytes:
    body = source.choice((source.randbytes(source.randrange(200)), *message(source)[:1]))[:60_000]
    flags = source.choice((0, 0, 0, 1, 4, 5, 8, 0x40))
    if len(body) < 256 and source.random() < 0.8:
        return bytes([flags, len(body)]) + body
    return bytes([flags | 2]) + len(body).to_bytes(8, "big") + body


def _by_http(served: ServedDaemon, source: random.Random) -> int:
    def requests() -> Iterator[bytes]:
        for _ in range(HTTP_BURST):
            request = source.choice(REQUESTS)
            yield mutated_bytes(source, request) if source.random() < 0.7 else request

    return sum(_send_until_refused(served, served.web, requests()) for _ in range(BURST // HTTP_BURST))


def _by_text(served: ServedDaemon, source: random.Random) -> int:
    return _send_until_refused(served, served.gateway, (_text_line(source) for _ in range(BURST)))


def _text_line(source: random.Random) -> bytes:
    while True:
        line = source.choice(LINES)
        kind = source.random()
        if kind < 0.5:
            line = mutated_bytes(source, line) + b"\n"
        elif kind < 0.6:
            line = source.choice((*SPECIAL_BYTES, b"x" * 9000, source.randbytes(100))) + b"\n"
        if not any(word in line.upper() for word in (b"TRI", b"*TRG", b"STOP")):
            return line


def _send_until_refused(served: ServedDaemon, address: str, data: Iterable[bytes], greeting: bytes = b"") -> int:
    """How many were sent over one connection before the daemon hung up."""
    sent = 0
    with served.connect(address) as sock, suppress(OSError):
        sock.settimeout(TAKEN_S)  # subscribers are read slowly
        sock.sendall(greeting)
        for one in data:
            sock.sendall(one)
            sent += 1
            if _has_hung_up(sock):
                return sent
        _drain(sock)
    return sent


def _has_hung_up(sock: socket.socket) -> bool:
    """Read what has come, without waiting; whether the daemon has closed the connection."""
    try:
        return not sock.recv(65536, socket.MSG_DONTWAIT)
    except BlockingIOError:
        return False


def _drain(sock: socket.socket) -> None:
    """Read what comes in the next moment, and leave."""
    sock.settimeout(0.002)
    while sock.recv(65536):
        continue
