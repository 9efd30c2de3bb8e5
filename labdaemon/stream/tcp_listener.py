"""A listening TCP socket, or a sentence that says why there is none."""

from __future__ import annotations

import errno
import socket

from labdaemon.errors import ConfigError
from labdaemon.stream.listener import TCP, listen

BACKLOG = 128
"""Newcomers that wait in the system's queue."""


def listen_tcp(address: str, key: str) -> tuple[socket.socket, str]:
    """Take an address; the socket, and the address with the port that was taken.

    Parameters
    ----------
    address
        ``SCHEME://HOST:PORT``; port ``*`` takes a free one.
    key
        Of the rig file, for the message.

    Raises
    ------
    ConfigError
        It is taken, or none of this machine's.
    """
    scheme, _, place = address.partition("://")
    try:
        listener, taken = listen(TCP + place, BACKLOG)
    except (OSError, ValueError, OverflowError) as exc:
        if getattr(exc, "errno", None) == errno.EADDRINUSE:
            message = f"{address} is taken, most likely by a daemon that runs already; stop it or choose another port"
        else:
            message = f"{address} cannot be bound: {getattr(exc, 'strerror', None) or exc}"
        raise ConfigError(message, key=key) from None
    return listener, f"{scheme}://{taken.removeprefix(TCP)}"
