"""From a request to its answer, the same for every way in: ZeroMQ, HTTP and the text gateway.

Each way in reads requests in its own manner and knows the role of its client; permissions, request ids and errors are
handled here, once.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol

from labdaemon.errors import ConfigError, DeviceError, LabdaemonError, RestUnconfirmed
from labdaemon.stream import messages
from labdaemon.stream.messages import InvalidParamsError, RpcRequest, UnknownMethodError
from labdaemon.stream.roles import Role, check_role
from labdaemon.stream.text_limits import bounded_text

Handler = Callable[[dict[str, Any]], Awaitable[Any]]
"""Takes the params, returns the result, raises a `LabdaemonError`."""

IDEMPOTENT = frozenset({"campaign.submit", "capture"})
"""Commands that take a ``request_id``."""
COMMAND_S = 600.0
"""No command takes longer; one that does has lost what it waited for, and gives its place back."""

log: logging.Logger = logging.getLogger(__name__)


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


class CommandDispatcher:
    """Carries out requests.

    Parameters
    ----------
    handlers
        What is done for each method.
    requests
        Where answers are kept for requests that come again.
    """

    def __init__(self, handlers: Mapping[str, Handler], requests: RequestStore | None = None) -> None:
        self._handlers = dict(handlers)
        self._requests = requests or MemoryRequests()
        self._in_progress: dict[str, asyncio.Future[Any]] = {}

    async def handle(self, request: RpcRequest, role: Role | None) -> Any:
        """Carry out a request of a client with this role, and return the result.

        Returns
        -------
        Any
            What the handler returns: JSON-able, or a `RawJson`.

        Raises
        ------
        UnknownMethodError
            There is no such method.
        ForbiddenError
            The role may not give this command.
        LabdaemonError
            The command was refused or failed; `labdaemon.stream.messages.code_of` gives its code.
        """
        handler = self._handlers.get(request.method)
        if handler is None:
            raise UnknownMethodError(f"no method {bounded_text(request.method, 80)!r}")
        check_role(request.method, role)
        request_id = request.params.get("request_id")
        async with asyncio.timeout(COMMAND_S):
            if request.method not in IDEMPOTENT or request_id is None:
                return await handler(request.params)
            if not isinstance(request_id, str) or not 0 < len(request_id) <= 200:
                raise InvalidParamsError("request_id is a string of 1 to 200 characters")
            return await self._do_once(request_id, handler, request.params)

    async def answer(self, request: RpcRequest, role: Role | None) -> bytes:
        """The same as the JSON-RPC answer, whatever happens: no kind of exception may leave a client without one."""
        try:
            return messages.result_bytes(await self.handle(request, role), request.id)
        except LabdaemonError as exc:
            return messages.error_bytes(messages.code_of(exc), bounded_text(exc, 2000), request.id, **_details(exc))
        except BaseException as exc:
            task = asyncio.current_task()
            if isinstance(exc, asyncio.CancelledError) and task is not None and task.cancelling():
                raise  # the daemon ends
            log.error("command %s failed", request.method, exc_info=exc)
            return messages.error_bytes(messages.INTERNAL_ERROR, "the daemon failed; see its log", request.id)

    async def _do_once(self, request_id: str, handler: Handler, params: dict[str, Any]) -> Any:
        """Do it unless it was done, or is being done, under this id; a failure is not kept and may be tried again."""
        if request_id in self._in_progress:
            return await asyncio.shield(self._in_progress[request_id])
        known = self._requests.answer(request_id)
        if known is not None:
            return known
        future = self._in_progress[request_id] = asyncio.ensure_future(handler(params))
        try:
            result = await future
        finally:
            del self._in_progress[request_id]
        self._requests.keep(request_id, result)
        return result


def _details(error: LabdaemonError) -> dict[str, Any]:
    """Members of an error for programs; its sentence is for people."""
    if isinstance(error, ConfigError) and error.key is not None:
        return {"key": error.key}
    if isinstance(error, DeviceError) and error.device is not None:
        return {"device": error.device}
    if isinstance(error, RestUnconfirmed):
        return {"table": error.table}
    return {}
