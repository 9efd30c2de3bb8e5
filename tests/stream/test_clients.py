"""Both clients against a light daemon: typed commands, ready, restarts, other journals, cut history, silence."""

from __future__ import annotations

import asyncio
import inspect
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest
import zmq

from labdaemon.errors import LabdaemonError
from labdaemon.events import StatusReport, parse_event
from labdaemon.service import openrpc
from labdaemon.stream.async_client import AsyncClient
from labdaemon.stream.client import (
    Client,
    ClientClosed,
    HeartbeatLost,
    HistoryCut,
    JournalChanged,
    NoDaemon,
    RemoteError,
)
from labdaemon.stream.typed_commands import AsyncTypedCommands, CaptureParameters, TypedCommands
from labdaemon.testing.stream_daemon import FakeKeys, MemoryOutbox, StreamDaemon

OF_METHOD = {
    "campaign.submit": "submit", "campaign.pause": "pause", "campaign.resume": "resume", "campaign.abort": "abort",
    "campaign.list": "campaigns", "campaign.show": "campaign", "campaign.move": "move", "rpc.discover": "discover",
}  # fmt: skip
"""Method -> its name in Python, where that is another one."""
OF_EVENTS = {"events.replay", "events.latest"}


@pytest.fixture
def lab(daemon: StreamDaemon) -> Iterator[Client]:
    with Client(daemon.commands, daemon.events, timeout_s=20) as lab:
        yield lab


@pytest.mark.parametrize("commands", [TypedCommands, AsyncTypedCommands])
def test_every_command_is_a_method_with_its_parameters_and_result(commands: type) -> None:
    for name, described in openrpc.METHODS.items():
        if name in OF_EVENTS:
            continue
        method = getattr(commands, OF_METHOD.get(name, name))
        parameters = {one.name: one for one in inspect.signature(method).parameters.values() if one.name != "self"}
        known = set(CaptureParameters.__annotations__) if name == "capture" else set(parameters)
        assert known == set(described.params), name
        required = {one.name for one in parameters.values() if one.default is one.empty and one.kind != one.VAR_KEYWORD}
        assert required == set(described.required), name
        assert method.__annotations__["return"] == f"results.{described.result.__name__}"


def test_typed_commands_answer_objects(daemon: StreamDaemon, lab: Client) -> None:
    daemon.results["status"] |= {"table": "rest", "of a newer daemon": 1}
    status = lab.status()
    assert (status.state, status.table, status.seq) == ("idle", "rest", 0)
    capture = lab.capture(label="a", frequency_hz=5.0)
    assert capture.capture == "0001-a"
    assert capture.opened_at is not None
    assert lab.stop().rest == "shaker"
    assert daemon.asked[1:] == [("capture", {"label": "a", "frequency_hz": 5.0}), ("stop", {})]
    with pytest.raises(RemoteError) as refused:
        lab.abort()
    assert refused.value.name == "method_not_found"


def test_members_of_a_newer_daemon_are_ignored(daemon: StreamDaemon, lab: Client) -> None:
    message = daemon_status(lab)
    message |= {"new": 1}
    message["data"] |= {"newer": {"still": 2}}
    event = parse_event(message)
    assert isinstance(event, StatusReport)
    assert event.data.state == "idle"
    assert parse_event(message | {"kind": "of the future", "v": 7}).kind == "of the future"


def daemon_status(lab: Client) -> dict[str, Any]:
    with lab.listen(timeout_s=20) as stream:
        message = stream.receive(20)
        assert message is not None
        return message


def test_what_is_published_after_listen_is_heard(daemon: StreamDaemon, lab: Client) -> None:
    for number in range(20):
        with lab.listen(timeout_s=20) as stream:
            daemon.publish("fault", {"message": str(number)})
            assert next_event(stream)["data"] == {"message": str(number)}


def next_event(stream: Any) -> dict[str, Any]:
    while True:
        event = stream.receive(20)
        assert event is not None
        if event["kind"] != "status":
            return dict(event)


