"""The disk takes nothing for a while in the middle of a campaign: full, over quota, locked, its log unread.

Each try is a campaign of its own, through a real daemon on a simulated rig. The trouble begins while the table moves
and lasts some seconds; then the campaign must end by itself with nothing lost, repeated or missing.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import sqlite3
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labdaemon.bench.kill import DaemonUnderTest, small_rig
from labdaemon.bench.verdict import CampaignVerdict, judge
from labdaemon.bench.world.row import WorldOptions, WorldRow
from labdaemon.errors import LabdaemonError

STEPS = 4  # enough to be in the midst of a campaign when the disk fills
REST_S = 15.0
"""Longest that the table may move while nothing can be recorded."""
PATIENCE_S = 120.0  # for what takes seconds on an idle machine
DISK_BYTES = 8 << 20  # full after a few frames of the small rig
SMALLEST_BYTES = 4096
"""Of a file under the quota: less than any journal."""


@dataclass(frozen=True, slots=True)
class DiskOutcome:
    """What one try came to: seconds until the table rested (infinite if it did not), and what is left on disk."""

    rest_s: float
    verdict: CampaignVerdict


Trouble = Callable[[DaemonUnderTest], AbstractContextManager[None]]


def rows(options: WorldOptions) -> Iterator[WorldRow]:
    """A row for each kind of trouble."""
    tries, moments = 1 if options.quick else 5, random.Random(options.seed)
    for what, trouble, must_rest in (
        ("disk full", full, True),
        ("quota used up", over_quota, True),
        ("journal locked", locked, True),
        ("log unread", unread, False),
    ):
        if trouble is full and os.geteuid() != 0:
            continue  # mounting a small disk needs root; the quota stands for it
        found = [_try(trouble, options.seed + number, moments) for number in range(tries)]
        slowest_s = max(one.rest_s for one in found)
        verdict = sum((one.verdict for one in found), CampaignVerdict())
        lost = f"{verdict.frames_lost} lost, {verdict.results_repeated} repeated, {verdict.results_missing} missing, "
        lost += f"{verdict.seq_gaps} gaps, {verdict.open_ends} open"
        if must_rest:
            result, goal = f"at rest after {slowest_s:.1f} s, continued; {lost}", f"<= {REST_S:g} s, continues; 0 lost"
        else:
            result, goal = f"continued; {lost}", "continues; 0 lost"
        holds = verdict.is_well and (slowest_s <= REST_S or not must_rest)
        yield WorldRow("disk", what, tries, result, goal, holds)


@contextmanager
def full(daemon: DaemonUnderTest) -> Iterator[None]:
    """One file takes all room."""
    filler = daemon.folder / "filler"
    with suppress(OSError), filler.open("wb", buffering=0) as file:  # it ends when the disk is full, which is the aim
        while True:
            file.write(b"\0" * 4096)
    yield
    filler.unlink()


@contextmanager
def over_quota(daemon: DaemonUnderTest) -> Iterator[None]:
    """The daemon may let no file grow, as under a quota: free space says nothing of it."""
    pid = daemon.process.pid
    soft, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (SMALLEST_BYTES, hard))
    yield
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def locked(daemon: DaemonUnderTest) -> Iterator[None]:
    """Another process holds the journal's lock, as a backup does."""
    other = sqlite3.connect(daemon.data / "journal.db", PATIENCE_S, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    yield
    other.execute("ROLLBACK")
    other.close()


@contextmanager
def unread(daemon: DaemonUnderTest) -> Iterator[None]:
    """No process reads the log, whose pipe is full."""
    pipe = os.open(daemon.folder / "daemon.log", os.O_WRONLY | os.O_NONBLOCK)
    with suppress(BlockingIOError):  # nothing is left to read
        while True:
            os.write(pipe, b"\n" * 512)
    yield
    os.close(pipe)


def daemon_on_any_disk(rig: Any, folder: Path) -> DaemonUnderTest:
    """A daemon whose interlocks ask for no free space: what a full disk does to it is tried here."""
    daemon = DaemonUnderTest(rig, folder)
    text = daemon.config.read_text()
    daemon.config.write_text(text.replace("[interlocks]\n", "[interlocks]\nmin_disk_bytes = 0\n"))
    return daemon


def _try(trouble: Trouble, seed: int, moments: random.Random) -> DiskOutcome:
    with _folder(is_small_disk=trouble is full) as folder, small_rig(seed, enable_wired=False) as rig:
        daemon = daemon_on_any_disk(rig, folder)
        reader = None
        if trouble is unread:
            os.mkfifo(folder / "daemon.log")
            reader = os.open(folder / "daemon.log", os.O_RDONLY | os.O_NONBLOCK)
        try:
            return _campaign(daemon, rig, trouble, moments)
        finally:
            daemon.kill()
            if reader is not None:
                os.close(reader)


def _campaign(daemon: DaemonUnderTest, rig: Any, trouble: Trouble, moments: random.Random) -> DiskOutcome:
    daemon.start()
    for _ in range(3):  # on a busy computer the first answer may come late; asked again it queues nothing twice
        daemon.submit(STEPS)
        if _until(lambda: rig.table()["moving"], 40.0):
            break
    else:
        log = daemon.folder / "daemon.log"  # a pipe where no process is to read it
        ends = log.read_text(errors="replace")[-600:] if log.is_file() else "not kept"
        raise LabdaemonError(f"the table never moved; the daemon's log: {ends}")
    time.sleep(moments.uniform(0.0, 2.0))
    with trouble(daemon):
        began = time.monotonic()
        rested = _until(lambda: not rig.table()["moving"], REST_S + 5.0)
        rest_s = time.monotonic() - began if rested else float("inf")
        time.sleep(moments.uniform(5.0, 10.0))
    _until(daemon.is_complete, PATIENCE_S)
    daemon.end()
    on_cards = sum(len(files) for files in rig.control.ask("cards").values())
    return DiskOutcome(rest_s, judge(daemon.data, taken=len(rig.truth()), on_cards=on_cards, captures=STEPS))


@contextmanager
def _folder(*, is_small_disk: bool) -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-disk-"))
    try:
        if is_small_disk:
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", folder], check=True)
        yield folder
    finally:
        if is_small_disk:
            subprocess.run(["umount", "-l", folder], check=False)
        shutil.rmtree(folder, ignore_errors=True)


def _until(condition: Callable[[], bool], timeout_s: float = 60.0) -> bool:
    """Whether it came true in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
