"""A client's sockets: how they reconnect, how much they keep, and how they prove who they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import zmq

from labdaemon.stream.key_files import KeyPair, read_pair

HIGH_WATER = 10_000
"""Messages kept for a program that does not read for a while; those beyond are replayed by `seq`."""
RECONNECT_MS = 100
RECONNECT_MOST_MS = 400
"""How soon a lost connection is tried again: events come within a second of the daemon's return, and a thousand
clients that wait for it cost it little."""
CONNECT_MS = 2000
"""A machine that does not answer at all (switched off) is tried again after this time."""
SIGN_MS = 2000
GONE_MS = 6000
"""Of encrypted connections, which may cross networks: how often the other side is asked for a sign of life, and after
what silence the connection is given up, since a router may forget it without a word."""

AnySocket = TypeVar("AnySocket", bound="zmq.Socket[Any]")


@dataclass(frozen=True, slots=True)
class DaemonAddress:
    """How a client reaches a daemon.

    Attributes
    ----------
    commands, events
        ``tcp://HOST:PORT`` or ``ipc://PATH``.
    pair
        The client's key and the daemon's public key; None where the daemon asks for none.
    """

    commands: str
    events: str
    pair: KeyPair | None = None


def client_pair(key: KeyPair | Path | str | None) -> KeyPair | None:
    """A client's key, from its file.

    Raises
    ------
    ConfigError
        The file is missing, damaged, or others can read it.
    """
    return key if key is None or isinstance(key, KeyPair) else read_pair(Path(key), is_client=True)


def connect(socket: AnySocket, address: str, pair: KeyPair | None) -> AnySocket:
    """Connect a socket of a client; the connection is made, and made again, behind it."""
    socket.set(zmq.LINGER, 0)
    socket.set(zmq.IPV6, "[" in address)
    socket.set(zmq.RECONNECT_IVL, RECONNECT_MS)
    socket.set(zmq.RECONNECT_IVL_MAX, RECONNECT_MOST_MS)
    socket.set(zmq.CONNECT_TIMEOUT, CONNECT_MS)
    if pair is not None:
        secure(socket, pair)
        socket.set(zmq.HEARTBEAT_IVL, SIGN_MS)
        socket.set(zmq.HEARTBEAT_TIMEOUT, GONE_MS)
    socket.connect(address)
    return socket


def secure(socket: AnySocket, pair: KeyPair) -> None:
    """Have what a socket sends and receives encrypted, with a client's key.

    Raises
    ------
    ValueError
        The pair does not say which daemon it is for.
    """
    if pair.daemon is None:
        raise ValueError("this is no client's key pair: it does not say what daemon to trust")
    socket.set(zmq.CURVE_PUBLICKEY, pair.public.encode())
    socket.set(zmq.CURVE_SECRETKEY, pair.secret.encode())
    socket.set(zmq.CURVE_SERVERKEY, pair.daemon.encode())


def subscribe(socket: AnySocket, address: str, pair: KeyPair | None) -> AnySocket:
    """The same for a subscription to everything."""
    socket.set(zmq.RCVHWM, HIGH_WATER)
    socket.set(zmq.SUBSCRIBE, b"")
    return connect(socket, address, pair)


def events_at(address: str, commands: str) -> str:
    """The events address that a daemon names, as this client reaches it.

    A daemon that listens on every network names no host; it is the one where its commands were answered.
    """
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    if host not in {"*", "0.0.0.0", "[::]"} or not commands.startswith("tcp://"):
        return address
    return f"{commands.rpartition(':')[0]}:{port}"
