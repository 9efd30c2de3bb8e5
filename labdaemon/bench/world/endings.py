"""Endings of the daemon at random moments, with an amplifier that no enable line stops: how long the table moves on."""

from __future__ import annotations

import random
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from labdaemon.bench.kill import Victim, small_rig
from labdaemon.bench.world.row import Options, Row
from labdaemon.stream.client import Client

CAMPAIGN = """
name = "endings"
[[phase]]
kind = "steps"
frequency_hz = { start = 4, stop = 14, count = 60 }
amplitude_mm = 0.5
exposure_s = 0.25
settle = { timeout_s = 0.5 }
"""

DEATHS = (signal.SIGKILL, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)
DEATH_S = 2.0
"""Longest that the table may move after the daemon has died."""
PATIENCE_S = 10.0


def rows(options: Options) -> Iterator[Row]:
    """A row for each kind of ending."""
    tries = 2 if options.quick else 25
    moments = random.Random(options.seed)
    for number in DEATHS:
        took = [_rest_after(number, moments, options.seed) for _ in range(tries)]
        slowest_s = max(took)
        yield Row("endings", number.name, tries, f"at rest after {slowest_s:.2f} s", "<= 2 s", slowest_s <= DEATH_S)


def _rest_after(number: signal.Signals, moments: random.Random, seed: int) -> float:
    """Seconds from a signal at a random moment of a campaign until the table rests; infinite if it does not."""
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-endings-"))
    try:
        with small_rig(seed, enable_wired=False) as rig:
            victim = Victim(rig, folder)
            victim.start()
            try:
                with Client(victim.commands, timeout_s=20.0) as client:
                    client.call("campaign.submit", toml=CAMPAIGN)
                _until_moving(rig, moments.uniform(0.0, 3.0))
                victim.process.send_signal(number)
                return _seconds_until_rest(rig)
            finally:
                victim.kill()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _until_moving(rig: Any, longer_s: float) -> None:
    """Wait until the table moves, and some time longer."""
    end = time.monotonic() + 60.0
    while not rig.table()["moving"] and time.monotonic() < end:
        time.sleep(0.02)
    time.sleep(longer_s)


def _seconds_until_rest(rig: Any) -> float:
    began = time.monotonic()
    while rig.table()["moving"]:
        if time.monotonic() > began + PATIENCE_S:
            return float("inf")
        time.sleep(0.01)
    return time.monotonic() - began
