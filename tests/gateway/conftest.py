"""A text gateway on a free port, whose daemon is a dictionary of handlers."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labdaemon.gateway.client_state import GatewayAccess, GatewayContext
from labdaemon.gateway.text_gateway import TextGateway
from labdaemon.stream.access_token import AccessToken
from labdaemon.stream.event_feed import EventFeed
from labdaemon.stream.roles import Role
from labdaemon.testing.served import FakeDaemon

TOKEN = "0123456789abcdef0123"


@pytest.fixture
def daemon() -> FakeDaemon:
    return FakeDaemon()


@pytest.fixture
def token() -> str:
    """The word of `serve(token=True)`."""
    return TOKEN


class TextClient:
    """A socket that speaks lines."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def send(self, *lines: str | bytes) -> None:
        for line in lines:
            self.writer.write((line if isinstance(line, bytes) else line.encode()) + b"\n")
        await self.writer.drain()

    async def ask(self, line: str) -> str:
        await self.send(line)
        return await self.answer()

    async def answer(self) -> str:
        async with asyncio.timeout(120.0):
            line = await self.reader.readline()
        assert line.endswith(b"\n"), "the connection has ended"
        return line[:-1].decode()

    async def is_closed(self) -> bool:
        async with asyncio.timeout(120.0):
            try:
                while await self.reader.read(65536):
                    pass
            except OSError:
                pass
        return True


@pytest.fixture
async def serve(daemon: FakeDaemon, tmp_path: Path) -> AsyncIterator[Callable[..., TextGateway]]:
    """Starts a gateway; `token=True` for one that wants a token."""
    started: list[tuple[TextGateway, asyncio.Task[None]]] = []

    def start(*, token: bool = False, role: Role | None = Role.OPERATOR) -> TextGateway:
        access = GatewayAccess(None, role)
        if token:
            path = tmp_path / "token"
            path.write_text(TOKEN + "\n")
            path.chmod(0o600)
            access = GatewayAccess(AccessToken(path, "gateway.token_file"), None)
        feed = EventFeed(daemon.outbox)
        gateway = TextGateway("tcp://127.0.0.1:*", GatewayContext(daemon.execute, feed, access, "labdaemon,sim,1,0"))
        gateway.feed = feed
        gateway.bind()
        started.append((gateway, asyncio.create_task(gateway.run())))
        return gateway

    yield start
    for gateway, task in started:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        gateway.close()


@pytest.fixture
async def connect() -> AsyncIterator[Callable[..., Any]]:
    """Connects a client."""
    clients: list[TextClient] = []

    async def join(gateway: TextGateway) -> TextClient:
        port = int(gateway.address.rpartition(":")[2])
        clients.append(TextClient(*await asyncio.open_connection("127.0.0.1", port, limit=1 << 20)))
        return clients[-1]

    yield join
    for client in clients:
        client.writer.transport.abort()
    await asyncio.sleep(0)


@pytest.fixture
def daemon_of_thread() -> Iterator[FakeDaemon]:
    """The daemon behind `serve_in_thread`, for clients that block."""
    loop = asyncio.new_event_loop()

    async def make() -> FakeDaemon:
        return FakeDaemon()

    daemon = loop.run_until_complete(make())
    daemon.loop = loop
    yield daemon
    loop.close()


@pytest.fixture
def serve_in_thread(daemon_of_thread: FakeDaemon) -> Iterator[int]:
    """A gateway on a thread of its own; its port."""
    loop = daemon_of_thread.loop
    context = GatewayContext(
        daemon_of_thread.execute,
        EventFeed(daemon_of_thread.outbox),
        GatewayAccess(None, Role.OPERATOR),
        "labdaemon,sim,1,0",
    )
    gateway = TextGateway("tcp://127.0.0.1:*", context)
    gateway.bind()
    ended = asyncio.Event()

    async def serve() -> None:
        task = asyncio.create_task(gateway.run())
        await ended.wait()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    thread = threading.Thread(target=loop.run_until_complete, args=(serve(),), daemon=True)
    thread.start()
    yield int(gateway.address.rpartition(":")[2])
    loop.call_soon_threadsafe(ended.set)
    thread.join(20.0)
    gateway.close()
