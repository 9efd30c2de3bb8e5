"""Events to an MQTT broker: the last one of each kind is retained, and each is delivered once or, after a crash, again.

The bridge keeps its place on the broker itself: a retained message with journal and `seq` follows each event, so a
bridge that is started anew, on any machine, continues there. A broker that has forgotten what it retained, as one
without persistence does when it is started again, gets the last of each kind once more.
"""

from __future__ import annotations

import json
import logging
import secrets
import threading
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.properties import Properties

from labdaemon.bridge.follow import Place
from labdaemon.errors import LabdaemonError, UsageError

CONNECT_S = 10.0
PLACE_S = 5.0
"""How long the broker may take to send what is retained."""
ACKNOWLEDGE_S = 20.0
LONGEST_PREFIX = 100

log: logging.Logger = logging.getLogger(__name__)


class BrokerLost(LabdaemonError):
    """The broker does not answer, or refuses."""

    retryable = True


@dataclass(frozen=True, slots=True)
class BrokerSettings:
    """Which broker, and as whom.

    Attributes
    ----------
    host, port
        Of the broker.
    prefix
        First part of all topics.
    username, password
        Where the broker wants them.
    tls
        Encrypted, with the system's certificates.
    """

    host: str = "127.0.0.1"
    port: int = 1883
    prefix: str = "labdaemon"
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: bool = False

    def __post_init__(self) -> None:
        prefix = self.prefix
        if not prefix or len(prefix) > LONGEST_PREFIX or prefix[0] in "$/" or prefix[-1] == "/":
            raise UsageError(f"{prefix!r} is no prefix of a topic; write a word, or words between slashes")
        if any(letter in "+#" or not letter.isprintable() for letter in prefix):
            raise UsageError(f"{prefix!r} has a character that no topic may have")


def topic_of(prefix: str, kind: str) -> str:
    """Topic of a kind of event.

    >>> topic_of("lab", "campaign.started")
    'lab/campaign/started'
    """
    levels = [part for part in kind.split(".") if part]
    return "/".join([prefix, *("".join(one for one in level if one not in "+#/\0") for level in levels)])


