"""Late joiners, clients that come back, and a long history read while somebody stops the table."""

from __future__ import annotations

import logging
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np

from labdaemon.bench.stream.options import StreamOptions
from labdaemon.bench.stream.publisher_child import envelopes
from labdaemon.bench.world.row import WorldRow
from labdaemon.clock import SystemClock
from labdaemon.journal.journal import Journal
from labdaemon.stream.client import Client, EventStream, NoDaemon
from labdaemon.testing.stream_daemon import StreamDaemon

JOINERS = 1000
AT_A_TIME = 8
EVENT_PAUSE_S = 0.01
BEHIND = 200
"""A joiner begins at most so many events behind the newest, and hears `AHEAD` more than there were."""
AHEAD = 3
RESTARTS = 10
BACK_S = 1.0
HISTORY_HOURS, CAPTURE_EACH_S = 8, 20
"""A night: one capture each 20 s, with the events of its step."""
REPLAY_S, STOP_S = 10.0, 0.1
STOP_EACH_S, QUIET_S = 0.05, 5.0
"""Between two stops, and how long they are sent without a replay."""


def rows(options: StreamOptions) -> Iterator[WorldRow]:
    """Gaps of late joiners, time until clients hear again, and the replay of a night."""
    logging.getLogger("labdaemon").addHandler(logging.NullHandler())
    daemon = StreamDaemon()
    daemon.start()
    try:
        yield _join(daemon, options)
        yield _return(daemon)
    finally:
        daemon.stop()
    yield from _replay_night()


def _join(daemon: StreamDaemon, options: StreamOptions) -> WorldRow:
    """Joiners at random moments, with subscribers that stay."""
    source, is_over = random.Random(options.seed), threading.Event()
    starts = [source.randrange(BEHIND) for _ in range(JOINERS)]

    def publish() -> None:
        while not is_over.wait(EVENT_PAUSE_S):
            daemon.publish("fault", {"message": "m"})

    def stay() -> int:
        with Client(daemon.commands, daemon.events, timeout_s=60.0) as client, client.listen(timeout_s=60.0) as stream:
            return _gaps(stream, is_over.is_set)

    def join(behind: int) -> int:
        with Client(daemon.commands, daemon.events, timeout_s=60.0) as client:
            newest = daemon.outbox.last_seq
            with closing(EventStream(client, after=max(newest - behind, 0))) as stream:
                return _gaps(stream, lambda: (stream.last or 0) >= newest + AHEAD)

    with ThreadPoolExecutor(options.subscribers) as staying, ThreadPoolExecutor(AT_A_TIME) as joining:
        publisher = threading.Thread(target=publish)
        publisher.start()
        stayed = [staying.submit(stay) for _ in range(options.subscribers)]
        gaps = sum(joining.map(join, starts))
        is_over.set()
        publisher.join()
        daemon.publish("fault", {"message": "last"})
        gaps += sum(one.result() for one in stayed)
    what = f"late joiners at random moments, with {options.subscribers} subscribers: gaps after replay"
    return WorldRow("joiners", what, JOINERS, f"{gaps} gaps", "0 gaps", gaps == 0)


def _gaps(stream: EventStream, is_enough: Callable[[], bool]) -> int:
    """Events that are missing or out of order, until it is enough."""
    gaps, before = 0, None
    while not is_enough():
        event = stream.receive(60.0)
        if event is None:
            return gaps + 1
        if event["kind"] == "status":
            continue
        gaps += before is not None and event["seq"] != before + 1
        before = event["seq"]
    return gaps


