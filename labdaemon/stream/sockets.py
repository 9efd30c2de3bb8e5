"""Sockets of the daemon: bound on loopback, with limits on what a peer can make them hold."""

from __future__ import annotations

import errno

import zmq
import zmq.asyncio

from labdaemon.errors import ConfigError
from labdaemon.stream.peer_gate import BACKLOG, PeerGate, inner_address
from labdaemon.stream.zmtp import PeerLimits

MAX_FRAME_BYTES = 1 << 20
"""A frame beyond this ends the connection; the longest campaign is far smaller."""
MAX_TOPIC_BYTES = 128  # no event's kind is half as long
MAX_TOPICS = 100
"""Of one subscriber; an event's kind is a word or two, and there are a dozen."""
COMMANDS_LIMITS = PeerLimits(MAX_FRAME_BYTES, 2 * MAX_FRAME_BYTES)
EVENTS_LIMITS = PeerLimits(MAX_TOPIC_BYTES, 16 * MAX_TOPIC_BYTES, MAX_TOPICS, bytes_per_s=2048.0, burst_bytes=32 << 10)
"""Subscribers send topics, at the beginning, and perhaps a sign of life now and then."""
EVENTS_HIGH_WATER = 1000
"""Events kept for a subscriber that does not read; it then loses some, notices by `seq` and asks for them again."""
ANSWERS_HIGH_WATER = 128
"""Answers kept for a client that asks and does not read; the next ones are dropped. Far more than a
client's commands in progress, so that who sends as many at once as are taken gets all its answers."""
LINGER_MS = 500
"""How long a closing socket tries to deliver what it still has."""


def bind(
    context: zmq.asyncio.Context, kind: int, address: str, *, key: str, high_water: int
) -> tuple[zmq.asyncio.Socket, PeerGate]:
    """A bound socket, and the gate through which its peers come once that is opened.

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
    is_commands = kind == zmq.ROUTER
    inner = inner_address()
    try:
        gate = PeerGate(address, inner, COMMANDS_LIMITS if is_commands else EVENTS_LIMITS, evicts_idle=is_commands)
    except (OSError, ValueError, OverflowError) as exc:
        if getattr(exc, "errno", None) == errno.EADDRINUSE:
            message = f"{address} is taken, most likely by a daemon that runs already; stop it or choose another port"
        else:
            message = f"{address} cannot be bound: {getattr(exc, 'strerror', None) or exc}"
        raise ConfigError(message, key=key) from None
    socket = context.socket(kind)
    socket.set(zmq.LINGER, LINGER_MS)
    socket.set(zmq.SNDHWM, high_water)
    socket.set(zmq.RCVHWM, high_water)
    socket.set(zmq.MAXMSGSIZE, MAX_FRAME_BYTES)
    socket.set(zmq.BACKLOG, BACKLOG)
    if is_commands:
        # Of two clients with one identity the newcomer is heard: the other one may be dead without a trace.
        socket.set(zmq.ROUTER_HANDOVER, 1)
    try:
        socket.bind(inner)
    except zmq.ZMQError as exc:
        socket.close(linger=0)
        gate.close()
        raise ConfigError(f"{address} cannot be served: {exc.strerror}", key=key) from None
    return socket, gate
