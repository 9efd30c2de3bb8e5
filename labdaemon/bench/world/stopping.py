"""How soon a stop is on the wire: a slow serial line, amid an exchange, while clients read a long history."""

from __future__ import annotations

import json
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labdaemon.bench.kill import DaemonUnderTest, small_rig
from labdaemon.bench.world.row import WorldOptions, WorldRow
from labdaemon.stream.client import Client

CAMPAIGN = """
name = "stopping"
[[phase]]
kind = "dwell"
frequency_hz = 6.0
amplitude_mm = 0.5
hold_s = 3000
exposure_s = 0.25
settle = { timeout_s = 0.5 }
"""
GOAL_S = 0.1  # less than the table moves in half a cycle at 5 Hz
CLIENTS, REPLAYS = 4, 16
ENVELOPES = 1500  # a night's results in the journal, so that a slow answer would show
TARGETS = 72
"""An envelope of so many targets has 35 KB."""
PATIENCE_S = 60.0  # for what takes seconds on an idle machine
NUMBERS = [f"{sd}{motion}{axis}_mm" for sd in ("", "sd_") for motion in ("", "a", "b") for axis in "xyz"]
LEVEL = re.compile(r"VOLT ([0-9.eE+-]+)$")


def rows(options: WorldOptions) -> Iterator[WorldRow]:
    """One row: the slowest of nearly all stops."""
    tries = 10 if options.quick else 120
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-stopping-"))
    try:
        with small_rig(options.seed, enable_wired=False) as rig, _paced(rig) as wire:
            took = sorted(_stops(rig, wire, folder, tries, options.seed))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    p99_s = took[min(int(0.99 * len(took)), len(took) - 1)]
    what = f"stop to the first lower level on a wire of 9600 baud, {CLIENTS} × {REPLAYS} replays"
    result = f"p99 {1000 * p99_s:.0f} ms, median {1000 * took[len(took) // 2]:.0f} ms"
    yield WorldRow("stopping", what, tries, result, "p99 <= 100 ms", p99_s <= GOAL_S)


class Wire:
    """Lines that the daemon has sent to the controller, as they passed.

    Parameters
    ----------
    process
        The wire, see `labdaemon.bench.world.paced_wire`.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        self._lines = process.stdout
        self.port: int = int(self._lines.readline())
        self._passed: list[tuple[float, str]] = []
        threading.Thread(target=self._read, daemon=True).start()

    def lowered_s(self, since_s: float) -> float:
        """When, after this moment, the first line had passed that lowers the level or switches off, else infinity."""
        level = 0.0
        for at_s, text in list(self._passed):
            found = LEVEL.search(text)
            if at_s > since_s and (text == "OUTP OFF" or (found is not None and float(found[1]) < level)):
                return at_s
            if found is not None:
                level = float(found[1])
        return float("inf")

    def _read(self) -> None:
        for line in self._lines:
            passed = json.loads(line)
            self._passed.append((passed["at_s"], passed["text"]))


@contextmanager
def _paced(rig: Any) -> Iterator[Wire]:
    host, _, port = rig.addresses.ports["shaker"].removeprefix("socket://").rpartition(":")
    command = [sys.executable, "-m", "labdaemon.bench.world.paced_wire", host, port]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Wire(process)
        assert process.stdin is not None
        process.stdin.close()


def _stops(rig: Any, wire: Wire, folder: Path, tries: int, seed: int) -> Iterator[float]:
    """Seconds of each stop."""
    daemon = DaemonUnderTest(rig, folder)
    text = daemon.config.read_text().replace(rig.addresses.ports["shaker"], f"socket://127.0.0.1:{wire.port}")
    daemon.config.write_text(text)
    daemon.start()
    daemon.end()
    _write_history(daemon.data / "journal.db")
    daemon.start()
    command = [sys.executable, "-m", "labdaemon.bench.world.greedy_clients", daemon.commands]
    moments = random.Random(seed)
    try:
        with subprocess.Popen([*command, str(CLIENTS), str(REPLAYS)], stdin=subprocess.PIPE) as greedy:
            with Client(daemon.commands, timeout_s=PATIENCE_S) as client:
                client.call("campaign.submit", toml=CAMPAIGN)
                for number in range(tries):
                    if number:
                        client.call("campaign.resume")
                    _wait_until(lambda: rig.table()["moving"])
                    time.sleep(moments.uniform(0.0, 1.5))
                    yield _stop(client, wire)
                    _wait_until(lambda: client.call("status")["state"] == "paused")
            assert greedy.stdin is not None
            greedy.stdin.close()
    finally:
        daemon.end()


def _stop(client: Client, wire: Wire) -> float:
    began_s = time.monotonic()
    client.call("stop")
    _wait_until(lambda: wire.lowered_s(began_s) < float("inf"))
    return wire.lowered_s(began_s) - began_s


def _wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)


def _write_history(path: Path) -> None:
    """Add envelopes to a journal that no daemon has open."""
    row = {"target": "T01", **dict.fromkeys(NUMBERS, 0.123456789), "flags": ["at_rest"]}
    payload = json.dumps({"capture": "c", "step": 1, "frequency_hz": 5.0, "targets": [row] * TARGETS})
    with sqlite3.connect(path) as journal:
        last = journal.execute("SELECT coalesce(max(seq), 0) FROM events").fetchone()[0]
        journal.executemany(
            "INSERT INTO events VALUES (?, '2026-05-04T10:11:12.123456Z', 'envelope', NULL, ?)",
            [(last + number, payload) for number in range(1, ENVELOPES + 1)],
        )
    journal.close()
