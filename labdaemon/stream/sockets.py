"""Sockets of the daemon: bound on loopback, with limits on what a peer can make them hold.

What libzmq cannot bound is one message of endless frames, each below the limit: it keeps them until the last. Only
programs of this machine can send that.
"""

from __future__ import annotations

import errno

import zmq
import zmq.asyncio

from labdaemon.errors import ConfigError

MAX_FRAME_BYTES = 1 << 20
"""A frame beyond this makes libzmq drop the connection; the longest campaign is far smaller."""
EVENTS_HIGH_WATER = 1000
"""Events kept for a subscriber that does not read; it then loses some, notices by `seq` and asks for them again."""
ANSWERS_HIGH_WATER = 128
"""Answers kept for a client that asks and does not read; the next ones are dropped. Far more than a
client's commands in hand, so that who sends as many at once as are taken gets all its answers."""
LINGER_MS = 500
"""How long a closing socket tries to deliver what it still has."""


def bind(context: zmq.asyncio.Context, kind: int, address: str, *, key: str, high_water: int) -> zmq.asyncio.Socket:
    """A bound socket.

    Parameters
    ----------
    kind
        ``zmq.XPUB`` or ``zmq.ROUTER``.
    address
        ``tcp://127.0.0.1:PORT``.
    key
        Of the rig file, for the message.
    high_water
        Messages kept for each peer.

    Raises
    ------
    ConfigError
        The address is taken (by another daemon, most likely) or is none of this machine's.
    """
    socket = context.socket(kind)
    socket.set(zmq.LINGER, LINGER_MS)
    socket.set(zmq.SNDHWM, high_water)
    socket.set(zmq.RCVHWM, high_water)
    socket.set(zmq.MAXMSGSIZE, MAX_FRAME_BYTES)
    try:
        socket.bind(address)
    except zmq.ZMQError as exc:
        socket.close(linger=0)
        if exc.errno == errno.EADDRINUSE:
            message = f"{address} is taken, most likely by a daemon that runs already; stop it or choose another port"
        else:
            message = f"{address} cannot be bound: {exc.strerror}"
        raise ConfigError(message, key=key) from None
    return socket