def test_listen_says_that_no_daemon_is_there() -> None:
    with Client("tcp://127.0.0.1:9", "tcp://127.0.0.1:9") as lab, pytest.raises(NoDaemon, match=r"within 0\.1 s"):
        lab.listen(timeout_s=0.1)


class Follower:
    """`Client.follow` on a thread, as a program runs it."""

    def __init__(self, daemon: StreamDaemon, after: int | None = None) -> None:
        self.seqs: list[tuple[str, int]] = []
        self.heartbeats = 0
        self.troubles: list[LabdaemonError] = []
        self._is_over = False
        self._lab = Client(daemon.commands, daemon.events, timeout_s=2)
        self._thread = threading.Thread(target=self._run, args=(after,), daemon=True)
        self._thread.start()

    def _run(self, after: int | None) -> None:
        for event in self._lab.follow(after=after, report=self.troubles.append):
            if event["kind"] == "status":
                self.heartbeats += 1
            else:
                self.seqs.append((event["journal"][:1], event["seq"]))
            if self._is_over:
                break
        self._lab.close()

    def end(self) -> None:
        self._is_over = True
        self._thread.join(20)

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> None:
        began_s = time.monotonic()
        while not condition():
            assert time.monotonic() < began_s + seconds, (self.seqs, self.troubles)
            time.sleep(0.005)


