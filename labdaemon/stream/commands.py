"""Commands in: one JSON-RPC request a message, each answered once, however busy the daemon is.

Hostile or broken peers cost a bounded amount: frames beyond 1 MiB end the connection, what is no request is answered
with the reason, and no more than `MAX_IN_PROGRESS` commands are worked on at a time, `MAX_OF_ONE` of them one client's
(`stop` is always let through). Large answers are made one at a time, and only as fast as they are read.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from typing import Any

import zmq
import zmq.asyncio

from labdaemon.off_loop import off_loop
from labdaemon.stream import messages
from labdaemon.stream.dispatcher import CommandDispatcher, Handler, RequestStore
from labdaemon.stream.messages import BadRequestError, RpcRequest
from labdaemon.stream.peer_gate import PeerGate
from labdaemon.stream.roles import Role
from labdaemon.stream.sockets import ANSWERS_HIGH_WATER, ANYBODY, DoorPolicy, bind
from labdaemon.stream.text_limits import INLINE_BYTES
from labdaemon.stream.unread_answers import LARGE_BYTES, UnreadAnswers
from labdaemon.stream.zmtp import message_cost

ReturnRoute = tuple[bytes, ...]
"""Frames that an answer begins with: the client's identity, and what a REQ or proxies have put in front."""

ALWAYS = frozenset({"stop"})
LARGE = frozenset({"events.replay", "events.latest"})
"""Commands whose answers may be megabytes."""
MOST_FRAMES = 8
"""Looked at of a message: identity, what a REQ and some proxies put in front, and the request."""
LONGEST_ROUTE = 255
"""Bytes of each of them but the request: every answer mirrors them."""
MAX_IN_PROGRESS = 64  # each may hold a megabyte of answer
MAX_OF_ONE = 16  # so that one client cannot take all places
TOO_MANY = "too many commands at once; try again"

log: logging.Logger = logging.getLogger(__name__)


