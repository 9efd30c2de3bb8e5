"""A busy machine is no hung daemon: eight processes that compute, touch memory and sync files, for half an hour."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labdaemon.bench.world.row import WorldOptions, WorldRow
from labdaemon.bench.world.subject import Subject, subject
from labdaemon.errors import LabdaemonError

BUSY = 8  # programs at once on two cores: four times what they can do
GAP_S = 0.7
"""Longest time between two heartbeats that is aimed at."""
LOOK_S = 0.5  # as often as a person would look


def rows(options: WorldOptions) -> Iterator[WorldRow]:
    """One row: how often the guardian or the daemon gave up, and the longest gap between two heartbeats."""
    with subject(options.seed) as daemon, busy_machine(daemon.folder):
        daemon.keep_moving()
        first, trips, moved, looks = _guardian(daemon)["pid"], 0, 0, 0
        end = time.monotonic() + 60.0 * options.soak_minutes
        longest_s = 0.0
        while time.monotonic() < end:
            if daemon.process.poll() is not None:
                trips += 1
                daemon.start()
            daemon.keep_busy()
            looks += 1
            moved += bool(daemon.rig.table()["moving"])
            found = _guardian(daemon)
            longest_s = max(longest_s, found["longest_gap_s"])
            trips += found["pid"] not in (None, first)
            first = found["pid"] or first
            time.sleep(LOOK_S)
    yield WorldRow(
        "false trips",
        f"{options.soak_minutes:g} min under {BUSY} busy processes, table moving {100 * moved // max(looks, 1)} %",
        looks,
        f"{trips} trips, longest gap between heartbeats {longest_s:.2f} s",
        f"0, <= {GAP_S:g} s",
        trips == 0 and longest_s <= GAP_S,
    )


def _guardian(daemon: Subject) -> dict[str, Any]:
    try:
        found: dict[str, Any] = daemon.ask("status")["guardian"]
    except LabdaemonError:  # it has just ended, which the next look counts
        return {"pid": None, "longest_gap_s": 0.0}
    return found


@contextmanager
def busy_machine(folder: Path) -> Iterator[None]:
    """Busy processes, whose files lie on the disk of a folder."""
    command = [sys.executable, "-m", "labdaemon.bench.world.busy"]
    busy = [subprocess.Popen([*command, str(folder / f"busy-{number}")]) for number in range(BUSY)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
        for process in busy:
            process.wait()
