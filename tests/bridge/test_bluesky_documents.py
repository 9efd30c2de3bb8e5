"""Events as bluesky's documents: valid by event_model's own schemas, the same when they are made again."""

from __future__ import annotations

import json
import math
import pickle
import socket
from pathlib import Path
from typing import Any

import pytest
import zmq

from labdaemon.bridge.bluesky_bridge import BridgePlace, DocumentPublisher, publish_events, read_place
from labdaemon.bridge.bluesky_documents import MOST_OPEN, Document, DocumentMaker
from labdaemon.bridge.follow import Place
from labdaemon.bridge.open_documents import OpenDocuments
from labdaemon.errors import UsageError
from labdaemon.testing.served import TARGETS, event_document

CAMPAIGN = "0001-three-modes"


def capture(name: str, **more: Any) -> dict[str, Any]:
    frames = [
        {"camera": camera, "path": f"campaigns/x/{name}/{camera}.dng", "size_bytes": 5, "sha256": "ab"}
        for camera in ("left", "right")
    ]
    return {"capture": name, "frames": frames, "exposure_s": 1.0, "opened_at": "2026-01-01T00:00:00Z"} | more


def history() -> list[dict[str, Any]]:
    """A sharp set and a group outside campaigns, then a campaign of two captures with a target more in the second."""
    said: list[tuple[str, str | None, dict[str, Any]]] = [
        ("capture.completed", "0000-manual", capture("manual-1", sharp=True)),
        ("capture.completed", "0000-manual", capture("manual-2", group="g")),
        ("capture.completed", "0000-manual", capture("manual-3", group="g", frequency_hz=5.0)),
        ("envelope", "0000-manual", {"capture": "g", "targets": TARGETS, "frequency_hz": 5.0}),
        ("campaign.started", CAMPAIGN, {"name": "three-modes", "steps": 2}),
        ("step.started", CAMPAIGN, {"step": 0}),
        ("capture.completed", CAMPAIGN, capture("c1")),
        ("envelope", CAMPAIGN, {"capture": "c1", "targets": TARGETS}),
        ("capture.completed", CAMPAIGN, capture("c2")),
        ("fault", CAMPAIGN, {"message": "a fault"}),
        ("envelope", CAMPAIGN, {"capture": "c2", "targets": [*TARGETS, {"target": "P3"}]}),
        ("campaign.completed", CAMPAIGN, {"captures": 2}),
    ]
    events = []
    for seq, (kind, campaign, data) in enumerate(said, 1):
        events.append(event_document(seq, kind, **data) | {"campaign": campaign})
    return events


def documents_of(events: list[dict[str, Any]]) -> list[Document]:
    maker = DocumentMaker(Path("/data"))
    return [document for event in events for document in maker.feed(event)]


def test_a_campaign_and_each_group_outside_is_a_run():
    documents = documents_of(history())
    names = [name for name, _ in documents]
    assert [names.count(name) for name in ("start", "stop", "event")] == [3, 3, 5 + 3]
    assert (names.count("stream_resource"), names.count("stream_datum")) == (2 * 3, 2 * 5)
    stops = [content for name, content in documents if name == "stop"]
    assert [stop["exit_status"] for stop in stops] == ["success"] * 3
    assert stops[-1]["num_events"] == {"captures": 2, "envelopes": 2}
    resource = next(content for name, content in documents if name == "stream_resource")
    assert resource["uri"] == "file://localhost/data/campaigns/x/"
    taken = next(content for name, content in documents if name == "event")
    assert taken["data"]["frame_left_path"] == "/data/campaigns/x/manual-1/left.dng"
    event = next(content for name, content in documents if name == "event" and "ax_mm" in content["data"])
    assert event["data"]["target"] == ["P1", 'P"2']
    assert event["data"]["ax_mm"][0] == 0.5
    assert math.isnan(event["data"]["ax_mm"][1])
    assert event["data"]["flags"] == ["at_rest;occluded", ""]


def test_documents_that_are_made_again_are_the_same():
    assert repr(documents_of(history())) == repr(documents_of(history()))
    uids = [content["uid"] for name, content in documents_of(history())]
    assert len(uids) == len(set(uids))


def test_they_are_valid_by_the_schemas_of_event_model():
    event_model = pytest.importorskip("event_model", reason="event-model is not installed (extra bluesky)")
    documents = documents_of(history())
    for name, content in documents:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(json.loads(json.dumps(content)))
    seen: list[str] = []

    def factory(name: str, doc: dict[str, Any]) -> tuple[list[Any], list[Any]]:
        return [lambda name, doc: seen.append(name)], []

    router = event_model.RunRouter([factory])
    for name, content in documents:
        router(name, content)
    assert [name.removesuffix("_page") for name in seen] == [name for name, _ in documents]


def test_what_is_never_measured_ends_its_run():
    maker = DocumentMaker()
    events = [event_document(seq, "capture.completed", **capture(f"m{seq}")) for seq in range(1, MOST_OPEN + 3)]
    stops = [content for event in events for name, content in maker.feed(event) if name == "stop"]
    assert [stop["exit_status"] for stop in stops] == ["fail", "fail"]
    failed = list(maker.feed(event_document(500, "fault", capture="m50", message="no target")))
    assert [(name, content["reason"]) for name, content in failed] == [("stop", "no target")]


def test_a_bridge_that_is_started_again_goes_on_with_the_counts(tmp_path: Path):
    events, state = history(), tmp_path / "state.json"
    whole: list[Document] = []
    publish_events(events, DocumentMaker(), whole.append)
    parts: list[Document] = []
    for cut in range(len(events) + 1):
        state.unlink(missing_ok=True)
        parts.clear()
        publish_events([*events[:cut], None, event_document(cut, "status")], DocumentMaker(), parts.append, state=state)
        place = read_place(state)
        begin = place.before_open.seq if place is not None else 0
        publish_events(events[begin:], DocumentMaker(), parts.append, place=place, state=state)
        assert repr(parts) == repr(whole), cut
    assert read_place(state) == BridgePlace(Place(12, "j"), Place(12, "j"))


