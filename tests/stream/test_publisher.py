"""The events socket and the client over real ZeroMQ: every event once, in order, whatever is lost on the way."""

from __future__ import annotations

import asyncio
import contextlib
import json
import runpy
import threading
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.clock import SystemClock
from labdaemon.errors import ConfigError, StorageUnavailable
from labdaemon.events import StepCompleted
from labdaemon.journal.event import EventText, StoredEvent, limit_bytes
from labdaemon.stream import publisher as events_module
from labdaemon.stream.client import Client, EventStream, JournalChanged, NoDaemon, RemoteError
from labdaemon.stream.commands import CommandServer
from labdaemon.stream.messages import InvalidParamsError, RawJson
from labdaemon.stream.publisher import EventPublisher, latest, replay


class ListOutbox:
    """A journal in memory."""

    def __init__(self, uuid: str = "journal-1", count: int = 0) -> None:
        self.uuid = uuid
        self.events: list[StoredEvent] = []
        self.add(count)

    @property
    def last_seq(self) -> int:
        return len(self.events)

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        return limit_bytes((event.text() for event in self.events[seq : seq + limit]), most_bytes)

    history = recent

    def latest(self) -> list[EventText]:
        return [event.text() for event in {event.kind: event for event in self.events}.values()]

    def add(self, count: int = 1, size: int = 0) -> None:
        for _ in range(count):
            seq = len(self.events) + 1
            data = {"step": 0, "n": seq, "padding": "x" * size}
            self.events.append(StoredEvent(seq, "2026-05-04T10:11:12.000000Z", "step.completed", "c1", data, self.uuid))