class CommandServer:
    """The commands socket.

    Parameters
    ----------
    address
        ``tcp://127.0.0.1:PORT``.
    handlers
        What is done for each method.
    requests
        Where answers are kept for requests that come again.
    policy
        Who gets in. Where keys are asked for, the role is the key's; else everybody is an operator.

    Attributes
    ----------
    dispatcher
        Carries out requests; other ways in use it as well.
    """

    def __init__(
        self,
        address: str,
        handlers: Mapping[str, Handler],
        requests: RequestStore | None = None,
        policy: DoorPolicy = ANYBODY,
    ) -> None:
        self.address: str = address
        self._policy = policy
        self.dispatcher: CommandDispatcher = CommandDispatcher(handlers, requests)
        self._tasks: set[asyncio.Task[None]] = set()
        self._of_client: Counter[bytes] = Counter()
        self._large: set[asyncio.Task[None]] = set()
        self._unread = UnreadAnswers()
        self._turn = asyncio.Lock()
        self._context = zmq.asyncio.Context()
        self._socket: zmq.asyncio.Socket | None = None
        self._gate: PeerGate | None = None

    def bind(self) -> None:
        """Take the address.

        Raises
        ------
        ConfigError
            It is taken.
        """
        self._socket, self._gate = bind(
            self._context,
            zmq.ROUTER,
            self.address,
            key="service.commands",
            high_water=ANSWERS_HIGH_WATER,
            policy=self._policy,
        )
        self.address = self._gate.address

    async def run(self) -> None:
        """Answer until cancelled."""
        if self._gate is None:
            raise RuntimeError("bind comes before run")
        self._gate.open()
        try:
            while True:
                frames = await self._bound.recv_multipart(copy=False)
                try:
                    await self._receive(frames)
                except Exception:  # whatever a peer's frame led to: the next one is received all the same
                    log.exception("a frame could not be received")
                # A socket that has more to read does not let the loop run; a flood must not keep it to itself.
                await asyncio.sleep(0)
        finally:
            for task in self._tasks:
                task.cancel()

    def close(self) -> None:
        """Send what is answered already and give the address back."""
        if self._socket is not None:
            self._socket.close()
        if self._gate is not None:
            self._gate.shut()
        self._context.term()
        if self._gate is not None:
            self._gate.close()

    async def _receive(self, frames: list[zmq.Frame]) -> None:
        """Read one message and start on it; its envelope is mirrored."""
        parts = [frame.bytes for frame in frames[:MOST_FRAMES]]
        route = _route(parts)
        body = parts[len(route) :]
        sender = self._gate.note_received(frames[-1]) if self._gate is not None else None
        done = partial(self._gate.note_done, message_cost(frames[1:])) if self._gate is not None else int
        if len(body) == 1 and len(body[0]) > INLINE_BYTES and not self._is_full(route):
            self._start(route, self._parse_and_answer(route, body.pop(), sender, done))
            return
        done()
        if len(body) == 1 and len(body[0]) > INLINE_BYTES:
            await self._reply(route, messages.error_bytes(messages.BUSY, TOO_MANY, None))
            return
        try:
            if len(body) != 1:
                raise BadRequestError(messages.INVALID_REQUEST, "a request is one frame")
            request = messages.parse_request(body[0])
        except BadRequestError as exc:
            await self._reply(route, messages.error_bytes(exc.code, str(exc), exc.id))
            return
        if self._is_full(route, request.method in LARGE) and request.method not in ALWAYS:
            await self._reply(route, messages.error_bytes(messages.BUSY, TOO_MANY, request.id))
            return
        self._start(route, self._answer(route, request, sender), is_large=request.method in LARGE)

    def _is_full(self, route: ReturnRoute, is_large: bool = False) -> bool:
        """Whether a command has no place. Those with large answers may wait long, and take no other's."""
        queued = len(self._large) if is_large else len(self._tasks) - len(self._large)
        return queued >= MAX_IN_PROGRESS or self._of_client[route[0]] >= MAX_OF_ONE

    def _start(self, route: ReturnRoute, work: Coroutine[Any, Any, None], *, is_large: bool = False) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        if is_large:
            self._large.add(task)
        self._of_client[route[0]] += 1
        task.add_done_callback(partial(self._forget, route[0]))

    def _forget(self, client: bytes, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        self._large.discard(task)
        self._of_client[client] -= 1
        if not self._of_client[client]:
            del self._of_client[client]
        if not task.cancelled() and task.exception() is not None:
            log.error("an answer could not be sent", exc_info=task.exception())

    async def _parse_and_answer(
        self, route: ReturnRoute, body: bytes, sender: str | None, done: Callable[[], object]
    ) -> None:
        """A long request, a campaign most likely: parsed off the event loop; `done` once its bytes are let go."""
        try:
            request = await off_loop(messages.parse_request, body)
        except BadRequestError as exc:
            await self._reply(route, messages.error_bytes(exc.code, str(exc), exc.id))
            return
        finally:
            del body
            done()
        await self._answer(route, request, sender)

    async def _answer(self, route: ReturnRoute, request: RpcRequest, sender: str | None) -> None:
        if request.method not in LARGE:
            await self._reply_to(route, request, await self._outcome(request, sender))
            return
        while True:
            if not await self._unread.wait_for_room(route[0]):
                busy = messages.error_bytes(messages.BUSY, "read the earlier answers first; try again", request.id)
                await self._reply_to(route, request, busy)
                return
            async with self._turn:
                if self._unread.has_room(route[0]):  # another answer of this client may have taken it meanwhile
                    await self._reply_to(route, request, await self._outcome(request, sender))
                    return

    async def _outcome(self, request: RpcRequest, sender: str | None) -> bytes:
        """The answer; the role is the one that the sender's key has now, not when it connected."""
        access = self._policy.access
        role = Role.OPERATOR if access is None else access.role_of(sender) if sender is not None else None
        return await self.dispatcher.answer(request, role)

    async def _reply_to(self, route: ReturnRoute, request: RpcRequest, answer: bytes) -> None:
        if not request.is_notification:
            await self._reply(route, answer)

    async def _reply(self, route: ReturnRoute, answer: bytes) -> None:
        if len(answer) < LARGE_BYTES:
            await self._bound.send_multipart([*route, answer])
            return
        # Not copied, and tracked: libzmq holds it until the peer has read, and what one may make it hold is bounded.
        parts = [*route, zmq.Frame(answer, track=True)]
        tracker = await self._bound.send_multipart(parts, copy=False, track=True)
        if tracker is not None:
            self._unread.add(route[0], len(answer), tracker)

    @property
    def _bound(self) -> zmq.asyncio.Socket:
        if self._socket is None:
            raise RuntimeError("bind comes before run")
        return self._socket


def _route(parts: list[bytes]) -> ReturnRoute:
    """The frames that an answer begins with: the client's identity, and all up to an empty one where there is one.

    A REQ has an empty frame before its request; one that knows late answers by a number (``REQ_CORRELATE``) has that
    number before it, and proxies on the way put theirs in front (https://rfc.zeromq.org/spec/28).
    """
    end = parts.index(b"", 1, -1) + 1 if b"" in parts[1:-1] else 1
    return tuple(parts[: end if max(map(len, parts[:end])) <= LONGEST_ROUTE else 1])
