"""uvicorn on a thread and an event loop of its own: however busy it is, the daemon's loop has its turn.

The thread is never waited for at the end of the process. Commands go to the daemon's loop, and come back.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Coroutine, Sequence
from typing import Any

import uvicorn
from starlette.routing import BaseRoute

from labdaemon.stream.command_call import Execute
from labdaemon.stream.event_feed import EventFeed
from labdaemon.stream.messages import BUSY, RpcRequest, error_bytes
from labdaemon.stream.peer_log import PeerLog
from labdaemon.stream.publisher import Outbox
from labdaemon.stream.roles import Role
from labdaemon.stream.tcp_listener import listen_tcp
from labdaemon.web.app import make_app
from labdaemon.web.guard import WebAccess
from labdaemon.web.http_protocol import BoundedHttpProtocol
from labdaemon.web.web_context import WebContext

HEAD_BYTES = 16 << 10
"""Longest that a request's line and headers may be."""
BACKLOG = 64
KEEP_ALIVE_S = 5
END_S = 1.0
DATE_S = 1.0

log: logging.Logger = logging.getLogger(__name__)


class WebServer:
    """The HTTP server.

    Parameters
    ----------
    address
        ``http://HOST:PORT``; port ``*`` takes a free one.
    execute
        Carries commands out, on the daemon's loop.
    outbox
        The journal.
    access
        Who may what; the host of `address` is added to its names.
    pages
        Further routes.

    Attributes
    ----------
    address
        With the port that was taken.
    """

    def __init__(
        self, address: str, execute: Execute, outbox: Outbox, access: WebAccess, pages: Sequence[BaseRoute] = ()
    ) -> None:
        self.address = address
        self._execute, self._outbox, self._access, self._pages = execute, outbox, access, pages
        self._listener: socket.socket | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._feed: EventFeed | None = None
        self._server: uvicorn.Server | None = None
        self._context: WebContext | None = None

    def bind(self) -> None:
        """Take the address.

        Raises
        ------
        ConfigError
            It is taken, or none of this machine's.
        """
        self._listener, self.address = listen_tcp(self.address, "web.address")

    def wake(self) -> None:
        """Something was committed. Cheap; call it on the daemon's loop."""
        if self._loop is not None and self._feed is not None:
            try:
                self._loop.call_soon_threadsafe(self._feed.wake)
            except RuntimeError:
                self._loop = None  # its thread has ended

    async def run(self) -> None:
        """Serve until cancelled.

        Raises
        ------
        RuntimeError
            The server's thread ended by itself.
        """
        if self._listener is None:
            raise RuntimeError("bind comes before run")
        daemon_loop = asyncio.get_running_loop()
        ended: asyncio.Future[None] = daemon_loop.create_future()
        serving = self._serve(self._listener.dup(), daemon_loop)

        def work() -> None:
            error: BaseException | None = None
            try:
                asyncio.run(serving)
            except BaseException as exc:
                error = exc
            try:
                daemon_loop.call_soon_threadsafe(_settle, ended, error)
            except RuntimeError:
                return  # the daemon has ended meanwhile

        threading.Thread(target=work, name="web", daemon=True).start()
        try:
            await ended
        finally:
            self._end()
            if not ended.done():
                await asyncio.wait([ended], timeout=END_S)

    def close(self) -> None:
        """Give the address back."""
        if self._listener is not None:
            self._listener.close()

    def _end(self) -> None:
        loop, server, context = self._loop, self._server, self._context
        if loop is None or server is None or context is None:
            return

        def end() -> None:
            context.closing.set()
            server.should_exit = True

        try:
            loop.call_soon_threadsafe(end)
        except RuntimeError:
            return  # it has ended

    async def _serve(self, listener: socket.socket, daemon_loop: asyncio.AbstractEventLoop) -> None:
        async def execute(request: RpcRequest, role: Role) -> bytes:
            answer: Coroutine[Any, Any, bytes] = _as_coroutine(self._execute, request, role)
            try:
                return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(answer, daemon_loop))
            except RuntimeError:
                answer.close()
                if daemon_loop.is_closed():  # whoever asks in the daemon's last moment gets an answer, not a traceback
                    return error_bytes(BUSY, "the daemon is ending", request.id)
                raise

        loop = asyncio.get_running_loop()
        peers = PeerLog(log, "web")
        BoundedHttpProtocol.peers = peers
        loop.set_exception_handler(lambda _, about: peers.warn("the server", str(about.get("message"))))
        self._feed = EventFeed(self._outbox)
        self._context = WebContext(execute, self._feed, self._access, peers)
        config = uvicorn.Config(
            make_app(self._context, self._pages),
            http=BoundedHttpProtocol,
            ws="none",
            lifespan="off",
            loop="asyncio",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            date_header=True,
            backlog=BACKLOG,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=HEAD_BYTES,
        )
        logging.getLogger("uvicorn").setLevel(logging.CRITICAL)  # its lines are made by its clients
        self._server = _Server(config, self._context.closing)
        self._loop = loop
        try:
            await self._server.serve(sockets=[listener])
        finally:
            self._loop = None
            listener.close()


class _Server(uvicorn.Server):
    """Ends as soon as it is asked to, not at its next look."""

    def __init__(self, config: uvicorn.Config, closing: asyncio.Event) -> None:
        super().__init__(config)
        self._closing = closing

    async def main_loop(self) -> None:
        """Keep the date header right until the end."""
        while not self.should_exit:
            await self.on_tick(0)
            try:
                async with asyncio.timeout(DATE_S):
                    await self._closing.wait()
            except TimeoutError:  # it serves on; the date in its headers is renewed
                continue


async def _as_coroutine(execute: Execute, request: RpcRequest, role: Role) -> bytes:
    return await execute(request, role)


def _settle(ended: asyncio.Future[None], error: BaseException | None) -> None:
    if ended.done():
        return
    if error is not None and not isinstance(error, Exception):
        error = RuntimeError(f"{type(error).__name__} in the web server")  # SystemExit would end the daemon's loop
    ended.set_exception(error or RuntimeError("the web server ended by itself"))
