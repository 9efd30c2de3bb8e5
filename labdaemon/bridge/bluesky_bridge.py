"""Documents on ZeroMQ as bluesky's ``RemoteDispatcher`` reads them, and the place of a bridge that is started again."""

from __future__ import annotations

import json
import pickle
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

import zmq

from labdaemon.bridge.bluesky_documents import Document, DocumentMaker
from labdaemon.bridge.follow import Place
from labdaemon.bridge.open_documents import OpenDocuments
from labdaemon.durable import write_durably
from labdaemon.errors import UsageError

Serializer: TypeAlias = Literal["pickle", "json"]
HIGH_WATER = 100_000
LINGER_MS = 2000
MAX_BYTES = 1024
"""Of a message from a dispatcher; a subscription is some bytes. A peer that sends more is hung up on."""
SUBSCRIPTION, END = b"\x01", b"\x00"
READ_AT_A_TIME = 100
ALL = b" "
"""What every message begins with: an empty prefix, and the space after it."""
NEWCOMER = b"newcomer"
"""Prefix of what one newcomer alone gets. A dispatcher that was given no prefix takes any."""
SERIALIZERS: dict[Serializer, Callable[[Any], bytes]] = {
    "pickle": pickle.dumps,  # what a dispatcher expects unless it is given another deserializer
    "json": lambda document: json.dumps(document).encode(),
}


class DocumentPublisher:
    """A socket that documents are published on; who comes in the middle of a run gets that run from its start.

    Behind a proxy newcomers cannot be seen: it subscribes once for all of them.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``: bound, for dispatchers to connect to; or a proxy's, which is connected to.
    is_proxy
        Whether the address is a ``bluesky-0MQ-proxy``'s.
    serializer
        How documents become bytes.

    Raises
    ------
    UsageError
        The address is taken, or none.
    """

    def __init__(self, address: str, *, is_proxy: bool = False, serializer: Serializer = "pickle") -> None:
        self._serialize = SERIALIZERS[serializer]
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.XPUB)
        self._socket.set(zmq.SNDHWM, HIGH_WATER)
        self._socket.set(zmq.LINGER, LINGER_MS)
        self._socket.set(zmq.MAXMSGSIZE, MAX_BYTES)
        self._socket.set(zmq.XPUB_MANUAL, 1)  # each subscription is made here, so that one can be spoken to alone
        self._open = OpenDocuments()
        try:
            if is_proxy:
                self._socket.connect(address)
            else:
                self._socket.bind(address)
        except zmq.ZMQError as exc:
            self._context.destroy(linger=0)
            raise UsageError(f"{address} cannot be used: {exc.strerror}") from None
        self.address: str = self._socket.get_string(zmq.LAST_ENDPOINT).rstrip("\0")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy()

    def wait_for_subscriber(self, timeout_s: float | None = None) -> bool:
        """Wait for the first one. Other messages are none."""
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while end_s is None or time.monotonic() <= end_s:
            left_ms = None if end_s is None else max(round((end_s - time.monotonic()) * 1000), 0)
            if self._socket.poll(left_ms) and self._admit(self._socket.recv()):
                return True
        return False

    def greet(self) -> None:
        """Send newcomers the runs that are open. Call it every second or so; `publish` does it as well."""
        for _ in range(READ_AT_A_TIME):
            if not self._socket.poll(0):
                break
            self._admit(self._socket.recv())

    def publish(self, document: Document) -> None:
        """Send one document."""
        self.greet()
        self._socket.send(self.remember(document))

    def remember(self, document: Document) -> bytes:
        """Keep a document for newcomers, and return its message; for those that were published before a restart."""
        name, content = document
        message = ALL + name.encode() + b" " + self._serialize(content)
        self._open.add(name, content, message)
        return message

    def _admit(self, change: bytes) -> bool:
        """Do what a peer asks for; whether it was a subscription to documents."""
        kind, topic = change[:1], change[1:] or ALL
        if not topic.startswith(ALL):
            return False
        if kind == END:
            self._socket.set(zmq.UNSUBSCRIBE, topic)
        if kind != SUBSCRIPTION:
            return False
        if change == SUBSCRIPTION:  # who asks for some documents only takes no other prefix
            # Made for the peer whose subscription was received last, so no other gets what is for this one.
            self._socket.set(zmq.SUBSCRIBE, NEWCOMER)
            for message in self._open.messages():
                self._socket.send(NEWCOMER + message)
            self._socket.set(zmq.UNSUBSCRIBE, NEWCOMER)
        self._socket.set(zmq.SUBSCRIBE, topic)
        return True


@dataclass(frozen=True, slots=True)
class BridgePlace:
    """Where a bridge was.

    Attributes
    ----------
    published
        The last event whose documents were published.
    before_open
        Just before the oldest run that was open then: the events of open runs are read again, so that counts go on.
    """

    published: Place
    before_open: Place


def read_place(path: Path) -> BridgePlace | None:
    """The place that a state file holds; None where there is none.

    Raises
    ------
    UsageError
        The file is another.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        journal, seq, before = found["journal"], found["seq"], found["before_open"]
        if not (isinstance(journal, str) and type(seq) is int and type(before) is int and 0 <= before <= seq):
            raise ValueError
    except FileNotFoundError:  # the first time there is no place yet
        return None
    except (OSError, ValueError, KeyError, TypeError):
        raise UsageError(f"{path} is no state of a bridge; name another file, or remove it") from None
    return BridgePlace(Place(seq, journal), Place(before, journal))


def publish_events(
    events: Iterable[dict[str, Any] | None],
    maker: DocumentMaker,
    publish: Callable[[Document], None],
    *,
    place: BridgePlace | None = None,
    state: Path | None = None,
    remember: Callable[[Document], object] = bool,
    greet: Callable[[], object] = bool,
) -> None:
    """Make documents of events and publish them, until the events end.

    Parameters
    ----------
    events
        From `place.before_open` on; statuses and silence (None) among them.
    place
        Documents of events up to its `published` are made, and not published again.
    state
        File that the place is kept in; nothing is kept where it is None.
    remember
        Called with the documents that are not published again.
    greet
        Called at each event, status and silence: it lets newcomers in.

    Raises
    ------
    StorageError
        The state cannot be written.
    """
    for event in events:
        greet()
        if event is None or event["kind"] == "status":
            continue
        is_known = place is not None and event["journal"] == place.published.journal
        is_published = is_known and place is not None and event["seq"] <= place.published.seq
        documents = list(maker.feed(event))
        for document in documents:
            (remember if is_published else publish)(document)
        if is_published:
            continue
        if state is not None and documents:
            open_seq = maker.first_open_seq
            before = event["seq"] if open_seq is None else open_seq - 1
            kept = {"journal": event["journal"], "seq": event["seq"], "before_open": before}
            write_durably(state, json.dumps(kept))
