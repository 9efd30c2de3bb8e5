"""The client against a publisher and a server of its own: gaps are filled, another history is noticed."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zmq

from labdaemon.errors import DataError
from labdaemon.events import FaultReported
from labdaemon.stream import messages
from labdaemon.stream.client import Client, EventStream, JournalChanged, NoDaemon, RemoteError

AT = "2026-05-04T10:11:12.000000Z"


def event(seq: int, kind: str = "fault", journal: str = "u1", **data: Any) -> dict[str, Any]:
    return {"v": 1, "seq": seq, "at": AT, "kind": kind, "campaign": None, "journal": journal, "data": data}


class FakeDaemon:
    """A commands socket on a thread, and an events socket for the test to publish on."""

    def __init__(self) -> None:
        self.context = zmq.Context()
        self.publisher = self.context.socket(zmq.XPUB)
        self.publisher.bind("tcp://127.0.0.1:0")
        self.events = self.publisher.get(zmq.LAST_ENDPOINT).decode()
        self._server = self.context.socket(zmq.ROUTER)
        self._server.bind("tcp://127.0.0.1:0")
        self.commands = self._server.get(zmq.LAST_ENDPOINT).decode()
        self.history: list[dict[str, Any]] = []
        self.answers: dict[str, Callable[[dict[str, Any]], Any]] = {"events.replay": self._replay}
        self.calls: list[str] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def publish(self, message: dict[str, Any]) -> None:
        self.publisher.send_multipart([message["kind"].encode(), json.dumps(message).encode()])

    def subscribed(self) -> None:
        """Wait for a subscription: what is published after it arrives."""
        assert self.publisher.poll(60_000)
        self.publisher.recv()

    def close(self) -> None:
        with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
            socket.connect(self.commands)
            socket.send(b"end")
            self._thread.join(60.0)
        self.context.destroy(linger=0)

    def _replay(self, params: dict[str, Any]) -> Any:
        found = [one for one in self.history if one["seq"] > params["after"]][: min(params["limit"], 2)]
        return {"events": found, "last": len(self.history), "journal": "u1"}

    def _serve(self) -> None:
        while True:
            *envelope, frame = self._server.recv_multipart()
            if frame == b"end":
                self._server.close(linger=0)
                return
            request = messages.parse_request(frame)
            self.calls.append(request.method)
            answer = self.answers.get(request.method)
            if answer is None:
                continue  # never answers
            try:
                reply = messages.result_bytes(answer(request.params), request.id)
            except messages.CommandError as exc:
                reply = messages.error_bytes(exc.code, str(exc), request.id)
            self._server.send_multipart([*envelope, reply])


@pytest.fixture
def daemon() -> Iterator[FakeDaemon]:
    daemon = FakeDaemon()
    yield daemon
    daemon.close()


@pytest.fixture
def client(daemon: FakeDaemon) -> Iterator[Client]:
    with Client(daemon.commands, daemon.events, timeout_s=60.0) as client:
        yield client


@pytest.fixture
def follow(client: Client) -> Iterator[Callable[..., EventStream]]:
    """Makes event streams, and closes them after the test."""
    streams: list[EventStream] = []

    def start(**options: Any) -> EventStream:
        streams.append(EventStream(client, **options))
        return streams[-1]

    yield start
    for stream in streams:
        stream.close()


def test_a_call_returns_its_result(daemon: FakeDaemon, client: Client) -> None:
    daemon.answers["status"] = lambda params: {"state": "idle", **params}
    assert client.call("status", campaign="c") == {"state": "idle", "campaign": "c"}


def test_a_refusal_is_an_error_with_its_name(daemon: FakeDaemon, client: Client) -> None:
    def refuse(params: dict[str, Any]) -> Any:
        raise messages.BusyError("campaign 0001 is running")

    daemon.answers["capture"] = refuse
    with pytest.raises(RemoteError, match="0001 is running") as caught:
        client.call("capture")
    assert (caught.value.code, caught.value.name, caught.value.retryable) == (messages.BUSY, "busy", True)


@pytest.mark.parametrize(("code", "status"), [(messages.LIMITS, 2), (messages.INVALID_PARAMS, 2), (messages.DEVICE, 1)])
def test_exit_statuses_follow_the_code(code: int, status: int) -> None:
    assert RemoteError({"code": code, "message": "no"}).exit_status == status


def test_an_error_of_another_program_has_words_all_the_same() -> None:
    error = RemoteError({"data": None})
    assert (error.code, error.name, str(error)) == (messages.INTERNAL_ERROR, "error", "the daemon refused")


def test_silence_is_no_daemon_and_the_next_call_is_answered(daemon: FakeDaemon, client: Client) -> None:
    with pytest.raises(NoDaemon, match="labdaemon run"):
        client.call("status", timeout_s=0.05)
    daemon.answers["status"] = lambda params: "idle"
    assert client.call("status") == "idle"


def test_events_come_in_order(daemon: FakeDaemon, follow: Callable[..., EventStream]) -> None:
    stream = follow()
    daemon.subscribed()
    daemon.publish(event(7, "status"))
    daemon.publish(event(8))
    daemon.publish(event(8, "status"))
    assert [stream.receive(60.0)["seq"] for _ in range(3)] == [7, 8, 8]  # type: ignore[index]
    assert stream.last == 8
    assert stream.receive(0.01) is None


def test_a_gap_is_filled_before_what_came_after_it(daemon: FakeDaemon, follow: Callable[..., EventStream]) -> None:
    """Five are missing, and the daemon gives two at a time."""
    daemon.history = [event(seq) for seq in range(1, 8)]
    stream = follow(after=1, journal="u1")
    daemon.subscribed()
    daemon.publish(event(7))
    assert [stream.receive(60.0)["seq"] for _ in range(6)] == [2, 3, 4, 5, 6, 7]  # type: ignore[index]
    assert daemon.calls.count("events.replay") == 3


def test_an_event_that_was_replayed_already_is_not_given_twice(
    daemon: FakeDaemon, follow: Callable[..., EventStream]
) -> None:
    daemon.history = [event(seq) for seq in range(1, 4)]
    stream = follow(after=0, journal="u1")
    daemon.subscribed()
    daemon.publish(event(3, "status"))
    daemon.publish(event(3))
    daemon.publish(event(4))
    kinds = [stream.receive(60.0) for _ in range(5)]
    assert [(one["kind"], one["seq"]) for one in kinds if one] == [
        ("fault", 1), ("fault", 2), ("fault", 3), ("status", 3), ("fault", 4),
    ]  # fmt: skip


def test_another_history_is_reported_once_and_followed_from_its_beginning(
    daemon: FakeDaemon, follow: Callable[..., EventStream]
) -> None:
    stream = follow(after=5, journal="u0")
    daemon.subscribed()
    daemon.history = [event(1)]
    daemon.publish(event(1, "status"))
    with pytest.raises(JournalChanged, match="u1 now, it was u0"):
        stream.receive(60.0)
    daemon.publish(event(1, "status"))
    assert [stream.receive(60.0)["kind"] for _ in range(2)] == ["fault", "status"]  # type: ignore[index]


def test_typed_events_are_objects(daemon: FakeDaemon, client: Client) -> None:
    daemon.history = [event(1, device="left", message="no answer")]
    events = client.typed_events(after=0, timeout_s=60.0)
    publishing = threading.Thread(target=lambda: (daemon.subscribed(), daemon.publish(event(1, "status"))))
    publishing.start()
    first = next(events)
    publishing.join()
    assert isinstance(first, FaultReported)
    assert first.data.device == "left"
    events.close()  # type: ignore[attr-defined]


def test_an_event_of_another_version_is_named(daemon: FakeDaemon, client: Client) -> None:
    daemon.history = [event(1, step="first")]
    events = client.typed_events(after=0, timeout_s=60.0)
    publishing = threading.Thread(target=lambda: (daemon.subscribed(), daemon.publish(event(1, "status"))))
    publishing.start()
    with pytest.raises(DataError, match="step"):
        next(events)
    publishing.join()


def test_the_latest_event_of_each_kind_is_given_by_kind(daemon: FakeDaemon, client: Client) -> None:
    daemon.answers["events.latest"] = lambda params: {"events": [event(3), event(2, "envelope")]}
    assert {kind: one["seq"] for kind, one in client.latest().items()} == {"fault": 3, "envelope": 2}


def test_no_heartbeat_is_no_daemon(client: Client) -> None:
    with pytest.raises(NoDaemon, match="no heartbeat"):
        next(client.events(timeout_s=0.05))