class Service:
    """Publisher and command server on a loop of their own, as a daemon has them."""

    def __init__(self, outbox: ListOutbox, events: str = "tcp://127.0.0.1:*", commands: str = "tcp://127.0.0.1:*"):
        self.outbox = outbox
        self._events, self._commands = events, commands
        self._ready, self._stop = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main()))

    async def _main(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.publisher = EventPublisher(
            self._events, self.outbox, lambda: {"campaign": None, "state": "idle"}, SystemClock()
        )
        self.server = CommandServer(self._commands, {"events.replay": self._replay, "events.latest": self._latest})
        self.publisher.bind()
        self.server.bind()
        self._ready.set()
        tasks = [asyncio.create_task(self.publisher.run()), asyncio.create_task(self.server.run())]
        await self._stop.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self.publisher.close()
        self.server.close()

    async def _replay(self, params: dict[str, Any]) -> RawJson:
        return replay(self.outbox, params)

    async def _latest(self, params: dict[str, Any]) -> RawJson:
        return latest(self.outbox, params)

    def commit(self, count: int = 1, size: int = 0, *, silently: bool = False) -> None:
        """Add events; `silently` as if they were lost on the way to subscribers."""
        done = threading.Event()

        def add() -> None:
            self.outbox.add(count, size)
            if silently:
                self.publisher._sent = self.outbox.last_seq
            self.publisher.wake()
            done.set()

        self.loop.call_soon_threadsafe(add)
        assert done.wait(60)

    def __enter__(self) -> Service:
        self._thread.start()
        assert self._ready.wait(60)
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(60)
        assert not self._thread.is_alive()

    def client(self) -> Client:
        return Client(self.server.address, self.publisher.address, timeout_s=20)


@contextlib.contextmanager
def following(client: Client, **options: Any) -> Iterator[EventStream]:
    """A stream that has seen its first message."""
    stream = EventStream(client, **options)
    first = stream.receive(20)
    assert first is not None
    yield stream
    stream.close()


def take(stream: EventStream, count: int) -> list[int]:
    """`seq` of the next events, statuses left out."""
    seqs: list[int] = []
    while len(seqs) < count:
        event = stream.receive(20)
        assert event is not None, f"silent after {seqs}"
        if event["kind"] != "status":
            seqs.append(event["seq"])
    return seqs


def test_a_message_is_topic_and_json() -> None:
    with Service(ListOutbox(count=3)) as service, zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.connect(service.publisher.address)
        socket.set(zmq.SUBSCRIBE, b"")
        topic, body = socket.recv_multipart()
        status = json.loads(body)
        assert topic == b"status"
        assert (status["v"], status["seq"], status["kind"], status["journal"]) == (1, 3, "status", "journal-1")
        service.commit()
        while topic == b"status":
            topic, body = socket.recv_multipart()
        assert topic == b"step.completed"
        assert json.loads(body) == {
            "v": 1,
            "seq": 4,
            "at": "2026-05-04T10:11:12.000000Z",
            "kind": "step.completed",
            "campaign": "c1",
            "journal": "journal-1",
            "data": {"step": 0, "n": 4, "padding": ""},
        }


def test_every_event_once_in_order() -> None:
    with Service(ListOutbox(count=5)) as service, service.client() as client, following(client) as stream:
        for count in (1, 700, 3):
            service.commit(count)
        assert take(stream, 704) == list(range(6, 710))


def test_a_late_client_gets_what_it_missed() -> None:
    with Service(ListOutbox(count=2500)) as service, service.client() as client:
        stream = EventStream(client, after=0)
        assert take(stream, 2500) == list(range(1, 2501))
        service.commit()
        assert take(stream, 1) == [2501]


def test_events_lost_on_the_way_are_replayed() -> None:
    with Service(ListOutbox()) as service, service.client() as client, following(client) as stream:
        service.commit(2)
        service.commit(3, silently=True)
        service.commit(1)
        assert take(stream, 6) == [1, 2, 3, 4, 5, 6]
        service.commit(2, silently=True)  # the heartbeat tells of these
        assert take(stream, 2) == [7, 8]


@settings(max_examples=12, deadline=None)
@given(pattern=st.lists(st.tuples(st.booleans(), st.integers(1, 60)), min_size=1, max_size=6))
def test_whatever_is_lost_every_event_comes_once_in_order(pattern: list[tuple[bool, int]]) -> None:
    with Service(ListOutbox(count=3)) as service, service.client() as client, following(client) as stream:
        for is_lost, count in pattern:
            service.commit(count, silently=is_lost)
        service.commit(1)
        total = 1 + sum(count for _, count in pattern)
        assert take(stream, total) == list(range(4, 4 + total))


def test_the_heartbeat_comes_every_second() -> None:
    with Service(ListOutbox()) as service, service.client() as client, following(client) as stream:
        beats = [stream.receive(10), stream.receive(10)]
        times = [datetime.fromisoformat(beat["at"]) for beat in beats if beat is not None and beat["kind"] == "status"]
        assert 0.5 < (times[1] - times[0]).total_seconds() < 5  # a busy machine delays, but nothing is skipped


def test_another_journal_is_noticed_and_followed_from_its_beginning() -> None:
    with Service(ListOutbox(count=4)) as service, service.client() as client:
        stream = EventStream(client)
        assert stream.receive(5) is not None
        service.outbox.uuid, service.outbox.events = "journal-2", []
        service.publisher._sent = 0
        service.commit(2)
        with pytest.raises(JournalChanged, match="journal-2"):
            take(stream, 1)
        assert take(stream, 2) == [1, 2]


def test_a_stream_goes_on_through_a_restart_of_the_daemon() -> None:
    outbox = ListOutbox(count=1)
    with Service(outbox) as before:
        client = before.client()
        stream = EventStream(client)
        assert stream.receive(20) is not None
        before.commit(2)
        assert take(stream, 2) == [2, 3]
    outbox.add(3)  # committed, and the daemon died before it could tell
    with Service(outbox, before.publisher.address, before.server.address) as again:
        assert take(stream, 3) == [4, 5, 6]
        again.commit()
        assert take(stream, 1) == [7]
    stream.close()
    client.close()


def test_a_silent_daemon_is_reported() -> None:
    with Client("tcp://127.0.0.1:9", "tcp://127.0.0.1:9", timeout_s=0.2) as client:
        with pytest.raises(NoDaemon, match="labdaemon run"):
            client.call("status")
        with pytest.raises(NoDaemon, match="heartbeat"):
            next(client.events(timeout_s=0.2))


def test_a_late_answer_is_not_taken_for_another() -> None:
    with Service(ListOutbox(count=1)) as service, service.client() as client:
        socket = client._connected()
        socket.send(b'{"jsonrpc":"2.0","id":99,"method":"events.replay"}')
        assert client.replay(0)["last"] == 1
        with pytest.raises(RemoteError, match="no method") as caught:
            client.call("nonsense")
        assert (caught.value.code, caught.value.name) == (-32601, "method_not_found")


def test_replay_answers_within_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    outbox = ListOutbox(count=1500)

    def replay(outbox: ListOutbox, params: dict[str, Any]) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(events_module.replay(outbox, params).text)
        return answer

    answer = replay(outbox, {"after": 10, "limit": 5000})
    assert [event["seq"] for event in answer["events"]] == list(range(11, 1011))
    assert (answer["last"], answer["journal"]) == (1500, "journal-1")
    assert replay(outbox, {"after": 1500})["events"] == []
    assert replay(outbox, {"limit": 0})["events"] == []
    monkeypatch.setattr(events_module, "MAX_REPLAY_BYTES", 1000)
    few = replay(outbox, {})["events"]
    assert 1 <= len(few) < 10
    outbox.add(1, size=5000)
    assert len(replay(outbox, {"after": 1500})["events"]) == 1


def test_a_history_that_was_cut_says_where_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    outbox = ListOutbox(count=20)
    kept = outbox.events[9:]
    monkeypatch.setattr(
        outbox, "history", lambda seq, limit, _: [event.text() for event in kept if event.seq > seq][:limit]
    )
    answer = json.loads(replay(outbox, {"after": 3, "limit": 2}).text)
    assert ([event["seq"] for event in answer["events"]], answer["gone_before"]) == ([10, 11], 10)
    assert "gone_before" not in json.loads(replay(outbox, {"after": 9}).text)
    kept.clear()
    answer = json.loads(replay(outbox, {"after": 3}).text)
    assert (answer["events"], answer["gone_before"]) == ([], 21)


def test_the_client_gives_typed_events_and_the_latest_of_each_kind() -> None:
    with Service(ListOutbox(count=2)) as service, service.client() as client:
        events = client.typed_events(after=0, timeout_s=20)
        steps = [event for event, _ in zip(events, range(6), strict=False) if isinstance(event, StepCompleted)]
        assert [event.seq for event in steps][:2] == [1, 2]
        assert (steps[0].data.step, steps[0].campaign) == (0, "c1")
        assert client.latest()["step.completed"]["seq"] == 2


def test_the_example_that_follows_the_stream_prints_an_envelope(capsys: pytest.CaptureFixture[str]) -> None:
    row = {"target": "T01", **{f"{name}{axis}_mm": 0.0 for name in ("", "a", "b") for axis in "xyz"}, "flags": []}
    outbox = ListOutbox(count=1)
    data = {"capture": "c0001", "targets": [row | {"ax_mm": 0.4, "az_mm": 0.3}]}
    outbox.events.append(StoredEvent(2, "2026-05-04T10:11:12.000000Z", "envelope", "c1", data, outbox.uuid))
    example = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "follow_stream.py"))
    with Service(outbox) as service:
        example["main"](service.server.address, service.publisher.address, count=1)
    assert "largest amplitude 0.5000 mm" in capsys.readouterr().out


