"""The door of the sockets: scanners, silent and leaking clients, floods, twins, and a system without descriptors."""

from __future__ import annotations

import asyncio
import json
import os
import resource
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, suppress
from typing import Any

import pytest
import zmq
import zmq.asyncio

from labdaemon.clock import SystemClock
from labdaemon.errors import ConfigError
from labdaemon.stream import peer_connection, peer_gate
from labdaemon.stream.commands import CommandServer
from labdaemon.stream.publisher import EventPublisher
from labdaemon.stream.sockets import MAX_TOPIC_BYTES, MAX_TOPICS

GREETING = (b"\xff" + b"\0" * 8 + b"\x7f\x03\x00NULL").ljust(64, b"\0")


class NoOutbox:
    uuid, last_seq = "journal-1", 0

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[Any]:
        return []

    history = recent


class Lab:
    """A command server and a publisher that let few peers in."""

    def __init__(self, commands: str = "tcp://127.0.0.1:*", events: str = "tcp://127.0.0.1:*") -> None:
        self.release = asyncio.Event()
        self.server = CommandServer(commands, {"echo": self.echo, "slow": self.slow})
        self.publisher = EventPublisher(events, NoOutbox(), lambda: {"campaign": None}, SystemClock())

    async def echo(self, params: dict[str, Any]) -> dict[str, Any]:
        return params

    async def slow(self, params: dict[str, Any]) -> str:
        await self.release.wait()
        return "slow"


@pytest.fixture
async def labs(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Callable[..., Lab]]:
    """Starts one on the given addresses."""
    monkeypatch.setattr(peer_gate, "MOST_PEERS", 8)
    monkeypatch.setattr(peer_gate, "CROWD_PAUSE_S", 0.01)
    monkeypatch.setattr(peer_gate, "HELLO_S", 0.1)
    started: list[tuple[Lab, list[asyncio.Task[None]]]] = []

    def start(*addresses: str) -> Lab:
        lab = Lab(*addresses)
        lab.server.bind()
        lab.publisher.bind()
        started.append((lab, [asyncio.create_task(lab.server.run()), asyncio.create_task(lab.publisher.run())]))
        return lab

    yield start
    for lab, tasks in started:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        lab.server.close()
        lab.publisher.close()


def peers_of(one: CommandServer | EventPublisher) -> int:
    assert one._gate is not None
    return len(one._gate._connections)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(120.0):
        while not condition():
            await asyncio.sleep(0.01)


async def ask(address: str, *, timeout_s: float = 20.0, identity: bytes = b"", **params: Any) -> Any:
    """One `echo` by a client of its own."""
    with zmq.asyncio.Context() as context, context.socket(zmq.DEALER) as dealer:
        dealer.set(zmq.LINGER, 0)
        dealer.set(zmq.IPV6, "[" in address)
        if identity:
            dealer.set(zmq.IDENTITY, identity)
        dealer.connect(address)
        await dealer.send_json({"jsonrpc": "2.0", "id": 1, "method": "echo", "params": params})
        async with asyncio.timeout(timeout_s):
            return json.loads(await dealer.recv())["result"]


def connected(address: str, data: bytes = b"") -> socket.socket:
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    sock = socket.create_connection((host.strip("[]"), int(port)), timeout=20)
    sock.sendall(data)
    return sock


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01", os.urandom(4000).replace(b"\xff", b"")])
async def test_what_is_no_peer_is_hung_up_on(labs: Callable[..., Lab], data: bytes) -> None:
    lab = labs()
    for address in (lab.server.address, lab.publisher.address):
        with connected(address, data) as scanner:
            scanner.setblocking(False)
            async with asyncio.timeout(120.0):
                with suppress(ConnectionResetError):  # it had not read everything when it hung up
                    assert await asyncio.get_running_loop().sock_recv(scanner, 100) == b""
    assert await ask(lab.server.address, x=1) == {"x": 1}


async def test_silent_connections_give_their_places_to_those_who_speak(labs: Callable[..., Lab]) -> None:
    lab = labs()
    with ExitStack() as stack:
        for number in range(60):
            sent = (b"", GREETING[:10], GREETING)[number % 3]
            stack.enter_context(connected(lab.server.address, sent))
        assert await ask(lab.server.address, x=1) == {"x": 1}
        assert peers_of(lab.server) <= 8
    await until(lambda: peers_of(lab.server) == 0)


async def test_what_never_says_hello_has_to_leave(labs: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_gate, "HANDSHAKE_S", 0.0)
    lab = labs()
    with connected(lab.server.address, GREETING[:10]):
        await until(lambda: peers_of(lab.server) == 1)
        await until(lambda: peers_of(lab.server) == 0)


async def test_clients_that_leak_keep_nobody_out(labs: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_gate, "IDLE_S", 0.0)
    lab = labs()
    with zmq.asyncio.Context() as context:
        for number in range(20):  # each says hello, asks once and is never closed
            dealer = context.socket(zmq.DEALER)
            dealer.set(zmq.LINGER, 0)
            dealer.set(zmq.RECONNECT_IVL, -1)
            dealer.connect(lab.server.address)
            await dealer.send_json({"jsonrpc": "2.0", "id": number, "method": "echo"})
            async with asyncio.timeout(120.0):
                assert "result" in json.loads(await dealer.recv())
        assert peers_of(lab.server) <= 8
        assert await ask(lab.server.address, x=1) == {"x": 1}
        context.destroy(linger=0)


