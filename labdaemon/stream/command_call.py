"""A command from a client that is not on the commands socket: called, and answered as an object."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

from labdaemon.off_loop import off_loop
from labdaemon.stream.messages import RpcRequest
from labdaemon.stream.roles import Role

Execute: TypeAlias = Callable[[RpcRequest, Role], Awaitable[bytes]]
"""Carries a request out for a client of this role, and returns the JSON-RPC answer, whatever happens."""
INLINE_BYTES = 16 << 10
"""Longer answers are read off the event loop."""


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """How a command ended.

    Attributes
    ----------
    result
        Of a command that was carried out.
    error
        ``code``, ``message`` and ``data`` of one that was not; None otherwise.
    """

    result: Any = None
    error: dict[str, Any] | None = None


async def call_command(execute: Execute, method: str, params: dict[str, Any], role: Role) -> CommandAnswer:
    """Carry out one command."""
    answer = await execute(RpcRequest(method, params, 1, is_notification=False), role)
    document = json.loads(answer) if len(answer) <= INLINE_BYTES else await off_loop(json.loads, answer)
    return CommandAnswer(document.get("result"), document.get("error"))


def last_of_kind(events: Iterable[dict[str, Any]], kind: str) -> dict[str, Any] | None:
    """The event of a kind among the last ones (``events.latest``)."""
    return next((event for event in events if event["kind"] == kind), None)
