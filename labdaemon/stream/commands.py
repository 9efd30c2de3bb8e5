"""Commands in: one JSON-RPC request a message, each answered once, whatever else is going on.

Hostile or broken peers cost a bounded amount: frames beyond 1 MiB end the connection, what is no request is answered
with the reason, and no more than `MAX_IN_HAND` commands are worked on at a time, `MAX_OF_ONE` of them one client's
(`stop` is always let through).
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, Protocol

import zmq
import zmq.asyncio

from labdaemon.errors import ConfigError, DeviceError, LabdaemonError
from labdaemon.stream import messages
from labdaemon.stream.messages import BadRequest, InvalidParams, Request
from labdaemon.stream.sockets import ANSWERS_HIGH_WATER, bind

Handler = Callable[[dict[str, Any]], Awaitable[Any]]
"""Takes the params, returns the result, raises a `LabdaemonError`."""

IDEMPOTENT = frozenset({"campaign.submit", "capture"})
"""Commands that take a ``request_id``."""
ALWAYS = frozenset({"stop"})
MAX_IN_HAND = 64
MAX_OF_ONE = 16

log = logging.getLogger(__name__)


class RequestStore(Protocol):
    """Answers by ``request_id``, kept over restarts."""

    def answer(self, request_id: str) -> Any | None:
        """The result that this request had, None if it was never done."""
        ...

    def keep(self, request_id: str, result: Any) -> None:
        """Remember it. Does nothing if it is known already."""
        ...


class MemoryRequests:
    """A `RequestStore` that lasts as long as the process."""

    def __init__(self) -> None:
        self._results: dict[str, Any] = {}

    def answer(self, request_id: str) -> Any | None:
        return self._results.get(request_id)

    def keep(self, request_id: str, result: Any) -> None:
        self._results.setdefault(request_id, result)


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
    """

    def __init__(self, address: str, handlers: Mapping[str, Handler], requests: RequestStore | None = None) -> None:
        self.address = address
        self._handlers = dict(handlers)
        self._requests = requests or MemoryRequests()
        self._under_way: dict[str, asyncio.Future[Any]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._in_hand: Counter[bytes] = Counter()
        self._context = zmq.asyncio.Context()
        self._socket: zmq.asyncio.Socket | None = None

    def bind(self) -> None:
        """Take the address.

        Raises
        ------
        ConfigError
            It is taken.
        """
        self._socket = bind(
            self._context, zmq.ROUTER, self.address, key="service.commands", high_water=ANSWERS_HIGH_WATER
        )
        self.address = self._socket.get_string(zmq.LAST_ENDPOINT)

    async def run(self) -> None:
        """Answer until cancelled."""
        if self._socket is None:
            raise RuntimeError("bind comes before run")
        try:
            while True:
                frames = await self._socket.recv_multipart(copy=False)
                await self._receive(self._socket, [frame.bytes for frame in frames[:4]])
        finally:
            for task in self._tasks:
                task.cancel()

    def close(self) -> None:
        """Send what is answered already and give the address back."""
        if self._socket is not None:
            self._socket.close()
        self._context.term()

    async def _receive(self, socket: zmq.asyncio.Socket, frames: list[bytes]) -> None:
        """Read one message and start on it. Its envelope (a REQ has an empty delimiter) is mirrored."""
        envelope = frames[:2] if len(frames) > 2 and not frames[1] else frames[:1]
        body = frames[len(envelope) :]
        try:
            if len(body) != 1:
                raise BadRequest(messages.INVALID_REQUEST, "a request is one frame")
            request = messages.parse_request(body[0])
        except BadRequest as exc:
            await socket.send_multipart([*envelope, messages.error_bytes(exc.code, str(exc), exc.id)])
            return
        client = envelope[0]
        is_full = len(self._tasks) >= MAX_IN_HAND or self._in_hand[client] >= MAX_OF_ONE
        if is_full and request.method not in ALWAYS:
            answer = messages.error_bytes(messages.BUSY, "too many commands at once; try again", request.id)
            await socket.send_multipart([*envelope, answer])
            return
        task = asyncio.create_task(self._answer(socket, envelope, request))
        self._tasks.add(task)
        self._in_hand[client] += 1
        task.add_done_callback(partial(self._forget, client))

    def _forget(self, client: bytes, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        self._in_hand[client] -= 1
        if not self._in_hand[client]:
            del self._in_hand[client]

    async def _answer(self, socket: zmq.asyncio.Socket, envelope: list[bytes], request: Request) -> None:
        try:
            answer = messages.result_bytes(await self._do(request), request.id)
        except LabdaemonError as exc:
            code = messages.code_of(exc)
            answer = messages.error_bytes(code, str(exc), request.id, **_details(exc))
        except NotImplementedError:
            answer = messages.error_bytes(messages.METHOD_NOT_FOUND, f"no method {request.method[:80]!r}", request.id)
        except Exception:
            log.exception("command %s failed", request.method)
            answer = messages.error_bytes(messages.INTERNAL_ERROR, "the daemon failed; see its log", request.id)
        if not request.is_notification:
            await socket.send_multipart([*envelope, answer])

    async def _do(self, request: Request) -> Any:
        handler = self._handlers.get(request.method)
        if handler is None:
            raise NotImplementedError
        request_id = request.params.get("request_id")
        if request.method not in IDEMPOTENT or request_id is None:
            return await handler(request.params)
        if not isinstance(request_id, str) or not 0 < len(request_id) <= 200:
            raise InvalidParams("request_id is a string of 1 to 200 characters")
        return await self._do_once(request_id, handler, request.params)

    async def _do_once(self, request_id: str, handler: Handler, params: dict[str, Any]) -> Any:
        """Do it unless it was done, or is being done, under this id; a failure is not kept and may be tried again."""
        if request_id in self._under_way:
            return await asyncio.shield(self._under_way[request_id])
        known = self._requests.answer(request_id)
        if known is not None:
            return known
        future = self._under_way[request_id] = asyncio.ensure_future(handler(params))
        try:
            result = await future
        finally:
            del self._under_way[request_id]
        self._requests.keep(request_id, result)
        return result


def _details(error: LabdaemonError) -> dict[str, Any]:
    """What a program may want of an error besides its sentence."""
    if isinstance(error, ConfigError) and error.key is not None:
        return {"key": error.key}
    if isinstance(error, DeviceError) and error.device is not None:
        return {"device": error.device}
    return {}
