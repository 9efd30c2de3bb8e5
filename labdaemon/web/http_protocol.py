"""uvicorn's HTTP/1.1 protocol with bounds in time and number; h11 bounds and checks what a request may look like."""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import suppress
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from labdaemon.stream.listener import watch_peer
from labdaemon.stream.peer_log import PeerLog

MOST_CONNECTIONS = 64
REQUEST_S = 15.0
"""A request has to come whole within this time."""
READS_S = 15.0
"""A client that does not read its answer for so long loses its connection."""
IDLE_S = 5.0
"""A connection that was silent for so long gives its place to a newcomer when all are taken."""
WRITE_BYTES = 64 << 10
PART_BYTES = 8 << 10
BYTES_PER_S = 2 << 20
"""How fast one connection is read in the long run: a flood leaves the interpreter to the rig."""
BURST_BYTES = 2 << 20

_silent = logging.getLogger("labdaemon.web.uvicorn")
_silent.addHandler(logging.NullHandler())
_silent.propagate = False


class BoundedHttpProtocol(H11Protocol):
    """One connection.

    Attributes
    ----------
    peers
        Where trouble with clients is logged: one line a peer and minute.
    active_s
        When bytes last came, on the monotonic clock.
    """

    peers: PeerLog = PeerLog(logging.getLogger(__name__), "web")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.logger: logging.Logger = _silent  # uvicorn has a line for every bad request; ours are counted
        self.access_log: bool = False
        self.active_s: float = time.monotonic()
        self._request_timer: asyncio.TimerHandle | None = None
        self._write_timer: asyncio.TimerHandle | None = None
        self._pace_timer: asyncio.TimerHandle | None = None
        self._tokens = float(BURST_BYTES)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a newcomer, at the cost of an idle connection where all places are taken."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=WRITE_BYTES)
        with suppress(OSError):  # it has left already
            watch_peer(transport.get_extra_info("socket"), is_written_to=True)
        self._request_timer = self.loop.call_later(REQUEST_S, self._give_up, "no whole request in time")
        if len(self.connections) > MOST_CONNECTIONS and not self._make_room():
            self._give_up(f"refused: all {MOST_CONNECTIONS} places are taken")

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget all that was to come."""
        for timer in (self._request_timer, self._write_timer, self._pace_timer):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes; a request that begins with them has a deadline."""
        now_s = time.monotonic()
        self._tokens = min(self._tokens + (now_s - self.active_s) * BYTES_PER_S, BURST_BYTES) - len(data)
        self.active_s = now_s
        for start in range(0, len(data), PART_BYTES):  # h11 bounds only what is not whole when it looks
            super().data_received(data[start : start + PART_BYTES])
            if self.transport.is_closing():
                return
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            if self._request_timer is None:
                self._request_timer = self.loop.call_later(REQUEST_S, self._give_up, "no whole request in time")
        elif self._request_timer is not None:
            self._request_timer.cancel()
            self._request_timer = None
        if self._tokens < 0 and self._pace_timer is None:
            self.flow.pause_reading()
            self._pace_timer = self.loop.call_later(-self._tokens / BYTES_PER_S, self._read_again)

    def pause_writing(self) -> None:
        """The client does not read."""
        super().pause_writing()
        if self._write_timer is None:
            self._write_timer = self.loop.call_later(READS_S, self._give_up, "it did not read its answer")

    def resume_writing(self) -> None:
        """It reads again."""
        super().resume_writing()
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None

    def send_400_response(self, msg: str) -> None:
        """What is no HTTP is answered once, unless an answer has begun, and noted once a minute."""
        self.peers.warn(self._host(), "what it sent is no HTTP request")
        cycle = self.cycle
        if cycle is not None and not cycle.response_complete:
            # Its body turned out to be none: whoever still makes the answer has no one to send it to.
            cycle.disconnected = True
            cycle.message_event.set()
        try:
            super().send_400_response(msg)
        except h11.LocalProtocolError:  # an answer has begun, or was sent before the request's end
            self.transport.close()

    def _read_again(self) -> None:
        self._pace_timer = None
        self.flow.resume_reading()

    def _give_up(self, why: str) -> None:
        if not self.transport.is_closing():
            self.peers.warn(self._host(), f"connection ended: {why}")
        self.transport.abort()

    def _make_room(self) -> bool:
        now_s = time.monotonic()
        idle = [one for one in self.connections if isinstance(one, BoundedHttpProtocol) and one.is_idle]
        longest = min(idle, key=lambda one: one.active_s, default=None)
        if longest is None or now_s - longest.active_s < IDLE_S:
            return False
        longest.transport.abort()
        return True

    @property
    def is_idle(self) -> bool:
        """Whether no answer is being made or sent."""
        return self.cycle is None or self.cycle.response_complete

    def _host(self) -> str:
        return self.client[0] if self.client else "a client"