def test_a_follower_outlives_restarts_another_journal_and_silence(
    daemon: StreamDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labdaemon.stream.client.LOST_S", 1.5)
    follower = Follower(daemon, after=0)
    daemon.publish("fault", {"message": "1"})
    follower.until(lambda: follower.seqs == [("1", 1)])

    daemon.stop()
    daemon.outbox.add("fault", {"message": "2"})  # published while the client is cut off
    follower.until(lambda: len(follower.troubles) >= 1)
    assert isinstance(follower.troubles[0], HeartbeatLost)
    heard = follower.heartbeats
    daemon.start()
    follower.until(lambda: follower.heartbeats > heard)
    follower.until(lambda: len(follower.seqs) == 2)

    daemon.stop()
    daemon.outbox = MemoryOutbox("22222222-2222-2222-2222-222222222222")
    daemon.outbox.add("fault", {"message": "of another history"})
    daemon.start()
    follower.until(lambda: len(follower.seqs) == 3)
    follower.end()
    assert follower.seqs == [("1", 1), ("1", 2), ("2", 1)]
    assert [type(one) for one in follower.troubles].count(JournalChanged) == 1


def test_cut_history_is_reported_to_a_follower(daemon: StreamDaemon) -> None:
    for _ in range(10):
        daemon.publish("fault", {})

    def cut() -> None:
        daemon.outbox.events = daemon.outbox.events[6:]

    daemon.call(cut)
    follower = Follower(daemon, after=2)
    follower.until(lambda: len(follower.seqs) == 4)
    follower.end()
    assert [seq for _, seq in follower.seqs] == [7, 8, 9, 10]
    [trouble] = follower.troubles
    assert isinstance(trouble, HistoryCut)
    assert trouble.gone_before == 7


async def test_the_async_client_does_the_same(daemon: StreamDaemon) -> None:
    async with AsyncClient(daemon.commands, daemon.events, timeout_s=20) as lab:
        status, stop, capture = await asyncio.gather(lab.status(), lab.stop(), lab.capture(label="b"))
        assert (status.state, stop.table, capture.capture) == ("idle", "rest", "0001-a")
        with pytest.raises(RemoteError):
            await lab.abort()
        stream = await lab.listen(after=0, timeout_s=20)
        for number in range(3):
            daemon.outbox.add("fault", {"message": str(number)})  # not woken: found by the gap before the next one
        await asyncio.to_thread(daemon.publish, "fault", {"message": "3"})
        found: list[int] = []
        while len(found) < 4:
            event = await stream.receive(20)
            assert event is not None
            found += [event["seq"]] if event["kind"] == "fault" else []
        assert found == [1, 2, 3, 4]
        stream.close()


async def test_an_async_follower_outlives_a_restart_and_reports_the_silence(
    daemon: StreamDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labdaemon.stream.async_client.LOST_S", 1.0)
    troubles: list[LabdaemonError] = []
    seqs: list[int] = []
    silent, two = asyncio.Event(), asyncio.Event()

    def report(trouble: LabdaemonError) -> None:
        troubles.append(trouble)
        silent.set()

    async def follow(lab: AsyncClient) -> None:
        async for event in lab.follow(after=0, report=report):
            if event["kind"] == "fault":
                seqs.append(event["seq"])
                if len(seqs) == 2:
                    two.set()

    await asyncio.to_thread(daemon.publish, "fault", {"message": "1"})
    async with AsyncClient(daemon.commands, daemon.events, timeout_s=20) as lab:
        following = asyncio.create_task(follow(lab))
        first = lab.typed_events(after=0, timeout_s=20)
        async for event in first:
            if event.kind == "fault":
                assert event.data.message == "1"
                break
        await first.aclose()
        await asyncio.to_thread(daemon.stop)
        daemon.outbox.add("fault", {"message": "2"})  # published while the client is cut off
        await asyncio.wait_for(silent.wait(), 60)
        await asyncio.to_thread(daemon.start)
        await asyncio.wait_for(two.wait(), 60)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
    assert seqs == [1, 2]
    assert isinstance(troubles[0], HeartbeatLost)


async def test_the_async_client_says_when_nothing_answers() -> None:
    async with AsyncClient("tcp://127.0.0.1:9", "tcp://127.0.0.1:9", timeout_s=0.1) as lab:
        with pytest.raises(NoDaemon):
            await lab.status()
        with pytest.raises(HeartbeatLost):
            await anext(lab.events(timeout_s=0.1))


async def test_the_async_client_has_a_key(guarded: StreamDaemon, keys: FakeKeys) -> None:
    async with AsyncClient(guarded.commands, guarded.events, timeout_s=20, key=keys.observer) as lab:
        assert (await lab.status()).state == "idle"
        with pytest.raises(RemoteError, match="for operators"):
            await lab.stop()


def test_a_client_that_vanishes_in_mid_request_costs_nothing(daemon: StreamDaemon, lab: Client) -> None:
    for _ in range(30):
        with Client(daemon.commands, daemon.events) as gone, suppress(NoDaemon):
            gone.call("events.replay", after=0, timeout_s=0.001)
    assert lab.status().state == "idle"


def test_a_client_that_is_closed_while_it_is_used_says_so(daemon: StreamDaemon) -> None:
    lab = Client(daemon.commands, daemon.events, timeout_s=20)
    stream = lab.listen(timeout_s=20)
    assert stream.receive(20) is not None
    lab.close()
    for use in (
        lambda: stream.receive(20),
        lab.status,
        lab.listen,
        lambda: next(lab.events()),
        lambda: next(lab.follow()),
    ):
        with pytest.raises(ClientClosed, match="make a new client"):
            use()


@pytest.mark.parametrize("error", [zmq.ZMQError(zmq.ENOTSOCK), zmq.ContextTerminated()])
def test_a_client_that_another_thread_closes_in_mid_call_says_so(
    daemon: StreamDaemon, lab: Client, monkeypatch: pytest.MonkeyPatch, error: zmq.ZMQError
) -> None:
    def poll(*_: object) -> int:
        raise error

    with lab.listen(timeout_s=20) as stream, monkeypatch.context() as patched:
        assert stream.receive(20) is not None
        patched.setattr(zmq.Socket, "poll", poll)
        for use in (lambda: stream.receive(20), lab.status):
            with pytest.raises(ClientClosed):
                use()


async def test_closing_the_async_client_ends_what_waits_in_other_tasks(daemon: StreamDaemon) -> None:
    lab = AsyncClient("tcp://127.0.0.1:9", daemon.events, timeout_s=120)  # commands are never answered
    heard = asyncio.Event()

    async def follow() -> None:
        async for _ in lab.follow():
            heard.set()

    tasks = [asyncio.create_task(follow()), asyncio.create_task(lab.status())]
    async with asyncio.timeout(60):
        await heard.wait()
        await lab.close()
        for task in tasks:
            with pytest.raises(ClientClosed):
                await task
    with pytest.raises(ClientClosed):
        await lab.status()
