"""Subscribers that do not read, with and without keys: they lose events, and cost the others nothing."""

from __future__ import annotations

import json

import pytest
import zmq

from labdaemon.stream import publisher, sockets
from labdaemon.stream.client import Client
from labdaemon.stream.client_sockets import secure
from labdaemon.testing.stream_daemon import FakeKeys, StreamDaemon

HIGH_WATER = 50
EVENTS = 600
PADDING = "x" * 20_000
"""Together 12 MB: more than the system's buffers and the high-water mark hold for a reader."""


@pytest.mark.parametrize("is_keyed", [False, True], ids=["open", "with keys"])
def test_one_that_never_reads_loses_events_and_delays_no_one(
    keys: FakeKeys, is_keyed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher, "EVENTS_HIGH_WATER", HIGH_WATER)
    daemon = StreamDaemon(sockets.DoorPolicy(keys.access) if is_keyed else sockets.ANYBODY)
    daemon.start()
    pair = keys.observer if is_keyed else None
    try:
        with (
            Client(daemon.commands, daemon.events, timeout_s=60.0, key=pair) as client,
            client.listen(timeout_s=60.0) as stream,
            zmq.Context() as context,
            context.socket(zmq.SUB) as stalled,
        ):
            stalled.set(zmq.RCVHWM, 1)
            stalled.set(zmq.RCVBUF, 4096)
            stalled.set(zmq.LINGER, 0)
            if pair is not None:
                secure(stalled, pair)
            stalled.connect(daemon.events)
            stalled.subscribe(b"fault")
            stalled.subscribe(b"status")
            assert stalled.poll(60_000), "it did not get in"
            seen: list[int] = []
            while len(seen) < EVENTS:
                daemon.publish("fault", {"message": PADDING})
                while (event := stream.receive(60.0)) is not None and event["kind"] == "status":
                    continue
                assert event is not None
                seen.append(event["seq"])
            assert seen == list(range(1, EVENTS + 1))
            assert client.call("status")["seq"] == EVENTS
            got = []
            while True:  # up to a status that was sent after all of them
                assert stalled.poll(60_000)
                kind, text = stalled.recv_multipart()
                event = json.loads(text)
                if kind == b"fault":
                    got.append(event["seq"])
                elif event["seq"] == EVENTS:
                    break
        assert got[:HIGH_WATER] == list(range(1, HIGH_WATER + 1))
        assert len(got) < EVENTS, "more was kept for it than the high-water mark and the system's buffers"
    finally:
        daemon.stop()
