"""The client for programs with an event loop of their own: commands and events that are awaited.

>>> async with AsyncClient() as lab:                             # doctest: +SKIP
...     await lab.capture(label="first")
...     async for event in lab.events():
...         print(event["kind"])
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import zmq
import zmq.asyncio

from labdaemon.stream import messages
from labdaemon.stream.client import COMMANDS, EVENTS, LOST_S, SILENT_S
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
from labdaemon.stream.event_order import EventOrder, Message
from labdaemon.stream.event_stream import READY_S, REPLAYED_AT_A_TIME
from labdaemon.stream.key_files import KeyPair
from labdaemon.stream.silence_report import SilenceReport
from labdaemon.stream.typed_commands import AsyncTypedCommands

if TYPE_CHECKING:
    from labdaemon.errors import LabdaemonError
    from labdaemon.events import Event

log: logging.Logger = logging.getLogger(__name__)


class AsyncClient(AsyncTypedCommands):
    """Talks to one daemon from one event loop; any number of commands may be awaited at once.

    Parameters
    ----------
    commands, events, timeout_s, key
        As `labdaemon.Client`.

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
        self.timeout_s: float = timeout_s
        self._pair = client_pair(key)
        self._context = zmq.asyncio.Context()
        self._socket: zmq.asyncio.Socket | None = None
        self._reader: asyncio.Task[None] | None = None
        self._calls = secrets.randbits(48)  # as of `Client`
        self._waiting: dict[int, asyncio.Future[Any]] = {}

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Give all sockets back, those of event streams too; what still waits ends with `ClientClosed`."""
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(ClientClosed())
        if self._reader is not None:
            self._reader.cancel()
            with suppress(asyncio.CancelledError):
                await self._reader
        self._context.destroy(linger=0)

    async def call(self, method: str, *, timeout_s: float | None = None, **params: Any) -> Any:
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
        self._calls += 1
        number = self._calls
        answer = self._waiting[number] = asyncio.get_running_loop().create_future()
        limit_s = self.timeout_s if timeout_s is None else timeout_s
        try:
            async with asyncio.timeout(limit_s):
                with refuse_closed():
                    await self._connected().send(messages.request_bytes(method, params, number))
                return await answer
        except TimeoutError:
            self._drop()
            raise NoDaemon(
                f"no answer from {self.commands_address} within {limit_s:g} s: is `labdaemon run` running there?"
            ) from None
        finally:
            del self._waiting[number]

    async def replay(self, after: int, limit: int = REPLAYED_AT_A_TIME) -> dict[str, Any]:
        """``events.replay``: ``events``, ``last`` and ``journal``; ``gone_before`` where history was cut."""
        answer: dict[str, Any] = await self.call("events.replay", after=after, limit=limit)
        return answer

    async def listen(self, *, after: int | None = None, timeout_s: float = READY_S) -> AsyncEventStream:
        """A stream whose subscription is known to be active when this returns.

        Raises
        ------
        NoDaemon
            No sign of the daemon in time.
        """
        stream = AsyncEventStream(self, after=after)
        try:
            await stream.wait_ready(timeout_s)
        except BaseException:
            stream.close()
            raise
        return stream

    async def events(self, *, after: int | None = None, timeout_s: float = SILENT_S) -> AsyncIterator[Message]:
        """Events from now on (or after a `seq`), in order, none missing, none twice, statuses among them.

        Raises
        ------
        HeartbeatLost
            Nothing came for `timeout_s`, not even the heartbeat.
        JournalChanged, HistoryCut
            The daemon was started on another journal, or the events asked for are no longer kept.
        """
        stream = AsyncEventStream(self, after=after)
        try:
            while True:
                event = await stream.receive(timeout_s)
                if event is None:
                    raise HeartbeatLost(self.events_address, timeout_s)
                yield event
        finally:
            stream.close()

    async def follow(
        self, *, after: int | None = None, report: Callable[[LabdaemonError], object] | None = None
    ) -> AsyncIterator[Message]:
        """As `events`, without an end: through silences, restarts of the daemon, other journals and cut history.

        Parameters
        ----------
        after, report
            As of `labdaemon.Client.follow`.
        """
        report = report or (lambda trouble: log.warning("%s", trouble))
        silence = SilenceReport(self.events_address, report, LOST_S)
        stream = AsyncEventStream(self, after=after)
        try:
            while True:
                try:
                    event = await stream.receive(LOST_S / 6)
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
        finally:
            stream.close()

    async def typed_events(self, *, after: int | None = None, timeout_s: float = SILENT_S) -> AsyncIterator[Event]:
        """The events of `events` as objects of `labdaemon.events`, statuses among them.

        Raises
        ------
        NoDaemon, JournalChanged, HistoryCut
            As `events`.
        DataError
            An event is not what this version knows under its kind: the daemon is of another version.
        """
        from labdaemon.events import parse_event  # the models take half a second to load

        async for event in self.events(after=after, timeout_s=timeout_s):
            yield parse_event(event)

    def subscribe(self) -> zmq.asyncio.Socket:
        """A raw subscription to everything; the caller closes it."""
        with refuse_closed():
            return subscribe(self._context.socket(zmq.SUB), self.events_address, self._pair)

    def _connected(self) -> zmq.asyncio.Socket:
        if self._socket is None:
            self._socket = connect(self._context.socket(zmq.DEALER), self.commands_address, self._pair)
            self._reader = asyncio.create_task(self._read(self._socket))
        return self._socket

    def _drop(self) -> None:
        """Forget a connection whose peer is silent, unless others still wait for it."""
        if self._socket is not None and len(self._waiting) == 1:
            if self._reader is not None:
                self._reader.cancel()
            self._socket.close(linger=0)
            self._socket = self._reader = None

    async def _read(self, socket: zmq.asyncio.Socket) -> None:
        while True:
            document = json.loads(await socket.recv())
            waiting = self._waiting.get(document.get("id"))
            if waiting is None or waiting.done():
                continue  # the late answer to a call that was given up
            if "error" in document:
                waiting.set_exception(RemoteError(document["error"]))
            else:
                waiting.set_result(document.get("result"))


class AsyncEventStream:
    """The events of a daemon in order, through its restarts; as `labdaemon.stream.event_stream.EventStream`.

    Parameters
    ----------
    client
        Whose addresses it uses, and by whose commands it replays.
    after
        Deliver everything after this `seq`; None for what comes from now on.
    """

    def __init__(self, client: AsyncClient, *, after: int | None = None) -> None:
        self._client, self._order = client, EventOrder(after)
        self._socket = client.subscribe()
        self._message: Message | None = None

    async def wait_ready(self, timeout_s: float = READY_S) -> None:
        """Wait until the subscription is known to be active.

        Raises
        ------
        NoDaemon
            No sign of the daemon in time.
        """
        if self._message is None and not await self._read(timeout_s):
            raise NoDaemon(f"no events from {self._client.events_address} within {timeout_s:g} s: is a daemon there?")

    async def receive(self, timeout_s: float) -> Message | None:
        """The next message, or None when none came in time.

        Raises
        ------
        JournalChanged, HistoryCut
            Once for each change; the next call continues with the first event that there is.
        NoDaemon
            A gap could not be filled; the next call tries again.
        ClientClosed
            The client was closed meanwhile.
        """
        while (event := self._order.pop()) is None:
            if self._message is None and not await self._read(timeout_s):
                return None
            await self._take()
        return event

    def close(self) -> None:
        """End the subscription."""
        self._socket.close(linger=0)

    async def _read(self, timeout_s: float) -> bool:
        try:
            with refuse_closed():
                if not await self._socket.poll(int(timeout_s * 1000) + 1):
                    return False
                self._message = json.loads((await self._socket.recv_multipart())[1])
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if self._socket.closed and task is not None and not task.cancelling():
                raise ClientClosed from None  # pyzmq cancels what waits on a socket that is closed
            raise
        return True

    async def _take(self) -> None:
        message = self._message
        if message is None:
            return
        missing = self._order.missing(message)
        if missing is not None:
            seq, last = missing
            while seq < last:
                answer = await self._client.replay(seq, min(REPLAYED_AT_A_TIME, last - seq))
                found = self._order.add_replayed(answer, seq)
                if found is None:
                    break
                seq = found
        self._order.add(message)
        self._message = None