def test_a_place_of_another_journal_does_not_count(tmp_path: Path):
    found: list[Document] = []
    place = BridgePlace(Place(500, "other"), Place(400, "other"))
    publish_events(history(), DocumentMaker(), found.append, place=place)
    assert len(found) == len(documents_of(history()))


@pytest.mark.parametrize("text", ["", "[]", '{"journal": "j", "seq": 1, "before_open": 2}', '{"seq": 1}'])
def test_a_state_that_is_none_is_refused(tmp_path: Path, text: str):
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(UsageError, match="no state of a bridge"):
        read_place(path)
    assert read_place(tmp_path / "absent") is None


@pytest.mark.parametrize(("serializer", "loads"), [("pickle", pickle.loads), ("json", json.loads)])
def test_a_subscriber_gets_all_from_the_first_on(serializer: Any, loads: Any):
    with DocumentPublisher("tcp://127.0.0.1:*", serializer=serializer) as publisher, zmq.Context() as context:
        assert not publisher.wait_for_subscriber(0.0)
        with pytest.raises(UsageError, match="cannot be used"):
            DocumentPublisher(publisher.address)
        subscriber = context.socket(zmq.SUB)
        subscriber.connect(publisher.address)
        subscriber.subscribe(b"")
        assert publisher.wait_for_subscriber(20.0)
        for number in range(100):
            publisher.publish(("start", {"uid": str(number)}))
        for number in range(100):
            assert subscriber.poll(20_000)
            prefix, name, content = subscriber.recv().split(b" ", 2)
            assert (prefix, name, loads(content)["uid"]) == (b"", b"start", str(number))
        subscriber.close(linger=0)


def test_bytes_of_scanners_and_messages_of_peers_are_no_subscribers():
    with DocumentPublisher("tcp://127.0.0.1:*") as publisher, zmq.Context() as context:
        host, _, port = publisher.address.removeprefix("tcp://").rpartition(":")
        for data in (b"GET / HTTP/1.1\r\n\r\n", b" \x80abc ", b"\xff" * 200):
            with socket.create_connection((host, int(port)), timeout=60) as scanner:
                scanner.sendall(data)
        peer = context.socket(zmq.XSUB)
        peer.connect(publisher.address)
        for message in (b"\x02 start abc", b"", b"\x00x"):
            peer.send(message)
        assert not publisher.wait_for_subscriber(0.3)
        peer.send(b"\x01")
        assert publisher.wait_for_subscriber(20.0)
        for message in (b"x" * 900, b"\x01more"):
            peer.send(message)
        publisher.publish(("start", {"uid": "1"}))
        assert peer.poll(20_000)
        assert pickle.loads(peer.recv().split(b" ", 2)[2]) == {"uid": "1"}
        peer.close(linger=0)


def test_a_newcomer_gets_the_open_runs_from_their_start_and_no_one_gets_them_twice():
    documents = documents_of(history())
    begun = max(place for place, (name, _) in enumerate(documents) if name == "start")
    middle = (begun + len(documents)) // 2
    with DocumentPublisher("tcp://127.0.0.1:*", serializer="json") as publisher, zmq.Context() as context:
        received: dict[str, list[tuple[str, str]]] = {}

        def join(who: str, topic: bytes = b"") -> zmq.Socket[bytes]:
            subscriber = context.socket(zmq.SUB)
            subscriber.connect(publisher.address)
            subscriber.subscribe(topic)
            assert publisher.wait_for_subscriber(20.0)
            received[who] = []
            return subscriber

        def publish(part: list[Document]) -> None:
            for document in part:
                publisher.publish(document)

        def receive(who: str, subscriber: zmq.Socket[bytes], count: int) -> None:
            for _ in range(count):
                assert subscriber.poll(20_000), f"{who} got {received[who]}"
                _, name, content = subscriber.recv().split(b" ", 2)
                received[who].append((name.decode(), json.loads(content)["uid"]))

        first = join("first")
        publish(documents[:middle])
        late, stops = join("late"), join("stops", b" stop")
        publish(documents[middle:])
        after = join("after")
        for who, subscriber, expected in (
            ("first", first, documents),
            ("late", late, documents[begun:]),
            ("stops", stops, documents[-1:]),
            ("after", after, []),
        ):
            receive(who, subscriber, len(expected))
            assert received[who] == [(name, content["uid"]) for name, content in expected], who
            assert not subscriber.poll(50), who
            subscriber.close(linger=0)


def test_a_long_run_keeps_what_its_later_events_are_read_with():
    documents = documents_of(history())
    begun = max(place for place, (name, _) in enumerate(documents) if name == "start")
    *run, stop = documents[begun:]
    kept = OpenDocuments(most_bytes=1)
    for name, content in run:
        kept.add(name, content, f" {name} x".encode())
    names = [message.split()[0] for message in kept.messages()]
    assert b"event" not in names
    assert names.count(b"start") == 1
    assert names.count(b"descriptor") >= 2
    kept.add(*stop, b"")
    assert not list(kept.messages())


def test_after_a_restart_newcomers_get_the_open_run_too():
    events = history()
    open_run = events[:4]
    place = BridgePlace(Place(open_run[-1]["seq"], "j"), Place(0, "j"))
    published: list[Document] = []
    remembered: list[Document] = []
    maker = DocumentMaker(Path("/data"))
    publish_events(open_run, maker, published.append, place=place, remember=remembered.append)
    assert not published
    assert remembered == documents_of(open_run)
