"""The check of keys at a socket's door: which connection proves to have which key, and whether that one is listed.

libzmq asks about a key (ZAP, https://rfc.zeromq.org/spec/27) by the domain of the address that the connection came to,
and says nothing else of it. So each connection gets an address of its own inside this machine, with its number as the
domain: a verdict can belong to no other connection, in whatever order peers come and go.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import zmq
import zmq.asyncio
from zmq.utils import z85

from labdaemon.stream.access import KeyAccess

ZAP_ADDRESS = "inproc://zeromq.zap.01"
ZAP_VERSION = b"1.0"
USER, CONNECTION = "User-Id", "X-Connection"
"""Properties that libzmq is given with the verdict, and puts on each message of the connection."""

log: logging.Logger = logging.getLogger(__name__)


class KeyedConnection(Protocol):
    """A connection whose peer must have a key."""

    number: int
    public: str | None

    def close(self, why: str = "") -> None:
        """End it."""

    def note_received(self) -> None:
        """A whole message of it came."""

    def count_topic(self, change: int) -> None:
        """It subscribed (1) or no longer does (-1)."""


def sender_of(frame: zmq.Frame) -> tuple[str | None, int]:
    """Key and connection number that a message came with; None and 0 where it has none (a subscription that ended)."""
    try:
        return str(frame.get(USER)), int(frame.get(CONNECTION))
    except (zmq.ZMQError, ValueError):
        return None, 0


class CurveDoor:
    """Checks the keys of one socket's peers.

    Parameters
    ----------
    context
        The socket's.
    socket
        Not bound: it is bound here, once for each connection.
    access
        Who is listed.
    inner
        What the addresses inside this machine begin with.
    """

    def __init__(self, context: zmq.asyncio.Context, socket: zmq.asyncio.Socket, access: KeyAccess, inner: str) -> None:
        self._access, self._inner, self._served = access, inner, socket
        self._connections: dict[int, KeyedConnection] = {}
        self._task: asyncio.Task[None] | None = None
        self._socket = context.socket(zmq.REP)
        self._socket.set(zmq.LINGER, 0)
        self._socket.bind(ZAP_ADDRESS)
        socket.set(zmq.CURVE_SERVER, 1)
        socket.set(zmq.CURVE_PUBLICKEY, access.pair.public.encode())
        socket.set(zmq.CURVE_SECRETKEY, access.pair.secret.encode())

    def open(self, on_change: Callable[[], None]) -> None:
        """Answer libzmq from now on, and call `on_change` when the list of clients has changed."""
        self._task = asyncio.create_task(self._run())
        self._access.listen(on_change)

    def close(self) -> None:
        """Answer no more."""
        if self._task is not None:
            self._task.cancel()
        self._socket.close()

    def is_listed(self, public: str) -> bool:
        """Whether a key gets in."""
        return self._access.role_of(public) is not None

    def connection(self, number: int) -> KeyedConnection | None:
        """The connection with this number, while it lasts."""
        return self._connections.get(number)

    def endpoint(self, connection: KeyedConnection) -> str:
        """Where this connection, and no other, reaches libzmq.

        Raises
        ------
        OSError
            The system has no descriptor left.
        """
        address = self._address(connection)
        try:
            self._served.set(zmq.ZAP_DOMAIN, b"%d" % connection.number)
            self._served.bind(address)
        except zmq.ZMQError as exc:
            raise OSError(exc.errno, exc.strerror) from None
        self._connections[connection.number] = connection
        return address

    def leave(self, connection: KeyedConnection) -> None:
        """It has ended; libzmq forgets it as well."""
        if self._connections.pop(connection.number, None) is not None and not self._served.closed:
            with suppress(zmq.ZMQError):
                self._served.unbind(self._address(connection))

    def _address(self, connection: KeyedConnection) -> str:
        return f"{self._inner}-{connection.number}"

    async def _run(self) -> None:
        while True:
            frames = await self._socket.recv_multipart()
            try:
                answer = self._verdict(frames)
            except Exception:  # a door that fails stays shut, and libzmq must not stay without an answer
                log.exception("a key could not be checked")
                answer = _reply(frames, b"500")
            await self._socket.send_multipart(answer)

    def _verdict(self, frames: list[bytes]) -> list[bytes]:
        """The answer to libzmq about one key."""
        if len(frames) != 7 or frames[5] != b"CURVE" or not frames[2].isdigit():
            return _reply(frames, b"400")
        connection = self._connections.get(int(frames[2]))
        if connection is None or connection.public is not None:
            return _reply(frames, b"400")
        public = z85.encode(frames[6]).decode()
        if not self.is_listed(public):
            asyncio.get_running_loop().call_soon(connection.close, f"the key {public} is not listed")
            return _reply(frames, b"400")
        connection.public = public
        return _reply(frames, b"200", public.encode(), _property(CONNECTION.encode(), b"%d" % connection.number))


def _reply(frames: list[bytes], status: bytes, user: bytes = b"", properties: bytes = b"") -> list[bytes]:
    return [ZAP_VERSION, *frames[1:2], status, b"", user, properties]


def _property(name: bytes, value: bytes) -> bytes:
    return bytes([len(name)]) + name + len(value).to_bytes(4, "big") + value
