"""Sockets of the daemon, with limits on what a peer can make them hold."""

from __future__ import annotations

import errno
from dataclasses import dataclass

import zmq
import zmq.asyncio

from labdaemon.errors import ConfigError
from labdaemon.stream.access import KeyAccess
from labdaemon.stream.curve_door import CurveDoor
from labdaemon.stream.listener import SocketFile
from labdaemon.stream.peer_gate import BACKLOG, PeerGate, inner_address, remove_inner
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
REQUESTS_HIGH_WATER = 4
"""Messages of one client that wait to be read; its further ones wait in its own system."""
LINGER_MS = 500
"""How long a closing socket tries to deliver what it still has."""


@dataclass(frozen=True, slots=True)
class DoorPolicy:
    """Who gets in at a socket.

    Attributes
    ----------
    access
        Clients with listed keys only; None for everybody who reaches the address.
    place
        Permissions of a Unix socket's file.
    """

    access: KeyAccess | None = None
    place: SocketFile | None = None


ANYBODY = DoorPolicy()
"""Whoever reaches the address, which is loopback's."""


def bind(
    context: zmq.asyncio.Context,
    kind: int,
    address: str,
    *,
    key: str,
    high_water: int,
    policy: DoorPolicy = ANYBODY,
) -> tuple[zmq.asyncio.Socket, PeerGate]:
    """A bound socket, and the gate through which its peers come once that is opened.

    Parameters
    ----------
    kind
        ``zmq.XPUB`` or ``zmq.ROUTER``.
    address
        ``tcp://HOST:PORT`` or ``ipc://PATH``.
    key
        Of the rig file, for the message.
    high_water
        Messages kept for each peer that does not read.
    policy
        Who gets in.

    Raises
    ------
    ConfigError
        The address is taken (by another daemon, most likely) or is none of this machine's.
    """
    is_commands = kind == zmq.ROUTER
    try:
        inner = inner_address(is_private=policy.place is not None)
    except OSError as exc:
        raise ConfigError(f"{address} cannot be served: {exc.strerror or exc}", key=key) from None
    socket = context.socket(kind)
    socket.set(zmq.LINGER, LINGER_MS)
    socket.set(zmq.SNDHWM, high_water)
    socket.set(zmq.RCVHWM, REQUESTS_HIGH_WATER if is_commands else high_water)
    socket.set(zmq.MAXMSGSIZE, MAX_FRAME_BYTES)
    socket.set(zmq.BACKLOG, BACKLOG)
    if is_commands:
        # Of two clients with one identity the newcomer is heard: the other one may be dead without a trace. Where roles
        # differ, one client must not get another's answers by taking its identity, so there the first one stays.
        socket.set(zmq.ROUTER_HANDOVER, int(policy.access is None))
    else:
        # Each subscription is seen, and each end of one: they are counted.
        socket.set(zmq.XPUB_VERBOSER, 1)
    door = CurveDoor(context, socket, policy.access, inner) if policy.access is not None else None
    limits = COMMANDS_LIMITS if is_commands else EVENTS_LIMITS
    try:
        gate = PeerGate(address, inner, limits, evicts_idle=is_commands, door=door, place=policy.place)
    except (OSError, ValueError, OverflowError) as exc:
        _give_up(socket, door, inner)
        if getattr(exc, "errno", None) == errno.EADDRINUSE:
            message = f"{address} is taken, most likely by a daemon that runs already; stop it or choose another port"
        else:
            message = f"{address} cannot be bound: {getattr(exc, 'strerror', None) or exc}"
        raise ConfigError(message, key=key) from None
    except BaseException:
        _give_up(socket, door, inner)
        raise
    if door is None:
        try:
            socket.bind(inner)
        except zmq.ZMQError as exc:
            socket.close(linger=0)
            gate.close()
            raise ConfigError(f"{address} cannot be served: {exc.strerror}", key=key) from None
    return socket, gate


def _give_up(socket: zmq.asyncio.Socket, door: CurveDoor | None, inner: str) -> None:
    socket.close(linger=0)
    remove_inner(inner)
    if door is not None:
        door.close()