class MqttBridge:
    """A connection to a broker.

    Parameters
    ----------
    settings
        Which one.

    Attributes
    ----------
    published
        Events that the broker has acknowledged.
    """

    def __init__(self, settings: BrokerSettings) -> None:
        self._settings = settings
        self._id = secrets.token_hex(8)
        self._is_announced = False
        self.published: int = 0
        self._is_connected = threading.Event()
        self._place: Place | None = None
        self._has_place = threading.Event()
        self._refusal = ""
        self._most_bytes: int | None = None
        self._is_daemon_heard: bool | None = None
        self._retained: dict[str, bytes] = {}
        """What the broker should have retained, by topic."""
        self._is_retained = True
        self._order = threading.Lock()
        client = paho.Client(CallbackAPIVersion.VERSION2, f"labdaemon-{self._id}", protocol=MQTTProtocolVersion.MQTTv5)
        if settings.username is not None:
            client.username_pw_set(settings.username, settings.password)
        if settings.tls:
            client.tls_set()
        client.will_set(self._topic("online"), b"false", qos=1, retain=True)
        client.reconnect_delay_set(1, 10)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        self._client = client

    def connect(self) -> Place | None:
        """Connect; the place where an earlier bridge was, None where there was none.

        Raises
        ------
        BrokerLost
            There is no broker, or it refuses.
        """
        try:
            self._client.connect(
                self._settings.host, self._settings.port, keepalive=15, clean_start=True, properties=None
            )
        except (OSError, ValueError) as exc:
            raise BrokerLost(f"no MQTT broker at {self._settings.host}:{self._settings.port} ({exc})") from None
        self._client.loop_start()
        if not self._is_connected.wait(CONNECT_S):
            raise BrokerLost(self._refusal or f"the broker did not answer within {CONNECT_S:g} s")
        self._has_place.wait(PLACE_S)
        return self._place

    def close(self) -> None:
        """Say that the bridge is gone, and disconnect."""
        if self._is_connected.is_set() and not self._refusal:
            self._publish(self._topic("online"), b"false", 2.0)
        self._client.disconnect()
        self._client.loop_stop()

    def run(self, events: Iterable[dict[str, Any] | None]) -> None:
        """Pass events on until they end.

        Raises
        ------
        BrokerLost
            Another bridge has the same prefix, or the broker refuses for good.
        """
        for event in events:
            if self._refusal:
                raise BrokerLost(self._refusal)
            self._note_daemon(event is not None)
            if event is None:
                continue
            if event["kind"] == "status":
                # The next one comes in a second: it is neither waited for nor kept while the broker is away.
                if self._is_connected.is_set():
                    self._client.publish(self._topic("status"), _payload(event), qos=0, retain=True)
                continue
            self.pass_on(event)

    def pass_on(self, event: dict[str, Any]) -> None:
        """One event, and the place after it. Waits for the broker, however long that is away.

        Raises
        ------
        BrokerLost
            The broker refuses for good.
        """
        payload = _payload(event)
        if self._most_bytes is not None and len(payload) + 200 > self._most_bytes:
            log.error(
                "event %d has %d bytes, the broker takes %d: left out", event["seq"], len(payload), self._most_bytes
            )
        else:
            self._deliver(topic_of(self._settings.prefix, event["kind"]), payload)
        place = {"journal": event["journal"], "seq": event["seq"]}
        self._deliver(self._topic("bridge/place"), json.dumps(place).encode())
        self.published += 1

    def _deliver(self, topic: str, payload: bytes) -> None:
        while not self._publish(topic, payload, ACKNOWLEDGE_S):
            if self._refusal:
                raise BrokerLost(self._refusal)
            self._is_connected.wait(ACKNOWLEDGE_S)

    def _publish(self, topic: str, payload: bytes, within_s: float) -> bool:
        """Whether the broker has acknowledged it in time. What it has not is sent by the next try."""
        if not self._is_connected.is_set():
            return False
        with self._order:
            self._retained[topic] = payload
            info = self._client.publish(topic, payload, qos=1, retain=True)
        try:
            info.wait_for_publish(within_s)
            return info.is_published()
        except (RuntimeError, ValueError):  # not connected now, or its queue is full
            return False

    def _note_daemon(self, is_heard: bool) -> None:
        """A retained status says nothing of a daemon that has ended: ``online`` does."""
        if is_heard != self._is_daemon_heard and self._is_connected.is_set():
            self._client.publish(self._topic("online"), b"true" if is_heard else b"false", qos=1, retain=True)
            self._is_daemon_heard = is_heard

    def _topic(self, rest: str) -> str:
        return f"{self._settings.prefix}/{rest}"

    def _on_connect(self, client: paho.Client, _: Any, flags: Any, reason: Any, properties: Properties | None) -> None:
        if reason.is_failure:
            self._refusal = f"the broker refuses: {reason}"
            return
        self._most_bytes = getattr(properties, "MaximumPacketSize", None)
        self._is_daemon_heard = None
        client.subscribe([(self._topic("bridge/place"), 1), (self._topic("bridge/owner"), 1)])
        if not self._is_announced:
            # Comes back after what was retained: then it is known whether there was a place.
            client.publish(self._topic("bridge/owner"), self._id.encode(), qos=1, retain=True)
        else:
            self._is_retained = False
            echo = self._topic(f"bridge/echo/{self._id}")
            client.subscribe(echo, 1)
            client.publish(echo, b"", qos=1)  # comes back after what was retained, if anything was
        self._is_connected.set()

    def _on_disconnect(self, client: paho.Client, _: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._is_connected.clear()
        if reason.is_failure and not self._refusal:
            log.warning("the broker is away (%s); events wait", reason)

    def _on_message(self, client: paho.Client, _: Any, message: paho.MQTTMessage) -> None:
        """What was retained. Whoever may write to the broker may write here: it is looked at, not trusted."""
        if message.topic == self._topic("bridge/owner"):
            self._note_owner(bytes(message.payload))
        elif message.topic == self._topic("bridge/place") and message.retain:
            self._is_retained = True
            if not self._is_announced:
                self._place = _read_place(bytes(message.payload))
        elif message.topic.startswith(self._topic("bridge/echo/")) and not self._is_retained:
            self._restore(client)

    def _restore(self, client: paho.Client) -> None:
        """Publish anew what a broker has forgotten."""
        log.warning("the broker has forgotten what it retained; the last of each kind is published again")
        self._is_retained = True
        with self._order:
            for topic, payload in [(self._topic("bridge/owner"), self._id.encode()), *self._retained.items()]:
                client.publish(topic, payload, qos=1, retain=True)

    def _note_owner(self, owner: bytes) -> None:
        """The bridge that came last has the prefix; two would publish each event twice and move one another's place."""
        if owner == self._id.encode():
            self._is_announced = True
            self._has_place.set()
        elif self._is_announced:
            self._refusal = f"another bridge has the prefix {self._settings.prefix} now; give one of them another"


def _read_place(payload: bytes) -> Place | None:
    try:
        found = json.loads(payload)
        seq, journal = found["seq"], found["journal"]
    except (ValueError, TypeError, KeyError, RecursionError):
        # another program's message under our topic: it is no place
        return None
    return Place(seq, journal) if isinstance(journal, str) and type(seq) is int and 0 <= seq < 1 << 62 else None


def _payload(event: dict[str, Any]) -> bytes:
    return json.dumps(event, separators=(",", ":")).encode()
