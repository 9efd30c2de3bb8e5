"""Talks to systemd: ready, stopping, and a watchdog that is fed only while everything moves.

The protocol is a datagram to the socket named by ``NOTIFY_SOCKET`` (sd_notify(3)); without it nothing is sent.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress

from labdaemon.clock import Clock

log: logging.Logger = logging.getLogger(__name__)

DEFAULT_PERIOD_S = 20.0
"""How often progress is looked at where systemd does not ask for a watchdog."""


def notify(message: str, environment: Mapping[str, str] | None = None) -> bool:
    """Send one state to systemd; False where no socket listens.

    Parameters
    ----------
    message
        As ``READY=1``; several lines are several states.
    """
    address = (os.environ if environment is None else environment).get("NOTIFY_SOCKET", "")
    if not address or address[0] not in "/@":
        return False
    if address[0] == "@":
        address = "\0" + address[1:]
    # systemd is not there, or restarts: the daemon serves without being watched
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
        sock.connect(address)
        sock.sendall(message.encode())
        return True
    return False


def watchdog_period_s(environment: Mapping[str, str] | None = None) -> float | None:
    """Half of systemd's ``WATCHDOG_USEC``, seconds; None when it asks for no watchdog of this process."""
    env = os.environ if environment is None else environment
    if env.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        microseconds = int(env.get("WATCHDOG_USEC", "0"))
    except ValueError:  # another program has set the variable: no watchdog waits
        return None
    return microseconds / 2e6 if microseconds > 0 else None


def log_stalled(names: list[str]) -> None:
    """Say why the watchdog is not fed."""
    log.error("no progress in %s: the watchdog is not fed", ", ".join(names))


async def feed(
    clock: Clock,
    checks: Mapping[str, Callable[[], Awaitable[bool]]],
    stalled: Callable[[list[str]], None],
    send: Callable[[str], bool] = notify,
    period_s: float | None = None,
) -> None:
    """Feed the watchdog at half its period for as long as every check passes.

    Parameters
    ----------
    checks
        Each says whether its part has advanced since it was last asked; one that does not return starves the watchdog
        just as well.
    stalled
        Called with the names of those that have not. systemd then does the rest.
    """
    period_s = period_s if period_s is not None else watchdog_period_s() or DEFAULT_PERIOD_S
    while True:
        behind = [name for name, check in list(checks.items()) if not await check()]
        if behind:
            stalled(behind)
        else:
            send("WATCHDOG=1")
        await clock.sleep(period_s)