def test_a_client_that_asks_and_never_reads_harms_nobody() -> None:
    outbox = ListOutbox()
    outbox.add(200, size=20_000)
    with (
        Service(outbox) as service,
        service.client() as client,
        zmq.Context() as context,
        context.socket(zmq.DEALER) as greedy,
    ):
        greedy.set(zmq.LINGER, 0)
        greedy.set(zmq.RCVHWM, 1)
        greedy.connect(service.server.address)
        for number in range(200):
            greedy.send_json({"jsonrpc": "2.0", "id": number, "method": "events.replay", "params": {}})
        for _ in range(5):
            assert client.replay(199)["last"] == 200


@pytest.mark.parametrize("params", [{"after": -1}, {"after": "x"}, {"after": 1.5}, {"limit": True}, {"limit": 1 << 70}])
def test_replay_refuses_nonsense(params: dict[str, Any]) -> None:
    with pytest.raises(InvalidParamsError):
        replay(ListOutbox(), params)


def test_a_journal_that_cannot_be_read_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with Service(ListOutbox()) as service, service.client() as client, following(client) as stream:
        failures = iter([StorageUnavailable("locked"), StorageUnavailable("locked")])
        recent = service.outbox.recent

        def locked(seq: int, limit: int, most_bytes: int) -> list[EventText]:
            for failure in failures:
                raise failure
            return recent(seq, limit, most_bytes)

        monkeypatch.setattr(service.outbox, "recent", locked)
        service.commit(3)
        assert take(stream, 3) == [1, 2, 3]


def test_a_second_publisher_on_the_address_is_told_so() -> None:
    with Service(ListOutbox()) as service:

        async def second() -> None:
            other = EventPublisher(service.publisher.address, ListOutbox(), dict, SystemClock())
            try:
                other.bind()
            finally:
                other.close()

        with pytest.raises(ConfigError, match=r"service\.events: .* is taken"):
            asyncio.run(second())
