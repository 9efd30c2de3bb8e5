"""Events out: what the journal has committed, in order, each once, with a status every second as heartbeat.

The journal is the outbox. The publisher only ever sends what it reads back from there, so an event is on disk before
a subscriber gets it, and a subscriber that missed some finds them by `seq` and asks ``events.replay``.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import zmq
import zmq.asyncio

from labdaemon.clock import Clock, rfc3339
from labdaemon.errors import StorageUnavailable
from labdaemon.journal.event import EventText
from labdaemon.plain_json import dump_json
from labdaemon.stream.messages import InvalidParamsError, RawJson
from labdaemon.stream.peer_gate import PeerGate
from labdaemon.stream.sockets import ANYBODY, EVENTS_HIGH_WATER, DoorPolicy, bind
from labdaemon.stream.text_limits import bounded_text

log: logging.Logger = logging.getLogger(__name__)

STATUS_PERIOD_S = 1.0  # the heartbeat that subscribers count on
GREETING_PAUSE_S = 0.02  # a new subscriber's status waits for the rest of its subscriptions
GREETED_AT_A_TIME = 1000
"""Between two answers to new subscriptions, and how many one answer is for: a flood of them costs little."""
BATCH = 32  # events sent between two turns of the loop
BATCH_BYTES = 1 << 20
"""Events, and bytes of them, read from the outbox at a time: a millisecond or two of the event loop."""
MAX_REPLAY = 1000  # of one answer; a client asks again for what follows
MAX_REPLAY_BYTES = 1 << 20
"""An answer stays below this, so that a client far behind asks several times instead of choking the daemon once. Four
times as much reads a night no faster, and on a busy machine a stop meanwhile takes twice as long."""


class Outbox(Protocol):
    """Where committed events are read from: the journal."""

    @property
    def uuid(self) -> str:
        """The journal's identity."""
        ...

    @property
    def last_seq(self) -> int:
        """`seq` of the last committed event, 0 before the first."""
        ...

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        """Committed events with a larger `seq`, ascending, at most `limit` and `most_bytes` (but one at least)."""
        ...

    def history(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        """The same from any thread, however long it takes, in nothing else's way."""
        ...

    def latest(self) -> list[EventText]:
        """The last committed event of each kind, ascending; from any thread, as `history`."""
        ...


class EventPublisher:
    """The events socket.

    Parameters
    ----------
    address
        ``tcp://127.0.0.1:PORT``.
    outbox
        The journal.
    status
        Called every second for the heartbeat's ``data``; ``campaign`` in it is also the message's own.
    clock
        Stamps the status.
    policy
        Who gets in.
    """

    def __init__(
        self,
        address: str,
        outbox: Outbox,
        status: Callable[[], dict[str, Any]],
        clock: Clock,
        policy: DoorPolicy = ANYBODY,
    ) -> None:
        self.address: str = address
        self._policy = policy
        self._outbox, self._status, self._clock = outbox, status, clock
        self._context = zmq.asyncio.Context()
        self._socket: zmq.asyncio.Socket | None = None
        self._gate: PeerGate | None = None
        self._changed = asyncio.Event()
        self._sent = outbox.last_seq
        self._is_unread = False

    def bind(self) -> None:
        """Take the address.

        Raises
        ------
        ConfigError
            It is taken.
        """
        self._socket, self._gate = bind(
            self._context,
            zmq.XPUB,
            self.address,
            key="service.events",
            high_water=EVENTS_HIGH_WATER,
            policy=self._policy,
        )
        self.address = self._gate.address

    def wake(self) -> None:
        """Something was committed: send it now. Cheap; call it on the loop's thread."""
        self._changed.set()

    async def run(self) -> None:
        """Publish until cancelled."""
        if self._gate is not None:
            self._gate.open()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._greet())
            tasks.create_task(self._publish())

    async def _publish(self) -> None:
        loop = asyncio.get_running_loop()
        status_due = loop.time()
        while True:
            self._changed.clear()
            with self._waiting_for_disk():
                await self._send_committed()
            if loop.time() >= status_due:
                with self._waiting_for_disk():
                    await self._send_status()
                status_due = max(status_due + STATUS_PERIOD_S, loop.time())
            try:
                async with asyncio.timeout_at(status_due):
                    await self._changed.wait()
            except TimeoutError:  # nothing was committed: the next status is due
                pass

    @contextmanager
    def _waiting_for_disk(self) -> Iterator[None]:
        """A journal that cannot be read now is read at the next heartbeat; the log has it once."""
        try:
            yield
        except StorageUnavailable as exc:
            if not self._is_unread:
                log.warning("events wait: %s", exc)
            self._is_unread = True
        else:
            self._is_unread = False

    async def _send_committed(self) -> None:
        while events := self._outbox.recent(self._sent, BATCH, BATCH_BYTES):
            for event in events:
                await self._bound.send_multipart([event.kind.encode(), event.json])
                self._sent = event.seq
            await asyncio.sleep(0)

    async def _send_status(self) -> None:
        """The heartbeat. Its `seq` is the last one sent before it on this socket, so a gap shows at once."""
        data = self._status()
        message = {
            "v": 1,
            "seq": self._sent,
            "at": rfc3339(self._clock.now()),
            "kind": "status",
            "campaign": data.get("campaign"),
            "journal": self._outbox.uuid,
            "data": data,
        }
        await self._bound.send_multipart([b"status", dump_json(message).encode()])

    async def _greet(self) -> None:
        """Answer each new subscription with a status, so that a client knows at once where the history stands."""
        while True:
            is_new = self._note_change(await self._bound.recv_multipart(copy=False))
            for _ in range(GREETED_AT_A_TIME):
                if not await self._bound.poll(0):
                    break
                is_new |= self._note_change(await self._bound.recv_multipart(copy=False))
            if is_new:
                with self._waiting_for_disk():
                    await self._send_status()
                await asyncio.sleep(GREETING_PAUSE_S)

    def _note_change(self, frames: list[zmq.Frame]) -> bool:
        """Whether it is a new subscription."""
        if self._gate is not None:
            self._gate.note_received(frames[0])
            self._gate.count_topic(frames[0])
        return frames[0].bytes[:1] == b"\x01"

    @property
    def _bound(self) -> zmq.asyncio.Socket:
        if self._socket is None:
            raise RuntimeError("bind comes before run")
        return self._socket

    def close(self) -> None:
        """Deliver what was sent and give the address back."""
        if self._socket is not None:
            self._socket.close()
        if self._gate is not None:
            self._gate.shut()
        self._context.term()
        if self._gate is not None:
            self._gate.close()


