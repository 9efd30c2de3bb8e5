"""The guardian's life: hear the daemon's heartbeat, and stop the table when it ceases.

Lines of JSON on standard input: first ``{"daemon": pid, "recipe": …, "silence_s": …, "patience_s": …, "report": …,
"rig": …}``, then heartbeats ``{"beat": n, "moving": bool}``, at the end ``{"bye": true}``, or ``{"leaves": true}``
where the table was not seen to come to rest: the daemon ends by itself, and its exit status says so. On standard output
each heartbeat is answered by ``{"heard": n, "longest_s": …}``, so that the daemon knows that it is guarded.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import time
from contextlib import suppress
from typing import Any

from labdaemon.guardian.guarded_process import GuardedProcess
from labdaemon.guardian.recipe import StopRecipe, from_json, read_message
from labdaemon.guardian.rescue import EMERGENCY, RescueOutcome, rescue
from labdaemon.guardian.rescue_reporter import RescueReporter
from labdaemon.guardian.silence_timer import ClockReading, SilenceTimer, now

TICK_S = 0.1  # a tenth of the silence that is allowed
GONE_S = 0.2
"""A daemon whose end of the pipe is closed is ending; it is given so long to be gone."""
LEAVE_S = 10.0
"""A daemon that said it leaves sends no more heartbeats, and is given so long to end by itself."""
UNSTOPPABLE = {signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL}
HAND_OVER = signal.SIGUSR1
"""A newer daemon that waits sends this: after some seconds without success the guardian leaves the table to it."""
WANTED_S = 60.0
"""A daemon waits for less than this; an older signal was meant for another rescue."""


class HeartbeatMonitor:
    """Listens to one daemon.

    Parameters
    ----------
    setup
        The first line of the pipe.
    guarded
        The daemon.
    """

    def __init__(self, setup: dict[str, Any], guarded: GuardedProcess) -> None:
        self.recipe: StopRecipe = from_json(setup["recipe"])
        self.silence_s: float = float(setup["silence_s"])
        self.patience_s: float = float(setup["patience_s"])
        self.reporter: RescueReporter = RescueReporter(setup["rig"], setup["report"])
        self._guarded, self._moving, self._bye, self._rest = guarded, True, False, b""
        self._silence = SilenceTimer(now())
        self._wanted_at = -math.inf

    def hand_over(self, *_: object) -> None:
        """Signal handler: a newer daemon waits."""
        self._wanted_at = time.monotonic()

    def run(self, source: int, answers: int) -> int:
        """Watch until the daemon says goodbye or is gone; the exit status.

        Parameters
        ----------
        source, answers
            Descriptors of the two pipes.
        """
        reason = self._until_needed(source, answers)
        if reason is None:
            return 0
        return self._rescue(reason)

    def feed(self, data: bytes, at: ClockReading) -> list[int]:
        """Take bytes of the pipe; the numbers of the heartbeats that they hold."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        beats = []
        for message in map(read_message, lines):
            if message.get("bye") is True:
                self._bye = True
            if message.get("leaves") is True:
                self.silence_s = LEAVE_S
            if isinstance(message.get("beat"), int):
                # Long work at rest (imports, a listing) is no gap that matters.
                self._silence.record_heartbeat(at, counts=self._moving and message.get("moving") is True)
                beats.append(message["beat"])
            if isinstance(message.get("moving"), bool):
                self._moving = message["moving"]
        return beats

    def _is_wanted(self) -> bool:
        return time.monotonic() < self._wanted_at + WANTED_S

    def _until_needed(self, source: int, answers: int) -> str | None:
        """Hear heartbeats; why they ceased, None after a goodbye."""
        poll = select.poll()
        poll.register(source, select.POLLIN | select.POLLHUP)
        if self._guarded.descriptor is not None:
            # A process that the daemon has forked may hold the pipe open long after the daemon is gone.
            poll.register(self._guarded.descriptor, select.POLLIN)
        while True:
            ready = dict(poll.poll(1000 * TICK_S))
            if source in ready:
                data = os.read(source, 1 << 16)
                beats = self.feed(data, now())
                if self._bye:
                    return None
                if not data:
                    return "ended without bringing the table to rest"
                _answer(answers, beats, self._silence.longest_s)
            elif ready:
                return "ended without bringing the table to rest"
            if self._silence.tick(now()) > self.silence_s and self._moving and not poll.poll(0):
                return f"has been silent for {self._silence.silent_s:.1f} s with the table moving"

    def _rescue(self, reason: str) -> int:
        was_killed = self._guarded.end(GONE_S if reason.startswith("ended") else 0.0)
        why = f"the daemon (process {self._guarded.pid}) {reason}{' and was killed' if was_killed else ''}"
        self.reporter.say(f"{why}; stopping {self.recipe.device}")
        outcome = rescue(self.recipe, self.reporter, patience_s=self.patience_s, is_wanted=self._is_wanted)
        self.reporter.conclude(f"{why}; {_outcome_text(outcome)}", {"why": why, **outcome._asdict()})
        return 0 if outcome.is_at_rest else 1


def _outcome_text(outcome: RescueOutcome) -> str:
    if outcome.is_at_rest:
        return f"the table was seen at rest {outcome.after_s:.2f} s later (try {outcome.tries})"
    return f"{EMERGENCY} ({outcome.trouble}; {outcome.tries} tries in {outcome.after_s:.0f} s, no more are made here)"


def _answer(answers: int, beats: list[int], longest_s: float) -> None:
    if beats:
        with suppress(OSError):  # it does not read, or is gone: that is heard on the other pipe
            os.write(answers, json.dumps({"heard": beats[-1], "longest_s": round(longest_s, 3)}).encode() + b"\n")


def ignore_signals() -> None:
    """What ends the daemon and its terminal must not end the guardian."""
    for number in signal.valid_signals() - UNSTOPPABLE - {signal.SIGCHLD}:
        signal.signal(number, signal.SIG_IGN)


def read_setup(source: int) -> dict[str, Any]:
    """The first line; empty when the daemon was gone before it had sent one."""
    data = b""
    while not data.endswith(b"\n"):
        more = os.read(source, 1)  # a byte at a time: what follows is the heartbeats'
        if not more:
            return {}
        data += more
    return read_message(data)


def main() -> int:
    """Guard the parent process; the exit status is 0 when the table rests as far as is known."""
    ignore_signals()
    os.chdir("/")  # keeps no file system busy
    setup = read_setup(0)
    if not setup:
        return 0  # nothing has moved yet
    watch = HeartbeatMonitor(setup, GuardedProcess(setup["daemon"]))
    signal.signal(HAND_OVER, watch.hand_over)
    os.set_blocking(1, False)
    return watch.run(0, 1)
