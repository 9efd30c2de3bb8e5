"""A small client for other programs: commands as calls, events in order with nothing missing.

>>> with Client() as lab:                                        # doctest: +SKIP
...     campaign = lab.call("campaign.submit", toml=text)["campaign"]
...     for event in lab.typed_events():
...         if event.kind == "envelope":
...             print(event.data.capture, len(event.data.targets))

`Client.events` gives the same events as dicts, as they were sent.
"""

from __future__ import annotations

import json
import secrets
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import zmq

from labdaemon.errors import LabdaemonError
from labdaemon.stream import messages
from labdaemon.stream.client_sockets import client_pair, connect, subscribe
from labdaemon.stream.key_files import KeyPair

if TYPE_CHECKING:
    from labdaemon.events import Event

COMMANDS = "tcp://127.0.0.1:5570"
EVENTS = "tcp://127.0.0.1:5571"
"""Where a daemon listens unless its rig file says otherwise."""
SILENT_S = 10.0
"""A daemon whose heartbeat has been missing for so long is gone."""


class NoDaemon(LabdaemonError):
    """No daemon answers at the address."""

    retryable = True


class RemoteError(LabdaemonError):
    """The daemon said no.

    Attributes
    ----------
    code, name
        Of the answer, as -32002 and ``limits``.
    data
        What it sent with the error.
    """

    def __init__(self, error: dict[str, Any]) -> None:
        self.code: int = int(error.get("code", messages.INTERNAL_ERROR))
        self.data: dict[str, Any] = dict(error.get("data") or {})
        self.name: str = str(self.data.get("name", "error"))
        self.retryable: bool = self.code == messages.BUSY
        self.exit_status: int = 2 if self.code in {messages.INVALID_PARAMS, messages.LIMITS} else 1
        super().__init__(str(error.get("message", "the daemon refused")))


class JournalChanged(LabdaemonError):
    """The daemon writes another history than before; the stream continues from that one's beginning."""

    def __init__(self, before: str, now: str) -> None:
        self.before: str = before
        self.now: str = now
        super().__init__(f"the daemon's journal is {now} now, it was {before}: seq starts anew")