def replay(outbox: Outbox, params: dict[str, Any]) -> RawJson:
    """Answer ``events.replay``. Reads the disk: call it off the event loop.

    Parameters
    ----------
    params
        ``after`` (default 0) and ``limit`` (default and at most 1000; fewer may come, so ask until `last` is reached).

    Returns
    -------
    RawJson
        An object of ``events`` with a larger `seq`, ascending; ``last``, the journal's last `seq`; ``journal``, its
        UUID; and ``gone_before``, the first `seq` that is left, where events after `after` were cut from the journal.

    Raises
    ------
    InvalidParamsError
        `after` or `limit` is no number of events.
    """
    after, limit = params.get("after", 0), params.get("limit", MAX_REPLAY)
    for name, value in (("after", after), ("limit", limit)):
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 62:
            raise InvalidParamsError(f"{name} is a whole number from 0, not {bounded_text(value)}")
    last = outbox.last_seq
    events = outbox.history(after, min(limit, MAX_REPLAY), MAX_REPLAY_BYTES) if limit else []
    last = max(last, events[-1].seq if events else 0)
    about: dict[str, Any] = {"last": last, "journal": outbox.uuid}
    first_left = events[0].seq if events else last + 1
    if limit and first_left > after + 1:
        about["gone_before"] = first_left
    return _answer(events, about)


def latest(outbox: Outbox, params: dict[str, Any]) -> RawJson:
    """Answer ``events.latest``: the last event of each kind. Reads the disk: call it off the event loop.

    Returns
    -------
    RawJson
        An object of ``events``, ascending by `seq`, at most one of each kind; ``last``, the journal's last `seq`; and
        ``journal``, its UUID. A status is in no journal: ask ``status``.
    """
    events = outbox.latest()
    last = max(outbox.last_seq, events[-1].seq if events else 0)
    return _answer(events, {"last": last, "journal": outbox.uuid})


def _answer(events: list[EventText], about: dict[str, Any]) -> RawJson:
    """An object of ``events`` and the members of `about`; events stay the JSON that they are."""
    parts = [b'{"events": [']
    for event in events:
        parts += (event.json, b",")
    if events:
        parts.pop()
    return RawJson((*parts, b"], " + json.dumps(about)[1:].encode()))
