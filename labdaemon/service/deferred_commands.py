"""Where commands arrive from the moment the socket is bound, to be carried out once the parts that serve are ready."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from labdaemon.errors import LabdaemonError
from labdaemon.journal import records
from labdaemon.journal.journal import Journal
from labdaemon.stream.dispatcher import Handler
from labdaemon.stream.messages import WrongStateError

PATIENCE_S = 20.0
"""How long a command waits for the daemon to have started; a client that asked as it did is not refused."""

METHODS = (
    "status",
    "rig",
    "campaign.submit",
    "campaign.pause",
    "campaign.resume",
    "campaign.abort",
    "campaign.list",
    "campaign.show",
    "campaign.move",
    "capture",
    "events.replay",
    "events.latest",
    "rpc.discover",
    "stop",
)


class DeferredCommands:
    """Takes commands from the moment the socket is bound, and carries them out once `serve` was called.

    What can be done before that, because it needs neither cameras nor the journal, is handed over by `serve_early`.

    It also knows the replies to earlier requests. Handlers keep those in the journal with the change itself, so that a
    crash cannot come between, and `keep` has nothing left to do.
    """

    def __init__(self) -> None:
        self._opened = asyncio.Event()
        self._handlers: dict[str, Handler] = {}
        self._early: dict[str, Handler] = {}
        self._refusal: Callable[[], LabdaemonError] = lambda: WrongStateError("the daemon is starting")
        self._journal: Journal | None = None

    def serve_early(self, handlers: dict[str, Handler], refusal: Callable[[], LabdaemonError] | None = None) -> None:
        """Carry out these commands until `serve` replaces them: ``stop`` and ``status`` while devices are waited for.

        `refusal` gives the answer to commands that have waited `PATIENCE_S` for `serve`.
        """
        self._early = handlers
        self._refusal = refusal or self._refusal

    def serve(self, handlers: dict[str, Handler], journal: Journal) -> None:
        """Carry out what waits and what comes."""
        self._handlers, self._journal = handlers, journal
        self._opened.set()

    def handlers(self) -> dict[str, Handler]:
        """A handler for every method."""
        return {method: partial(self._do, method) for method in METHODS}

    def answer(self, request_id: str) -> Any | None:
        """The reply that the request had, None if it was never carried out."""
        known = records.reply_to(self._journal, request_id) if self._journal is not None else None
        return known[1] if known is not None else None

    def keep(self, request_id: str, result: Any) -> None:
        """The reply is kept already."""

    async def _do(self, method: str, params: dict[str, Any]) -> Any:
        if not self._opened.is_set() and method in self._early:
            return await self._early[method](params)
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._opened.wait()
        except TimeoutError:
            raise self._refusal() from None
        return await self._handlers[method](params)
