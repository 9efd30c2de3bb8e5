"""``GET /events``: committed events as server-sent events, from any `seq`."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable, Mapping
from typing import Protocol

from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from labdaemon.errors import StorageUnavailable
from labdaemon.journal.event import EventText
from labdaemon.stream.event_feed import EventFeed
from labdaemon.web.web_context import WebContext

HEARTBEAT_S = 5.0
RETRY_MS = 1000
"""How soon a browser connects again."""
DISK_S = 1.0
LONGEST_SEQ = 1 << 62
MOST_STREAMS = 32


class EndSignal(Protocol):
    """Knows that the server ends."""

    def is_set(self) -> bool:
        """Whether it does."""
        ...

    async def wait(self) -> object:
        """Return when it does."""
        ...


def first_seq(query: Mapping[str, str], last_event_id: str | None) -> int | None:
    """After which `seq` a client wants events: what its browser has seen comes before what its address says.

    Raises
    ------
    ValueError
        It is no number of events.
    """
    given = last_event_id if last_event_id else query.get("after")
    if given is None:
        return None
    if not given.isascii() or not given.isdigit() or len(given) > 19 or int(given) > LONGEST_SEQ:
        raise ValueError("after is a whole number from 0")
    return int(given)


def event_lines(event: EventText) -> bytes:
    """An event with its `seq` as id. Its JSON has no line ends."""
    return b"id: %d\nevent: %s\ndata: %s\n\n" % (event.seq, event.kind.encode(), event.json)


class EventStreamResponse:
    """An answer that does not end.

    Parameters
    ----------
    feed
        The events.
    after
        Send everything after this `seq`; None for what comes from now on.
    closing
        Set when the server ends.
    lines
        Makes the lines of an event; its own JSON by default.
    """

    def __init__(
        self,
        feed: EventFeed,
        after: int | None,
        closing: EndSignal,
        lines: Callable[[EventText], bytes] = event_lines,
    ) -> None:
        self._feed, self._after, self._closing, self._lines = feed, after, closing, lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until the client leaves or the server ends."""
        headers = [(b"content-type", b"text/event-stream; charset=utf-8"), (b"x-accel-buffering", b"no")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        left = asyncio.create_task(_until_left(receive))
        closed = asyncio.create_task(_until(self._closing))
        parts = self._parts()
        try:
            while not (left.done() or closed.done()):
                step = asyncio.ensure_future(anext(parts))
                await asyncio.wait([step, left, closed], return_when=asyncio.FIRST_COMPLETED)
                if not step.done():
                    step.cancel()
                    await asyncio.gather(step, return_exceptions=True)
                    break
                await send({"type": "http.response.body", "body": step.result(), "more_body": True})
        finally:
            for task in (left, closed):
                task.cancel()
            await asyncio.gather(left, closed, return_exceptions=True)
            await parts.aclose()
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _parts(self) -> AsyncGenerator[bytes]:
        feed = self._feed
        last = feed.last_seq
        seq = last if self._after is None else self._after
        is_reset = seq > last
        if is_reset:  # the client knows another journal's future: this one is sent from its beginning
            seq = 0
        about = {"journal": feed.journal, "last": last, "after": seq, "reset": is_reset}
        yield b"retry: %d\nevent: journal\ndata: %s\n\n" % (RETRY_MS, json.dumps(about).encode())
        while True:
            try:
                async with asyncio.timeout(HEARTBEAT_S):
                    events = await feed.after(seq)
            except TimeoutError:
                yield b": heartbeat\n\n"
                continue
            except StorageUnavailable:
                await asyncio.sleep(DISK_S)
                yield b": the disk is waited for\n\n"
                continue
            if events[0].seq > seq + 1:  # what was between was cut from the journal
                yield b'event: gone\ndata: {"gone_before": %d}\n\n' % events[0].seq
            for event in events:
                yield self._lines(event)
                seq = event.seq


async def _until_left(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        continue


async def _until(closing: EndSignal) -> None:
    await closing.wait()


class CountedStream(Response):
    """An event stream that is counted while it is sent.

    Parameters
    ----------
    context
        The server's.
    after, lines
        As for `EventStreamResponse`.

    Raises
    ------
    HTTPException
        There are too many streams already.
    """

    def __init__(
        self, context: WebContext, after: int | None, lines: Callable[[EventText], bytes] = event_lines
    ) -> None:
        super().__init__()
        if context.streams >= MOST_STREAMS:
            raise HTTPException(503, f"all {MOST_STREAMS} event streams are taken")
        self._context = context
        self._stream = EventStreamResponse(context.feed, after, context.closing, lines)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it; a HEAD gets its headers alone."""
        if scope["method"] == "HEAD":
            await super().__call__(scope, receive, send)
            return
        self._context.streams += 1
        try:
            await self._stream(scope, receive, send)
        finally:
            self._context.streams -= 1
