"""Keeps a part of the daemon running: restarted after a failure, with growing pauses, and not for ever."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from labdaemon.clock import Clock
from labdaemon.errors import LabdaemonError, ServiceFailure, StorageUnavailable, UsageError

log: logging.Logger = logging.getLogger(__name__)

DISK_S = 2.0
"""Pause before a part that only waits for the disk is started again."""


@dataclass(frozen=True, slots=True)
class RestartPolicy:
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


async def supervise(
    name: str, run: Callable[[], Awaitable[None]], clock: Clock, policy: RestartPolicy = RestartPolicy()
) -> None:
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
        except Exception as exc:
            if is_disk_failure(exc):
                # However long the disk takes nothing, it is no failure of this part.
                log.warning("%s waits for the disk: %s", name, exc)
                await clock.sleep(min(policy.longest_s, DISK_S))
                continue
            now_s = clock.monotonic()
            failures = [at_s for at_s in failures if now_s - at_s < policy.window_s] + [now_s]
            if len(failures) > policy.limit:
                raise
            log.exception(
                "%s failed (%d of %d within %g s) and is restarted", name, len(failures), policy.limit, policy.window_s
            )
            await clock.sleep(min(policy.first_s * 2.0 ** (len(failures) - 1), policy.longest_s))
        else:
            return


def is_disk_failure(exc: BaseException) -> bool:
    """Whether an error, or each of a group of errors, passes when the disk takes writes again."""
    if isinstance(exc, BaseExceptionGroup):
        return all(is_disk_failure(one) for one in exc.exceptions)
    return isinstance(exc, StorageUnavailable)


def as_failure(exc: BaseException) -> BaseException:
    """What ended a part of the running service, as what ends the service: in one line, and never exit status 2."""
    if isinstance(exc, BaseExceptionGroup):
        return as_failure(exc.exceptions[0])
    if isinstance(exc, LabdaemonError) and exc.exit_status == UsageError.exit_status:
        return ServiceFailure(str(exc))
    return exc
