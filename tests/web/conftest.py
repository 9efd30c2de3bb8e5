"""A web server on a free port, whose daemon is in memory."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

pytest.importorskip("uvicorn", reason="uvicorn is not installed (extra web)")
pytest.importorskip("starlette", reason="starlette is not installed (extra web)")

from labdaemon.stream.access_token import AccessToken
from labdaemon.testing.served import FakeDaemon
from labdaemon.web.guard import WebAccess
from labdaemon.web.web_server import WebServer

TOKENS = {"operator": "0123456789abcdef-operator", "observer": "0123456789abcdef-observer"}
HOSTS = frozenset({"127.0.0.1", "localhost", "::1"})


@pytest.fixture
async def daemon() -> FakeDaemon:
    return FakeDaemon()


@pytest.fixture
def tokens(tmp_path: Path) -> dict[str, AccessToken]:
    found = {}
    for name, word in TOKENS.items():
        path = tmp_path / name
        path.write_text(word)
        path.chmod(0o600)
        found[name] = AccessToken(path, "web.token_file")
    return found


@pytest.fixture
async def serve(daemon: FakeDaemon, tokens: dict[str, AccessToken]) -> AsyncIterator[Callable[..., WebServer]]:
    """Starts a server; the daemon is this test's loop, the server's loop is another thread's."""
    started: list[tuple[WebServer, asyncio.Task[None]]] = []

    def start(*, is_open: bool = True, has_token: bool = True) -> WebServer:
        operator, observer = (tokens["operator"], tokens["observer"]) if has_token else (None, None)
        server = WebServer(
            "http://127.0.0.1:*", daemon.execute, daemon.outbox, WebAccess(HOSTS, operator, observer, is_open)
        )
        server.bind()
        started.append((server, asyncio.create_task(server.run())))
        return server

    yield start
    for server, task in started:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        server.close()


class Answer:
    """A response as it came."""

    def __init__(self, head: bytes, body: bytes) -> None:
        lines = head.decode("latin-1").split("\r\n")
        self.status = int(lines[0].split()[1])
        self.headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines[1:])}
        self.body = body


async def exchange(server: WebServer, request: bytes) -> bytes:
    """Raw bytes there and back, until the server closes."""
    reader, writer = await asyncio.open_connection("127.0.0.1", int(server.address.rpartition(":")[2]))
    try:
        writer.write(request)
        async with asyncio.timeout(120.0):
            return await reader.read()
    finally:
        writer.transport.abort()


@pytest.fixture
def ask() -> Callable[..., object]:
    """One request with a connection of its own."""

    async def send(
        server: WebServer, path: str, method: str = "GET", body: bytes = b"", headers: dict[str, str] | None = None
    ) -> Answer:
        sent = {"Host": server.address.removeprefix("http://"), "Connection": "close"} | (headers or {})
        if body:
            sent.setdefault("Content-Length", str(len(body)))
            sent.setdefault("Content-Type", "application/json")
        lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in sent.items() if value)]
        data = await exchange(server, "\r\n".join(lines).encode() + b"\r\n\r\n" + body)
        head, _, rest = data.partition(b"\r\n\r\n")
        answer = Answer(head, rest)
        if answer.headers.get("transfer-encoding") == "chunked":
            answer.body = _dechunk(rest)
        return answer

    return send


@pytest.fixture
def raw() -> Callable[..., object]:
    """Bytes as they are."""
    return exchange


@pytest.fixture
def bearer() -> dict[str, str]:
    """An operator's header."""
    return {"Authorization": f"Bearer {TOKENS['operator']}"}


@pytest.fixture
def words() -> dict[str, str]:
    """Tokens by role."""
    return TOKENS


def _dechunk(data: bytes) -> bytes:
    found = b""
    while data:
        size, _, data = data.partition(b"\r\n")
        length = int(size, 16)
        if not length:
            break
        found += data[:length]
        data = data[length + 2 :]
    return found
