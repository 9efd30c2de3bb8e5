"""The daemon that the sections try: a process on a simulated rig whose amplifier no enable line stops."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from labdaemon.bench.kill import DaemonUnderTest, small_rig
from labdaemon.bench.verdict import CampaignVerdict, judge
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client import Client

STEPS = 6  # something is always left to do when the test's act comes
CAMPAIGN = f"""
name = "world"
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
[[phase]]
kind = "steps"
frequency_hz = {{ start = 4, stop = 14, count = {STEPS} }}
amplitude_mm = 0.5
exposure_s = 0.25
settle = {{ timeout_s = 0.5 }}
"""
PATIENCE_S = 300.0  # for what takes seconds on an idle machine


class NotInTime(LabdaemonError):
    """What a bench waits for did not happen."""


class Subject(DaemonUnderTest):
    """A daemon that walks one short campaign after the other.

    Attributes
    ----------
    campaigns
        How many were submitted.
    """

    def __init__(self, rig: Any, folder: Path) -> None:
        super().__init__(rig, folder)
        self.campaigns: int = 0
        text = self.config.read_text()
        if "accept_no_enable" not in text:
            self.config.write_text(text.replace("[interlocks]\n", "[interlocks]\naccept_no_enable = true\n", 1))

    def start(self, transition: str = "") -> float | None:
        """Start it and wait until it serves."""
        command = [sys.executable, "-m", "labdaemon.bench.world.ending_child", str(self.config), str(self.data)]
        with (self.folder / "daemon.log").open("a") as log:
            self.process: subprocess.Popen[str] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
            )
        assert self.process.stdout is not None
        if not self.process.stdout.readline():
            raise LabdaemonError(f"the daemon did not serve; its log ends: {self.log_tail()}")
        return None

    def log_tail(self) -> str:
        """The last lines of its log."""
        return (self.folder / "daemon.log").read_text(errors="replace")[-600:]

    def ask(self, method: str, **params: Any) -> Any:
        """One command."""
        with Client(self.commands, timeout_s=20.0) as client:
            return client.call(method, **params)

    def send_order(self, word: str) -> None:
        """Say what it is to do to itself, see `labdaemon.bench.world.ending_child`."""
        assert self.process.stdin is not None
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()

    def keep_moving(self) -> None:
        """Submit a campaign if there is none, and wait until the table moves."""
        self.wait_until("the table moves", lambda: self.keep_busy() and self.rig.table()["moving"])

    def finish(self) -> CampaignVerdict:
        """Let the last campaign complete, end the daemon, and judge what is on disk."""
        self.wait_until("its campaign has ended", self.is_idle)
        self.end()
        on_cards = sum(len(files) for files in self.rig.control.ask("cards").values())
        taken = len(self.rig.truth())
        return judge(self.data, taken=taken, on_cards=on_cards, captures=STEPS * self.campaigns, has_files=False)

    def wait_until(self, what: str, condition: Callable[[], bool]) -> None:
        """Wait for something of the daemon.

        Raises
        ------
        LabdaemonError
            It did not come true in time; the message says what the daemon reports instead, and how its log ends.
        """
        try:
            wait_for(condition)
        except NotInTime as exc:
            try:
                state = str(self.ask("status"))
            except LabdaemonError as silence:
                state = str(silence)
            raise LabdaemonError(f"{what}: {exc}; status: {state}; log: {self.log_tail()}") from None

    def is_idle(self) -> bool:
        """Whether it has nothing left to do. While it starts it does not know yet what an earlier one left."""
        status = self.ask("status")
        return status["state"] == "idle" and status["campaign"] is None and not status["queue"]

    def keep_busy(self) -> bool:
        """Submit a campaign if there is none, resume one that paused; false while it starts."""
        status = self.ask("status")
        if status["state"] == "starting":
            return False
        if status["campaign"] is None and not status["queue"]:
            self.ask("campaign.submit", toml=CAMPAIGN)
            self.campaigns += 1
        elif status["state"] == "paused":
            with suppress(LabdaemonError):  # it went on meanwhile
                self.ask("campaign.resume")
        return True

    def _reap(self) -> None:
        super()._reap()
        if self.process.stdin is not None:
            with suppress(BrokenPipeError):  # it has ended by itself
                self.process.stdin.close()


@contextmanager
def subject(seed: int) -> Iterator[Subject]:
    """A daemon on a rig of its own; both are gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-world-"))
    try:
        with small_rig(seed, enable_wired=False) as rig:
            found = Subject(rig, folder)
            found.start()
            try:
                yield found
            finally:
                found.kill()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def wait_for(condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> None:
    """Wait until it comes true.

    Raises
    ------
    NotInTime
        It did not.
    """
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            raise NotInTime(f"did not happen within {timeout_s:g} s")
        time.sleep(0.02)
