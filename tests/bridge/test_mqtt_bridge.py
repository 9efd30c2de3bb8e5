"""The MQTT bridge against a real mosquitto: retained last values, its place, a broker that goes and comes."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed (extra mqtt)")

import paho.mqtt.client as paho

from labdaemon.bridge import mqtt_bridge
from labdaemon.bridge.follow import Place
from labdaemon.bridge.mqtt_bridge import BrokerLost, BrokerSettings, MqttBridge, topic_of
from labdaemon.errors import UsageError
from labdaemon.testing.free_port import free_port
from labdaemon.testing.served import event_document


class Broker:
    """mosquitto on a free port of loopback."""

    def __init__(self, program: str, folder: Path, *, persistence: bool = True) -> None:
        self.port = free_port()
        self.program, self._config = program, folder / "mosquitto.conf"
        self._config.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\nmax_packet_size 20000\n"
            f"persistence {str(persistence).lower()}\npersistence_location {folder}/\nuser root\n"
        )
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(
            [self.program, "-c", str(self._config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        until(self._answers)

    def stop(self) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.wait(20)
            self._process = None

    def _answers(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port), 1.0).close()
        except OSError:
            return False
        return True


def until(condition: Callable[[], Any], timeout_s: float = 30.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it did not come to that in time"
        time.sleep(0.01)


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed (apt-get install mosquitto)")
    one = Broker(program, tmp_path_factory.mktemp("mosquitto"))
    one.start()
    yield one
    one.stop()


@pytest.fixture
def prefix(request: pytest.FixtureRequest) -> str:
    return f"lab/{request.node.name}"


@pytest.fixture
def retained(broker: Broker, prefix: str) -> Iterator[dict[str, bytes]]:
    """What a client that has just joined has got, by topic below the prefix."""
    seen: dict[str, bytes] = {}
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)

    def keep(_: Any, __: Any, message: Any) -> None:
        seen[message.topic.removeprefix(prefix + "/")] = message.payload

    client.on_message = keep
    client.on_connect = lambda *_: client.subscribe(f"{prefix}/#", qos=1)
    client.reconnect_delay_set(1, 1)
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    yield seen
    client.disconnect()
    client.loop_stop()


def test_the_last_of_each_kind_is_retained_and_the_place_is_kept(broker, prefix, retained):
    settings = BrokerSettings(port=broker.port, prefix=prefix)
    bridge = MqttBridge(settings)
    assert bridge.connect() is None
    events = [event_document(seq, "envelope", capture=f"c{seq}", targets=[]) for seq in (1, 2)]
    events += [event_document(3, "campaign.completed", name="x"), event_document(3, "status", state="idle")]
    bridge.run([*events, event_document(4, "envelope", capture="large", targets=["x" * 30_000])])
    until(lambda: json.loads(retained.get("bridge/place", b"{}")).get("seq") == 4)
    assert json.loads(retained["envelope"])["data"]["capture"] == "c2"  # the broker takes no packet of 30 kB
    assert json.loads(retained["campaign/completed"])["seq"] == 3
    assert json.loads(retained["status"])["data"] == {"state": "idle"}
    assert retained["online"] == b"true"
    bridge.run([None])
    until(lambda: retained["online"] == b"false")
    bridge.close()
    again = MqttBridge(settings)
    assert again.connect() == Place(4, "j")
    again.close()


def test_a_broker_that_is_away_is_waited_for_and_nothing_is_lost(broker, prefix, retained, monkeypatch):
    monkeypatch.setattr(mqtt_bridge, "ACKNOWLEDGE_S", 0.5)
    bridge = MqttBridge(BrokerSettings(port=broker.port, prefix=prefix))
    bridge.connect()
    bridge.run([event_document(1, "fault", message="before")])
    broker.stop()
    work = threading.Thread(
        target=bridge.run, args=([event_document(seq, "fault", message="meanwhile") for seq in (2, 3)],), daemon=True
    )
    work.start()
    time.sleep(0.3)
    assert bridge.published == 1
    broker.start()
    work.join(30)
    assert bridge.published == 3
    until(lambda: json.loads(retained.get("fault", b"{}")).get("seq") == 3)
    bridge.close()


def test_two_bridges_of_one_prefix_are_one_too_many(broker, prefix, retained):
    first, second = (MqttBridge(BrokerSettings(port=broker.port, prefix=prefix)) for _ in range(2))
    first.connect()
    second.connect()
    until(lambda: first._refusal)
    with pytest.raises(BrokerLost, match="another bridge"):
        first.run([event_document(1, "fault", message="x")])
    first.close()
    second.run([event_document(1, "fault", message="x")])
    assert second.published == 1
    until(lambda: retained.get("online") == b"true")
    second.close()


@pytest.mark.parametrize(
    "payload", [b"", b"[1]", b'{"seq": true, "journal": "j"}', b'{"seq": -1, "journal": "j"}', b"\xff", b"[" * 9000]
)
def test_a_place_that_is_none_is_no_place(payload: bytes):
    assert mqtt_bridge._read_place(payload) is None


def test_no_broker_is_one_sentence():
    with pytest.raises(BrokerLost, match="no MQTT broker at 127"):
        MqttBridge(BrokerSettings(port=1)).connect()


@pytest.mark.parametrize("prefix", ["", "a+b", "a/#", "$SYS", "/a", "a/", "x" * 200, "a\0b"])
def test_prefixes_that_are_none(prefix: str):
    with pytest.raises(UsageError):
        BrokerSettings(prefix=prefix)


def test_topics_have_a_level_for_each_part_of_a_kind():
    assert topic_of("a/b", "envelope") == "a/b/envelope"
    assert topic_of("a", "x.+#/.y") == "a/x//y"


def test_a_broker_that_forgets_when_it_is_started_again_gets_the_last_of_each_kind(broker, prefix, tmp_path):
    forgetful = Broker(broker.program, tmp_path, persistence=False)
    forgetful.start()
    settings = BrokerSettings(port=forgetful.port, prefix=prefix)
    bridge = MqttBridge(settings)
    bridge.connect()
    bridge.run([event_document(1, "fault", message="m"), event_document(2, "envelope", capture="c", targets=[])])
    forgetful.stop()
    forgetful.start()
    seen: dict[str, bytes] = {}
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_message = lambda _, __, message: seen.update({message.topic.removeprefix(prefix + "/"): message.payload})
    client.on_connect = lambda *_: client.subscribe(f"{prefix}/#", qos=1)
    client.connect("127.0.0.1", forgetful.port)
    client.loop_start()
    until(lambda: {"fault", "envelope", "bridge/place", "bridge/owner"} <= set(seen))
    assert [json.loads(seen[kind])["seq"] for kind in ("fault", "envelope", "bridge/place")] == [1, 2, 2]
    client.disconnect()
    client.loop_stop()
    bridge.close()
    again = MqttBridge(settings)
    assert again.connect() == Place(2, "j")
    again.close()
    forgetful.stop()
