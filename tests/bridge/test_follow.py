"""A bridge's own client: the place it begins at, a daemon that goes and comes, and the commands themselves."""

from __future__ import annotations

import json
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
import zmq
from click.testing import CliRunner

from labdaemon.bridge import follow
from labdaemon.bridge.follow import Place, follow_events, open_campaign_place
from labdaemon.cli.bridge import bridge
from labdaemon.errors import UsageError
from labdaemon.stream.client import Client
from labdaemon.testing.stream_daemon import MemoryOutbox, StreamDaemon

CAPTURE = {"capture": "c1", "exposure_s": 1.0, "frames": []}


@pytest.fixture
def daemon() -> Iterator[StreamDaemon]:
    one = StreamDaemon()
    for kind, data in (("campaign.started", {"name": "x"}), ("capture.completed", CAPTURE)):
        one.outbox.add(kind, data, "0001-x")
    one.start()
    one.results["rig"] = {"service": {"events": one.events, "data": "/data"}}
    yield one
    one.stop()


@pytest.fixture
def client(daemon: StreamDaemon) -> Iterator[Client]:
    with Client(daemon.commands, daemon.events, timeout_s=10.0) as one:
        yield one


def kinds(events: Any, count: int) -> list[str]:
    found: list[str] = []
    while len(found) < count:
        event = next(events)
        if event is not None and event["kind"] != "status":
            found.append(f"{event['seq']} {event['kind']}")
    return found


def test_events_follow_a_place_through_a_restart_and_a_new_journal(daemon, client, monkeypatch):
    monkeypatch.setattr(follow, "SILENT_S", 0.6)
    with closing(follow_events(client, Place(1, daemon.outbox.uuid))) as events:
        assert kinds(events, 1) == ["2 capture.completed"]
        daemon.publish("fault", {"message": "x"})
        assert kinds(events, 1) == ["3 fault"]
        daemon.stop()
        while next(events) is not None:
            continue
        daemon.outbox.add("fault", {"message": "meanwhile"})
        daemon.start()
        assert kinds(events, 1) == ["4 fault"]
        daemon.stop()
        daemon.outbox = MemoryOutbox("22222222-2222-2222-2222-222222222222")
        daemon.outbox.add("fault", {"message": "another history"})
        daemon.start()
        assert kinds(events, 1) == ["1 fault"]


def test_a_bridge_begins_with_the_campaign_that_runs(daemon, client):
    assert open_campaign_place(client) == Place(0, daemon.outbox.uuid)
    daemon.call(lambda: daemon.outbox.add("campaign.completed", {}, "0001-x"))
    assert open_campaign_place(client) is None
    daemon.call(lambda: daemon.outbox.add("campaign.started", {"name": "y"}, "0002-y"))
    assert open_campaign_place(client) == Place(3, daemon.outbox.uuid)


def test_the_command_publishes_documents_until_it_is_interrupted(daemon: StreamDaemon):
    command = [sys.executable, "-m", "labdaemon", "bridge", "bluesky", "--address", daemon.commands]
    process = subprocess.Popen([*command, "--bind", "tcp://127.0.0.1:*", "--json"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = json.loads(process.stdout.readline())["documents"]
        with zmq.Context() as context, context.socket(zmq.SUB) as subscriber:
            subscriber.subscribe(b"")
            subscriber.connect(address)
            names = []
            while len(names) < 3:
                assert subscriber.poll(30_000)
                _, name, content = subscriber.recv().split(b" ", 2)
                assert pickle.loads(content)["uid"]
                names.append(name.decode())
        assert names == ["start", "descriptor", "event"]
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [(["mqtt", "--broker", "nowhere"], "HOST:PORT"), (["mqtt", "--broker", "a:99999"], "HOST:PORT")],
)
def test_what_is_no_broker_is_refused(options: list[str], message: str):
    result = CliRunner().invoke(bridge, options)
    assert isinstance(result.exception, UsageError)
    assert message in str(result.exception)


def test_a_package_that_is_missing_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = CliRunner().invoke(bridge, ["mqtt"])
    assert "pip install 'labdaemon[mqtt]'" in str(result.exception)