class Client:
    """Talks to one daemon. Not for use from several threads at once.

    Parameters
    ----------
    commands, events
        Its addresses.
    timeout_s
        How long a command may take, unless `call` gets another limit.
    key
        File with the client's key (``labdaemon keys make``), or the pair itself; None where the daemon asks for none.

    Raises
    ------
    ConfigError
        The key file is missing, damaged, or others can read it.
    """

    def __init__(
        self,
        commands: str = COMMANDS,
        events: str = EVENTS,
        *,
        timeout_s: float = 10.0,
        key: KeyPair | Path | str | None = None,
    ) -> None:
        self.commands_address: str = commands
        self.events_address: str = events
        self._pair = client_pair(key)
        self.timeout_s = timeout_s
        self._context = zmq.Context()
        self._socket: zmq.Socket[bytes] | None = None
        # Not from 1: an answer to another client that had this one's place must not look like ours.
        self._calls = secrets.randbits(48)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give all sockets back, those of `events` too."""
        self._context.destroy(linger=0)

    def call(self, method: str, *, timeout_s: float | None = None, **params: Any) -> Any:
        """Do a command and return its result.

        Raises
        ------
        RemoteError
            The daemon refused or failed; see its `name`.
        NoDaemon
            No answer in time. Whether the command was done is then unknown, unless it carried a ``request_id`` and is
            sent again.
        """
        self._calls += 1
        socket = self._connected()
        socket.send(messages.request_bytes(method, params, self._calls))
        limit_s = self.timeout_s if timeout_s is None else timeout_s
        deadline = time.monotonic() + limit_s
        while (left_s := deadline - time.monotonic()) > 0:
            if not socket.poll(int(left_s * 1000) + 1):
                break
            answer = json.loads(socket.recv())
            if answer.get("id") != self._calls:
                continue  # the late answer to a call that was given up
            if "error" in answer:
                raise RemoteError(answer["error"])
            return answer.get("result")
        self._drop()
        raise NoDaemon(
            f"no answer from {self.commands_address} within {limit_s:g} s: is `labdaemon run` running there?"
        )

    def events(self, *, after: int | None = None, timeout_s: float = SILENT_S) -> Iterator[dict[str, Any]]:
        """Events from now on (or after a `seq`), in order, none missing, none twice, statuses among them.

        Raises
        ------
        NoDaemon
            Nothing came for `timeout_s`, not even the heartbeat.
        JournalChanged
            The daemon was started on another journal.
        """
        stream = EventStream(self, after=after)
        try:
            while True:
                event = stream.receive(timeout_s)
                if event is None:
                    raise NoDaemon(
                        f"no heartbeat from {self.events_address} for {timeout_s:g} s: has the daemon ended?"
                    )
                yield event
        finally:
            stream.close()

    def typed_events(self, *, after: int | None = None, timeout_s: float = SILENT_S) -> Iterator[Event]:
        """The events of `events` as objects of `labdaemon.events`, statuses among them.

        Raises
        ------
        NoDaemon, JournalChanged
            As `events`.
        DataError
            An event is not what this version knows under its kind: the daemon is of another version.
        """
        from labdaemon.events import parse_event  # the models take longer to load than `labdaemon stop` may take

        for event in self.events(after=after, timeout_s=timeout_s):
            yield parse_event(event)

    def replay(self, after: int, limit: int = 1000) -> dict[str, Any]:
        """``events.replay``: ``events``, ``last`` and ``journal``; ``gone_before`` where history was cut."""
        answer: dict[str, Any] = self.call("events.replay", after=after, limit=limit)
        return answer

    def latest(self) -> dict[str, dict[str, Any]]:
        """``events.latest``: the last event of each kind that there was, by kind."""
        return {event["kind"]: event for event in self.call("events.latest")["events"]}

    def subscribe(self) -> zmq.Socket[bytes]:
        """A raw subscription to everything; the caller closes it."""
        return subscribe(self._context.socket(zmq.SUB), self.events_address, self._pair)

    def _connected(self) -> zmq.Socket[bytes]:
        if self._socket is None:
            self._socket = connect(self._context.socket(zmq.DEALER), self.commands_address, self._pair)
        return self._socket

    def _drop(self) -> None:
        """Forget a connection whose peer is silent, with what is still queued for it."""
        if self._socket is not None:
            self._socket.close(linger=0)
            self._socket = None


class EventStream:
    """The events of a daemon in order: gaps are found by `seq` and filled by ``events.replay``.

    Parameters
    ----------
    client
        Whose addresses it uses, and by whose commands it replays.
    after
        Deliver everything after this `seq`; None for what comes from now on.
    journal
        The history that `after` belongs to, if known.

    Attributes
    ----------
    last
        `seq` of the last event delivered; None before the first message.
    journal
        UUID of the history it follows.
    """

    def __init__(self, client: Client, *, after: int | None = None, journal: str | None = None) -> None:
        self.last: int | None = after
        self.journal: str | None = journal
        self._client = client
        self._socket = client.subscribe()
        self._ready: deque[dict[str, Any]] = deque()

    def receive(self, timeout_s: float) -> dict[str, Any] | None:
        """The next message, or None when none came in time.

        Raises
        ------
        JournalChanged
            Once for each change; the next call continues from the new history's beginning.
        NoDaemon
            A gap could not be filled; the next call tries again.
        """
        deadline = time.monotonic() + timeout_s
        while not self._ready:
            left_s = deadline - time.monotonic()
            if left_s <= 0 or not self._socket.poll(int(left_s * 1000) + 1):
                return None
            self._take(json.loads(self._socket.recv_multipart()[1]))
        event = self._ready.popleft()
        if event["kind"] != "status":
            self.last = event["seq"]
        return event

    def close(self) -> None:
        """End the subscription."""
        self._socket.close(linger=0)

    def _take(self, message: dict[str, Any]) -> None:
        """Queue a message, after whatever was missed before it."""
        journal, seq, is_status = message["journal"], message["seq"], message["kind"] == "status"
        if self.journal is not None and journal != self.journal:
            before, self.journal, self.last = self.journal, journal, 0
            raise JournalChanged(before, journal)
        self.journal = journal
        before_it = seq if is_status else seq - 1
        if self.last is None:
            self.last = before_it
        if self.last < before_it:
            self._replay(before_it)
        if is_status or seq > self.last:
            self._ready.append(message)

    def _replay(self, last: int) -> None:
        """Queue the missed events up to `last`."""
        seq = self.last or 0
        missed: list[dict[str, Any]] = []
        while seq < last:
            answer = self._client.replay(seq, min(1000, last - seq))
            if answer["journal"] != self.journal or not answer["events"]:
                break
            missed += answer["events"]
            seq = missed[-1]["seq"]
        self._ready.extend(missed)
