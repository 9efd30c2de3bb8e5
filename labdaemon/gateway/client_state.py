"""What the text gateway knows of one client: role, statements, errors, and the captures that are being fired for it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from dataclasses import dataclass
from typing import Any

from labdaemon.gateway.capture_settings import CaptureSettings
from labdaemon.gateway.scpi_errors import OPERATION_COMPLETE, POWER_ON, ErrorQueue, ScpiError, error_of_answer
from labdaemon.stream.access_token import AccessToken
from labdaemon.stream.command_call import CommandAnswer, Execute, call_command
from labdaemon.stream.event_feed import EventFeed
from labdaemon.stream.roles import Role

MOST_TRIGGERS = 4
"""Captures of one client that are being fired."""
MOST_ATTEMPTS = 3
"""Wrong tokens after which a connection ends."""
WRONG_TOKEN_S = 0.5


@dataclass(frozen=True, slots=True)
class GatewayAccess:
    """Who a client is before and after it has said a token.

    Attributes
    ----------
    token
        That makes an operator; None where none is set.
    role
        Without a token; None where nothing is allowed before one was said.
    """

    token: AccessToken | None
    role: Role | None


@dataclass(frozen=True, slots=True)
class GatewayContext:
    """What all clients share.

    Attributes
    ----------
    execute
        Carries commands out.
    feed
        Committed events.
    access
        Who may what.
    identity
        The answer to ``*IDN?``.
    """

    execute: Execute
    feed: EventFeed
    access: GatewayAccess
    identity: str


class EndOfSession(Exception):
    """The client has lost its connection by what it sent."""


class ClientState:
    """One client.

    Parameters
    ----------
    context
        What all clients share.

    Attributes
    ----------
    role
        What it may do; None before it has said a token that is needed.
    settings
        What it states of its captures.
    errors
        Its error queue.
    event_status
        Its standard event status register.
    enabled
        Masks of ``*ESE`` and ``*SRE``.
    fired
        Name and opening of its last capture; None before the first.
    new_line
        Set by the connection when a line has come: a query that waits is interrupted by it (-410).
    """

    def __init__(self, context: GatewayContext) -> None:
        self.context = context
        self.role: Role | None = context.access.role
        self.settings: CaptureSettings = CaptureSettings()
        self.errors: ErrorQueue = ErrorQueue()
        self.event_status: int = POWER_ON
        self.enabled: dict[str, int] = {"*ESE": 0, "*SRE": 0}
        self.fired: tuple[str | None, str | None] | None = None
        self.new_line: asyncio.Event = asyncio.Event()
        self._attempts = 0
        self._triggers: set[asyncio.Task[None]] = set()
        self._stop: asyncio.Task[CommandAnswer] | None = None
        self._is_complete_wanted = False

    @property
    def is_waiting(self) -> bool:
        """Whether something is being done for it."""
        return bool(self._triggers) or (self._stop is not None and not self._stop.done())

    def record(self, error: ScpiError) -> None:
        """Put an error into the queue, and its bit into the event status register."""
        self.errors.add(error)
        self.event_status |= error.event_bit

    def clear(self) -> None:
        """``*CLS``."""
        self.errors.clear()
        self.event_status = 0
        self._is_complete_wanted = False

    async def authorise(self, word: str) -> None:
        """Make it an operator.

        Raises
        ------
        ScpiError
            The word is not the token (-203), or none is set.
        EndOfSession
            It was wrong too often.
        """
        token = self.context.access.token
        if token is None:
            raise ScpiError(-221, "no token is set")
        if token.matches(word):
            self.role = Role.OPERATOR
            return
        self._attempts += 1
        await asyncio.sleep(WRONG_TOKEN_S)
        if self._attempts >= MOST_ATTEMPTS:
            raise EndOfSession("wrong tokens")
        raise ScpiError(-203, "wrong token")

    async def call(self, method: str, **params: Any) -> Any:
        """The result of one command.

        Raises
        ------
        ScpiError
            The daemon refused, or failed.
        """
        answer = await call_command(self.context.execute, method, params, self.role or Role.OBSERVER)
        return _result_of(answer)

    def start_stop(self) -> None:
        """Stop the table at once, whatever lines are still before this one; `stop` then waits for it."""
        if self.role is not None and (self._stop is None or self._stop.done()):
            self._stop = asyncio.create_task(call_command(self.context.execute, "stop", {}, self.role))

    async def stop(self) -> Any:
        """The result of the stop that was started, or of another one.

        Raises
        ------
        ScpiError
            As `call`.
        """
        started, self._stop = self._stop, None
        return _result_of(await started) if started is not None else await self.call("stop")

    async def trigger(self, params: dict[str, Any]) -> None:
        """Begin to fire a capture.

        Raises
        ------
        ScpiError
            Too many are being fired (-211).
        """
        if len(self._triggers) >= MOST_TRIGGERS:
            raise ScpiError(-211, f"{MOST_TRIGGERS} captures of this connection wait already")
        task = asyncio.create_task(self._fire(params))
        self._triggers.add(task)
        task.add_done_callback(self._trigger_done)
        # The command is on its way before the next unit, so that none of those reaches the table first.
        await asyncio.sleep(0)

    async def all_fired(self) -> None:
        """Wait until no capture is being fired."""
        while self._triggers:
            await asyncio.wait(set(self._triggers))

    async def uninterrupted(self, work: Awaitable[Any]) -> Any:
        """What a query waits for, unless the next line comes first.

        Raises
        ------
        ScpiError
            It came (-410).
        """
        task = asyncio.ensure_future(work)
        line = asyncio.create_task(self.new_line.wait())
        try:
            await asyncio.wait([task, line], return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            raise ScpiError(-410, "the next line came before this query was answered")
        finally:
            task.cancel()
            line.cancel()

    def want_complete(self) -> None:
        """``*OPC``: set the bit when no capture is being fired."""
        self._is_complete_wanted = True
        self._note_complete()

    async def _fire(self, params: dict[str, Any]) -> None:
        try:
            result = await self.call("capture", **params)
        except ScpiError as exc:
            self.record(exc)
        else:
            self.fired = (result.get("capture"), result.get("opened_at"))

    def _trigger_done(self, task: asyncio.Task[None]) -> None:
        self._triggers.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self.record(ScpiError(-310, "the capture failed; see the daemon's log"))
        self._note_complete()

    def _note_complete(self) -> None:
        if self._is_complete_wanted and not self._triggers:
            self._is_complete_wanted = False
            self.event_status |= OPERATION_COMPLETE


def _result_of(answer: CommandAnswer) -> Any:
    if answer.error is not None:
        raise error_of_answer(answer.error)
    return answer.result