def _return(daemon: StreamDaemon) -> WorldRow:
    """How soon a client hears again once the sockets are bound."""
    took: list[float] = []
    with Client(daemon.commands, daemon.events) as client, client.listen(timeout_s=60.0) as stream:
        for _ in range(RESTARTS):
            daemon.stop()
            while stream.receive(0.3) is not None:
                pass
            daemon.start()
            bound_s = time.monotonic()
            while _hear(stream) is None:
                pass
            took.append(time.monotonic() - bound_s)
    result = f"{sorted(took)[len(took) // 2]:.2f} s, longest {max(took):.2f} s"
    return WorldRow(
        "joiners", "time until a client hears again once the sockets are bound", RESTARTS, result,
        f"<= {BACK_S:g} s", max(took) <= BACK_S,
    )  # fmt: skip


def _hear(stream: EventStream) -> object:
    try:
        return stream.receive(5.0)
    except NoDaemon:
        return None


def _replay_night() -> Iterator[WorldRow]:
    """A night's history over the commands socket, and stops meanwhile; the history lies in a journal in memory."""
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-night-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        journal = Journal(folder, SystemClock(), synchronous="OFF")
        captures = HISTORY_HOURS * 3600 // CAPTURE_EACH_S
        text = next(envelopes(1)).json.decode().partition('"data":')[2].removesuffix("}")
        small = ("step.started", "capture.completed", "step.completed")
        with journal.transaction("bench") as write:
            for _ in range(captures):
                for kind, data in [*((kind, '{"step":0,"capture":"c"}') for kind in small), ("envelope", text)]:
                    write.last_seq += 1
                    write.execute("INSERT INTO events VALUES (?, ?, ?, NULL, ?)", write.last_seq, write.at, kind, data)
        daemon = StreamDaemon(outbox=journal)
        daemon.start()
        try:
            yield from _measure_replay(daemon, captures)
        finally:
            daemon.stop()
            journal.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _measure_replay(daemon: StreamDaemon, captures: int) -> Iterator[WorldRow]:
    quiet = _stop_repeatedly(daemon, lambda: time.sleep(QUIET_S))
    read: list[float] = []
    used_s = time.process_time()

    def read_all() -> None:
        # A process of its own: what the reader's JSON costs must not be counted as the daemon's.
        reader = [sys.executable, "-P", "-m", "labdaemon.bench.stream.replay_child", daemon.commands]
        read.extend(map(float, subprocess.run(reader, capture_output=True, text=True, check=True).stdout.split()))

    stops = _stop_repeatedly(daemon, read_all)
    used_s, (took_s, reader_s) = time.process_time() - used_s, read
    what = f"{HISTORY_HOURS} hours ({captures} envelopes of 360 targets) replayed"
    # One waits for the other, so on an idle machine it takes as long as both use the processor.
    result = f"{took_s:.1f} s; CPU: daemon and stops {used_s:.1f} s, reader {reader_s:.1f} s"
    yield WorldRow(
        "joiners", what, daemon.outbox.last_seq, result, f"< {REPLAY_S:g} s, of CPU where the machine is busy",
        min(took_s, used_s + reader_s) < REPLAY_S,
    )  # fmt: skip
    late, without = (float(np.quantile(times, 0.99)) for times in (stops, quiet))
    yield WorldRow(
        "joiners", "stop sent and answered meanwhile", len(stops),
        f"99th percentile {1000 * late:.0f} ms (without a replay {1000 * without:.0f} ms), longest "
        f"{1000 * max(stops):.0f} ms",
        f"99th percentile <= {1000 * STOP_S:g} ms more than without", late <= STOP_S + without,
    )  # fmt: skip


def _stop_repeatedly(daemon: StreamDaemon, meanwhile: Callable[[], object]) -> list[float]:
    """Seconds that each stop took while something else was done."""
    stops: list[float] = []
    is_over = threading.Event()

    def stop() -> None:
        with Client(daemon.commands, daemon.events, timeout_s=60.0) as client:
            while not (stops and is_over.wait(STOP_EACH_S)):
                began_s = time.monotonic()
                client.call("stop")
                stops.append(time.monotonic() - began_s)

    stopper = threading.Thread(target=stop)
    stopper.start()
    try:
        meanwhile()
    finally:
        is_over.set()
        stopper.join()
    return stops
