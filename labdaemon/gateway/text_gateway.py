"""The text gateway's socket: lets so many clients in, and no more."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket

from labdaemon.gateway.client_state import ClientState, GatewayContext
from labdaemon.gateway.text_connection import ConnectionRefusal, TextConnection
from labdaemon.stream.listener import watch_peer
from labdaemon.stream.pace import Pace
from labdaemon.stream.peer_log import PeerLog
from labdaemon.stream.tcp_listener import listen_tcp

MOST_CLIENTS = 16
IDLE_S = 60.0
"""A client that was silent for so long gives its place to a newcomer when all are taken."""
TOKEN_S = 10.0
"""Where a token is needed, it has to be said within this time."""
LINES_PER_S = 500.0
BURST = 100.0
REFUSED_PAUSE_S = 0.05
"""After a newcomer was turned away none is looked at for a while: a flood of them costs little."""
EXHAUSTED_PAUSE_S = 0.5
NOT_NOW = (BlockingIOError, InterruptedError, ConnectionAbortedError)

log: logging.Logger = logging.getLogger(__name__)


class TextGateway:
    """Serves clients that speak SCPI over TCP.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``; port ``*`` takes a free one.
    context
        What all clients share.

    Attributes
    ----------
    address
        With the port that was taken.
    """

    def __init__(self, address: str, context: GatewayContext) -> None:
        self.address = address
        self._context = context
        self._listener: socket.socket | None = None
        self._connections: dict[asyncio.Task[None], TextConnection | None] = {}
        self._pace = Pace(LINES_PER_S, BURST)
        self._peers = PeerLog(log, "text gateway")

    def bind(self) -> None:
        """Take the address.

        Raises
        ------
        ConfigError
            It is taken, or none of this machine's.
        """
        self._listener, self.address = listen_tcp(self.address, "gateway.address")

    async def run(self) -> None:
        """Serve until cancelled."""
        if self._listener is None:
            raise RuntimeError("bind comes before run")
        loop = asyncio.get_running_loop()
        try:
            while True:
                try:
                    peer, address = await loop.sock_accept(self._listener)
                except NOT_NOW:  # the peer has gone between its knock and our answer
                    continue
                except OSError as exc:
                    self._peers.warn("a newcomer", f"could not be accepted ({exc.strerror}); tried again")
                    scarce = exc.errno in {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
                    await asyncio.sleep(EXHAUSTED_PAUSE_S if scarce else 0.0)
                    continue
                if not self._make_room():
                    peer.close()
                    self._peers.warn(address[0], f"refused: all {MOST_CLIENTS} places are taken")
                    await asyncio.sleep(REFUSED_PAUSE_S)
                    continue
                task = asyncio.create_task(self._serve(peer, address[0]))
                self._connections[task] = None
                task.add_done_callback(self._forget)
        finally:
            for task in list(self._connections):
                task.cancel()
            await asyncio.gather(*self._connections, return_exceptions=True)

    def close(self) -> None:
        """Give the address back."""
        if self._listener is not None:
            self._listener.close()

    def _forget(self, task: asyncio.Task[None]) -> None:
        self._connections.pop(task, None)
        if not task.cancelled() and task.exception() is not None:
            log.error("a connection of the text gateway failed", exc_info=task.exception())

    def _make_room(self) -> bool:
        """Whether there is a place; the longest idle client loses its own where all are taken."""
        if len(self._connections) < MOST_CLIENTS:
            return True
        now_s = asyncio.get_running_loop().time()
        idle = {task: one for task, one in self._connections.items() if one is not None and one.is_idle}
        task = min(idle, key=lambda task: idle[task].active_s, default=None)
        if task is None or now_s - idle[task].active_s < IDLE_S:
            return False
        idle[task].abort()
        task.cancel()
        del self._connections[task]
        return True

    async def _serve(self, peer: socket.socket, host: str) -> None:
        loop = asyncio.get_running_loop()
        reader = asyncio.StreamReader(limit=8192, loop=loop)
        protocol = asyncio.StreamReaderProtocol(reader, loop=loop)
        try:
            watch_peer(peer, is_written_to=True)
            transport, _ = await loop.connect_accepted_socket(lambda: protocol, peer)
        except OSError as exc:
            peer.close()
            self._peers.warn(host, str(exc.strerror))
            return
        writer = asyncio.StreamWriter(transport, protocol, reader, loop)
        connection = TextConnection(ClientState(self._context), reader, writer, self._pace)
        task = asyncio.current_task()
        if task is not None and task in self._connections:
            self._connections[task] = connection
        timer = loop.call_later(TOKEN_S, self._check_token, connection, host)
        try:
            await connection.run()
        except ConnectionRefusal as exc:
            if str(exc):
                self._peers.warn(host, f"connection ended: {exc}")
        finally:
            timer.cancel()

    def _check_token(self, connection: TextConnection, host: str) -> None:
        if connection.client.role is None:
            self._peers.warn(host, f"connection ended: no token within {TOKEN_S:g} s")
            connection.abort()
