"""Endings of the daemon at random moments, with an amplifier that no enable line stops: how long the table moves on."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial

from labdaemon.bench.verdict import CampaignVerdict
from labdaemon.bench.world.memory_limit import memory_limit
from labdaemon.bench.world.row import WorldOptions, WorldRow
from labdaemon.bench.world.subject import Subject, subject

DEATH_S = 2.0
"""Longest that the table may move after the daemon has died."""
HANG_S = 4.0
"""The same after it has begun to hang."""
PATIENCE_S = 15.0  # the guardian takes the table over within two
REST_S = 0.3
"""At rest counts once it has lasted so long."""
ALL, QUICK = 200, 2

End = Callable[[Subject], None]


def _signal(number: int, daemon: Subject) -> None:
    daemon.process.send_signal(number)


def _run_out_of_memory(daemon: Subject) -> None:
    """In a control group where that can be made; else all it comes to in the end, the OOM killer's signal."""
    with memory_limit(daemon.process.pid) as is_limited:
        if not is_limited:
            daemon.process.kill()
            return
        daemon.send_order("memory")
        daemon.process.wait(PATIENCE_S)


def _hang(daemon: Subject) -> None:
    daemon.send_order("hang")


ENDINGS: dict[str, tuple[End, float]] = {
    "SIGKILL": (partial(_signal, signal.SIGKILL), DEATH_S),
    "SIGHUP": (partial(_signal, signal.SIGHUP), DEATH_S),
    "SIGQUIT": (partial(_signal, signal.SIGQUIT), DEATH_S),
    "SIGABRT": (partial(_signal, signal.SIGABRT), DEATH_S),
    "out of memory": (_run_out_of_memory, DEATH_S),
    "SIGSTOP": (partial(_signal, signal.SIGSTOP), HANG_S),
    "hung event loop": (_hang, HANG_S),
}
"""How the daemon ends, and how long the table may move then, seconds."""


def rows(options: WorldOptions) -> Iterator[WorldRow]:
    """A row for each kind of ending, and one for what was lost in all of them."""
    moments, verdict, tried = random.Random(options.seed), CampaignVerdict(), 0
    for place, (what, (end, limit_s)) in enumerate(ENDINGS.items()):
        tries = QUICK if options.quick else ALL // len(ENDINGS) + (place < ALL % len(ENDINGS))
        with subject(options.seed + place) as daemon:
            took_s = sorted(_rest_after(daemon, end, moments.uniform(0.0, 4.0)) for _ in range(tries))
            verdict += daemon.finish()
        tried += tries
        result = f"at rest after {took_s[len(took_s) // 2]:.2f} s, at most {took_s[-1]:.2f} s"
        yield WorldRow("endings", what, tries, result, f"<= {limit_s:g} s", took_s[-1] <= limit_s)
    counts = (
        f"{verdict.frames_lost} frames lost, {verdict.results_repeated} results repeated, {verdict.results_missing} "
        f"missing, {verdict.seq_gaps} gaps in seq, {verdict.open_ends} left open"
    )
    yield WorldRow("endings", "after all of them", tried, counts, "0", verdict.is_well)


def _rest_after(daemon: Subject, end: End, moment_s: float) -> float:
    """Seconds from an ending at a moment of a campaign until the table rests; infinite if it does not.

    Another daemon is started afterwards.
    """
    daemon.keep_moving()
    time.sleep(moment_s)
    began = time.monotonic()
    end(daemon)
    rest_s = _seconds_until_rest(daemon, began)
    daemon.kill()  # what was stopped by a signal, or ended, is gone for certain
    daemon.start()
    return rest_s


def _seconds_until_rest(daemon: Subject, began: float) -> float:
    rested_at: float | None = None
    while time.monotonic() < began + PATIENCE_S:
        if daemon.rig.table()["moving"]:
            rested_at = None
        elif rested_at is None:
            rested_at = time.monotonic()
        elif time.monotonic() > rested_at + REST_S:
            return rested_at - began
        time.sleep(0.01)
    return float("inf")