async def test_a_full_house_of_subscribers_keeps_its_places(labs: Callable[..., Lab]) -> None:
    lab = labs()
    with zmq.asyncio.Context() as context:
        subscribers = [context.socket(zmq.SUB) for _ in range(12)]
        for subscriber in subscribers[:8]:
            subscriber.connect(lab.publisher.address)
            subscriber.subscribe("status")
            assert (await subscriber.recv_multipart())[0] == b"status"
        for subscriber in subscribers[8:]:
            subscriber.connect(lab.publisher.address)
            subscriber.subscribe("status")
        for subscriber in subscribers[:8]:
            assert (await subscriber.recv_multipart())[0] == b"status"
        assert peers_of(lab.publisher) == 8
        subscribers[0].close(linger=0)
        pollers = [asyncio.ensure_future(subscriber.recv_multipart()) for subscriber in subscribers[8:]]
        async with asyncio.timeout(120.0):
            await asyncio.wait(pollers, return_when=asyncio.FIRST_COMPLETED)
        for poller in pollers:
            poller.cancel()
        await asyncio.gather(*pollers, return_exceptions=True)
        context.destroy(linger=0)


@pytest.mark.parametrize(
    "topics",
    [
        [b"\1" + bytes([n % 256, n // 256]) + b"x" * 1000 for n in range(500)],
        [b"\1%d" % n for n in range(MAX_TOPICS + 200)],
        [b"\1" + b"y" * MAX_TOPIC_BYTES] * 3,
    ],
)
async def test_a_flood_of_topics_ends_its_own_connection(labs: Callable[..., Lab], topics: list[bytes]) -> None:
    lab = labs()
    with zmq.asyncio.Context() as context:
        good, hostile = context.socket(zmq.SUB), context.socket(zmq.XSUB)
        good.subscribe("status")
        good.connect(lab.publisher.address)
        await good.recv_multipart()
        hostile.set(zmq.SNDHWM, 0)
        hostile.connect(lab.publisher.address)
        for topic in topics:
            await hostile.send(topic)
        assert lab.publisher._gate is not None
        await until(lambda: lab.publisher._gate is not None and lab.publisher._gate.refusals > 0)
        for _ in range(2):
            assert (await good.recv_multipart())[0] == b"status"
        context.destroy(linger=0)


async def test_a_message_without_end_ends_its_own_connection(labs: Callable[..., Lab]) -> None:
    lab = labs()
    with zmq.Context() as context, context.socket(zmq.DEALER) as hostile:
        hostile.set(zmq.LINGER, 0)
        hostile.connect(lab.server.address)
        for _ in range(50):
            hostile.send(b"x" * 100_000, zmq.SNDMORE)
        hostile.send(b"")
        await until(lambda: lab.server._gate is not None and lab.server._gate.refusals > 0)
        assert await ask(lab.server.address, x=1) == {"x": 1}


async def test_a_system_without_descriptors_is_waited_out(
    labs: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peer_gate, "EXHAUSTED_PAUSE_S", 0.05)
    lab = labs()
    with socket.socket() as waiting:
        waiting.setblocking(False)
        before = resource.getrlimit(resource.RLIMIT_NOFILE)
        host, _, port = lab.server.address.removeprefix("tcp://").rpartition(":")
        lowest_free = os.dup(0)
        os.close(lowest_free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, before[1]))
        try:
            await asyncio.get_running_loop().sock_connect(waiting, (host, int(port)))
            await until(lambda: lab.server._gate is not None and lab.server._gate.refusals > 0)
            assert peers_of(lab.server) == 0
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
        await until(lambda: peers_of(lab.server) == 1)
    assert await ask(lab.server.address, x=1) == {"x": 1}


async def test_two_clients_of_one_identity_are_both_heard_and_get_their_own_answers(labs: Callable[..., Lab]) -> None:
    lab = labs()
    with zmq.asyncio.Context() as context:
        first, second = (context.socket(zmq.DEALER) for _ in range(2))
        for one in (first, second):
            one.set(zmq.IDENTITY, b"me")
            one.set(zmq.RECONNECT_IVL, -1)
            one.connect(lab.server.address)
            await one.send_json({"jsonrpc": "2.0", "id": 1, "method": "slow" if one is first else "echo"})
            await until(lambda: one is second or bool(lab.server._tasks))  # noqa: B023
        async with asyncio.timeout(120.0):
            assert json.loads(await second.recv())["result"] == {}
            lab.release.set()
            assert json.loads(await first.recv())["result"] == "slow"
            await second.send_json({"jsonrpc": "2.0", "id": 2, "method": "echo"})
            assert json.loads(await second.recv())["id"] == 2  # and not the other one's answer
        context.destroy(linger=0)


async def test_ipv6(labs: Callable[..., Lab]) -> None:
    try:
        with socket.socket(socket.AF_INET6) as sock:
            sock.bind(("::1", 0))
    except OSError:
        pytest.skip("this machine has no IPv6 loopback")
    lab = labs("tcp://[::1]:*", "tcp://[::1]:*")
    assert lab.server.address.startswith("tcp://[::1]:")
    assert await ask(lab.server.address, x=1) == {"x": 1}
    with zmq.asyncio.Context() as context, context.socket(zmq.SUB) as subscriber:
        subscriber.set(zmq.IPV6, 1)
        subscriber.subscribe("status")
        subscriber.connect(lab.publisher.address)
        assert (await subscriber.recv_multipart())[0] == b"status"
    second = CommandServer(lab.server.address, {})
    with pytest.raises(ConfigError, match="is taken"):
        second.bind()
    second.close()


async def test_large_answers_pass_a_narrow_door_whole(
    labs: Callable[..., Lab], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peer_connection, "BLOCK_BYTES", 1000)
    lab = labs()
    text = os.urandom(300_000).hex()
    answers = await asyncio.gather(*(ask(lab.server.address, text=text, n=n) for n in range(4)))
    assert [answer["n"] for answer in answers] == [0, 1, 2, 3]
    assert {answer["text"] for answer in answers} == {text}
