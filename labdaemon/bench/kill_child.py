"""The daemon as `labdaemon bench kill` runs it: it kills itself at a journalled transition, once for each place of it.

``python -m labdaemon.bench.kill_child CONFIG DATA TRANSITION LEDGER``; an empty TRANSITION never kills. LEDGER lists
the places that were done before, so that each restart gets further.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labdaemon.campaign.measurement_queue import CaptureRows
from labdaemon.journal.journal import Journal
from labdaemon.processing import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, WorkerPool
from labdaemon.service.config import load_rig
from labdaemon.service.daemon import DaemonOptions, run_daemon
from labdaemon.service.pool_measurer import PoolMeasurer


class QuickMeasurer(PoolMeasurer):
    """Measures nothing but which bytes it was given, in the same workers and into the same files."""

    def __init__(self, pool: WorkerPool) -> None:
        super().__init__(pool)
        self._workers = pool

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> CaptureRows:
        return await asyncio.wrap_future(self._workers.submit(digest_rows, folder, tuple(captures), name))


def digest_rows(folder: Path, captures: tuple[str, ...], name: str) -> CaptureRows:
    """A row a frame, whose number is made of its SHA-256."""
    envelope: list[dict[str, Any]] = []
    measurements: list[dict[str, Any]] = []
    for capture in captures:
        for path in sorted((folder / "captures" / capture).iterdir()):
            if path.suffix == ".toml":
                continue
            number = int(hashlib.sha256(path.read_bytes()).hexdigest()[:6], 16) / 1e3
            row = {"capture": name, "target": path.stem, "x_mm": number, "flags": ["not_found"]}
            envelope.append(dict.fromkeys(ENVELOPE_COLUMNS) | row)
            row = {"capture": capture, "camera": path.stem, "target": "frame", "x_px": number, "flags": ["not_found"]}
            measurements.append(dict.fromkeys(MEASUREMENT_COLUMNS) | row)
    return CaptureRows(envelope, measurements)


class KillTrigger:
    """Listens to the journal, and ends the process at one transition.

    Parameters
    ----------
    transition
        As `Journal.listen` reports them, as ``capture.fired`` (after its commit) or ``before capture.fired``.
    ledger
        File of places that were done.
    """

    def __init__(self, journal: Journal, transition: str, ledger: Path) -> None:
        self._journal, self._transition, self._ledger = journal, transition, ledger
        self._done = set(ledger.read_text().split("\n")) if ledger.exists() else set()

    def __call__(self, name: str) -> None:
        """Hear of a transition."""
        if name != self._transition:
            return
        place = f"{name} {self._place(name)}"
        if place in self._done:
            return
        with self._ledger.open("a") as file:
            file.write(place + "\n")
            file.flush()
            os.fsync(file.fileno())
        os.kill(os.getpid(), signal.SIGKILL)

    def _place(self, name: str) -> int:
        table, column = ("results", "count(*)") if name.endswith("envelope") else ("steps", "coalesce(max(step), -1)")
        return int(self._journal.read(f"SELECT {column} FROM {table}")[0][0])


def main(arguments: list[str]) -> int:
    """Run it."""
    config, data, transition, ledger = arguments

    def measurer(pool: WorkerPool, journal: Journal) -> QuickMeasurer:
        if transition:
            journal.listen(KillTrigger(journal, transition, Path(ledger)))
        return QuickMeasurer(pool)

    def ready(commands: str, events: str) -> None:
        print(json.dumps({"commands": commands, "events": events}), flush=True)

    return run_daemon(load_rig(Path(config)), DaemonOptions(Path(data)), ready=ready, measurer=measurer)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
