"""Events for the live page, each with what is shown of it: ``/live/latest`` at the start, then ``/live/events``."""

from __future__ import annotations

import json
from typing import Any

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route

from labdaemon.journal.event import EventText
from labdaemon.stream.command_call import call_command
from labdaemon.web.event_stream import CountedStream, first_seq
from labdaemon.web.live_view import LiveView
from labdaemon.web.web_context import WebContext

_SHOWN_FIRST = ("capture.completed", "envelope")
"""Kinds of which the page shows the last one at once, in this order: the envelope needs what its capture says."""


def live_event_routes(context: WebContext) -> list[Route]:
    """``/live/latest`` and ``/live/events``."""

    async def latest(request: Request) -> JSONResponse:
        found = await _latest(context, request)
        if found is None:
            return JSONResponse({"last": None, "events": []})
        view = LiveView()
        events = [view.view(event) for event in _first(found)]
        return JSONResponse({"last": found["last"], "events": events})

    async def events(request: Request) -> Any:
        try:
            after = first_seq(request.query_params, request.headers.get("last-event-id"))
        except ValueError as exc:
            raise HTTPException(400, str(exc)) from None
        view = LiveView()
        for event in _first(await _latest(context, request) or {}):
            view.view(event)  # its capture may have come before this stream begins, and its envelope come after

        def lines(event: EventText) -> bytes:
            shown = json.dumps(view.view(json.loads(event.json)), separators=(",", ":"))
            return b"id: %d\ndata: %s\n\n" % (event.seq, shown.encode())

        return CountedStream(context, after, lines)

    return [Route("/live/latest", latest), Route("/live/events", events)]


async def _latest(context: WebContext, request: Request) -> dict[str, Any] | None:
    answer = await call_command(context.execute, "events.latest", {}, request.state.role)
    result: dict[str, Any] | None = answer.result if answer.error is None else None
    return result


def _first(found: dict[str, Any]) -> list[dict[str, Any]]:
    events = {event["kind"]: event for event in found.get("events") or ()}
    return [events[kind] for kind in _SHOWN_FIRST if kind in events]
