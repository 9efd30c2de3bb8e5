"""A small client for other programs: commands as calls, events in order with nothing missing.

>>> with Client() as lab:                                        # doctest: +SKIP
...     campaign = lab.submit(text).campaign
...     for event in lab.typed_events():
...         if event.kind == "envelope":
...             print(event.data.capture, len(event.data.targets))

`Client.events` gives the same events as dicts, as they were sent.
"""

from __future__ import annotations

import json
import logging
import secrets
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import zmq

from labdaemon.stream import messages
from labdaemon.stream.client_errors import (
    ClientClosed,
    HeartbeatLost,
    HistoryCut,
    JournalChanged,
    NoDaemon,
    RemoteError,
    refuse_closed,
)
from labdaemon.stream.client_sockets import client_pair, connect, subscribe
from labdaemon.stream.event_stream import READY_S, EventStream
from labdaemon.stream.key_files import KeyPair
from labdaemon.stream.silence_report import SilenceReport
from labdaemon.stream.typed_commands import TypedCommands

if TYPE_CHECKING:
    from labdaemon.errors import LabdaemonError
    from labdaemon.events import Event

__all__ = [
    "COMMANDS",
    "EVENTS",
    "SILENT_S",
    "Client",
    "ClientClosed",
    "EventStream",
    "HeartbeatLost",
    "HistoryCut",
    "JournalChanged",
    "NoDaemon",
    "RemoteError",
]

log: logging.Logger = logging.getLogger(__name__)

COMMANDS = "tcp://127.0.0.1:5570"
EVENTS = "tcp://127.0.0.1:5571"
"""Where a daemon listens unless its rig file says otherwise."""
SILENT_S = 10.0
"""A daemon whose heartbeat has been missing for so long is gone."""
LOST_S = 3.0
"""A heartbeat that has been missing for so long is reported by `Client.follow`, which waits on."""


class Client(TypedCommands):
    """Talks to one daemon; every command is a method (`TypedCommands`). Not for use from several threads at once.

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
        ClientClosed
            The client was closed meanwhile.
        """
        with refuse_closed():
            return self._ask(method, params, self.timeout_s if timeout_s is None else timeout_s)

    def _ask(self, method: str, params: dict[str, Any], limit_s: float) -> Any:
        self._calls += 1
        socket = self._connected()
        socket.send(messages.request_bytes(method, params, self._calls))
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
        HeartbeatLost
            Nothing came for `timeout_s`, not even the heartbeat.
        JournalChanged, HistoryCut
            The daemon was started on another journal, or the events asked for are no longer kept. `follow` continues.
        """
        with EventStream(self, after=after) as stream:
            while True:
                event = stream.receive(timeout_s)
                if event is None:
                    raise HeartbeatLost(self.events_address, timeout_s)
                yield event

    def listen(self, *, after: int | None = None, timeout_s: float = READY_S) -> EventStream:
        """A stream whose subscription is known to be active when this returns: nothing published later is missed.

        Raises
        ------
        NoDaemon
            No sign of the daemon in time.
        """
        stream = EventStream(self, after=after)
        try:
            stream.wait_ready(timeout_s)
        except BaseException:
            stream.close()
            raise
        return stream

    def follow(
        self, *, after: int | None = None, report: Callable[[LabdaemonError], object] | None = None
    ) -> Iterator[dict[str, Any]]:
        """As `events`, without an end: through silences, restarts of the daemon, other journals and cut history.

        Parameters
        ----------
        report
            Called with each `HeartbeatLost` (once a silence, after 3 s), `JournalChanged` and `HistoryCut`; by default
            they are logged.
        """
        report = report or (lambda trouble: log.warning("%s", trouble))
        silence = SilenceReport(self.events_address, report, LOST_S)
        with EventStream(self, after=after) as stream:
            while True:
                try:
                    event = stream.receive(LOST_S / 6)
                except (JournalChanged, HistoryCut) as exc:
                    report(exc)
                    continue
                except NoDaemon:
                    event = None  # it went away between an event and the replay of those before it
                if event is None:
                    silence.check()
                    continue
                silence.heard()
                yield event

    def typed_events(self, *, after: int | None = None, timeout_s: float = SILENT_S) -> Iterator[Event]:
        """The events of `events` as objects of `labdaemon.events`, statuses among them.

        Raises
        ------
        NoDaemon, JournalChanged, HistoryCut
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
        with refuse_closed():
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
