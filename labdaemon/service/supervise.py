"""Keeps a part of the daemon running: restarted after a failure, with growing pauses, and not for ever."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from labdaemon.clock import Clock

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Restarts:
    """How often and how fast.

    Attributes
    ----------
    limit
        Failures within `window_s` after which the last one is passed on.
    first_s, longest_s
        Pause before the first restart, doubled for each further one up to the longest.
    """

    limit: int = 5
    window_s: float = 600.0
    first_s: float = 0.5
    longest_s: float = 30.0


async def supervise(name: str, run: Callable[[], Awaitable[None]], clock: Clock, rule: Restarts = Restarts()) -> None:
    """Run `run` until it returns; restart it when it raises.

    Raises
    ------
    Exception
        What it raised last, once it has failed too often.
    """
    failures: list[float] = []
    while True:
        try:
            await run()
        except Exception:
            now_s = clock.monotonic()
            failures = [at_s for at_s in failures if now_s - at_s < rule.window_s] + [now_s]
            if len(failures) > rule.limit:
                raise
            log.exception(
                "%s failed (%d of %d within %g s) and is restarted", name, len(failures), rule.limit, rule.window_s
            )
            await clock.sleep(min(rule.first_s * 2.0 ** (len(failures) - 1), rule.longest_s))
        else:
            return
