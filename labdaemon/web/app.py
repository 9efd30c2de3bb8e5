"""The application: what is answered under which path."""

from __future__ import annotations

import json
import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp

from labdaemon.off_loop import off_loop
from labdaemon.report.envelope_csv import envelope_csv
from labdaemon.stream import messages
from labdaemon.stream.command_call import CommandAnswer, call_command, last_of_kind
from labdaemon.stream.roles import Role
from labdaemon.stream.text_limits import bounded_text, parse_json, surrogate_in
from labdaemon.web.event_stream import CountedStream, first_seq
from labdaemon.web.guard import RequestGuard
from labdaemon.web.live_events import live_event_routes
from labdaemon.web.live_frame import live_frame_route
from labdaemon.web.live_page import live_routes
from labdaemon.web.web_context import WebContext

MAX_BODY_BYTES = 1 << 20
STATUS_OF = {
    messages.PARSE_ERROR: 400,
    messages.INVALID_REQUEST: 400,
    messages.METHOD_NOT_FOUND: 404,
    messages.INVALID_PARAMS: 400,
    messages.BUSY: 503,
    messages.FORBIDDEN: 403,
    messages.LIMITS: 422,
    messages.NOT_FOUND: 404,
    messages.WRONG_STATE: 409,
    messages.DEVICE: 502,
}
"""Code of a command's error -> status; 500 for others."""

log: logging.Logger = logging.getLogger(__name__)


def make_app(context: WebContext, pages: Sequence[BaseRoute] = ()) -> ASGIApp:
    """The application.

    Parameters
    ----------
    pages
        Further routes, as of a live page; they are guarded like all others.
    """
    routes = [
        *live_event_routes(context),  # before the page's files, whose path has any name
        live_frame_route(context),
        *live_routes(),
        Route("/status", _reading(context, "status")),
        Route("/campaigns", _reading(context, "campaign.list")),
        Route("/latest", _reading(context, "events.latest")),
        Route("/rig", _reading(context, "rig")),
        Route("/openrpc.json", _reading(context, "rpc.discover")),
        Route("/latest/envelope.csv", _latest_csv(context)),
        Route("/latest/envelope.json", _latest_json(context)),
        Route("/events", _events(context)),
        Route("/command/{name}", _command(context), methods=["POST"]),
        Route("/rpc", _rpc(context), methods=["POST"]),
        *pages,
    ]
    app = Starlette(routes=routes, exception_handlers=HANDLERS)
    return RequestGuard(app, context.access, context.peers)


Endpoint = Callable[[Request], Awaitable[Any]]


def _reading(context: WebContext, method: str) -> Endpoint:
    async def answer(request: Request) -> Response:
        return _answer(await call_command(context.execute, method, {}, request.state.role))

    return answer


async def _last_envelope(context: WebContext, role: Role) -> dict[str, Any]:
    answer = await call_command(context.execute, "events.latest", {}, role)
    if answer.error is not None:
        raise HTTPException(STATUS_OF.get(answer.error["code"], 500), bounded_text(answer.error["message"], 500))
    event = last_of_kind(answer.result["events"], "envelope")
    if event is None:
        raise HTTPException(404, "there is no envelope yet")
    return event


def _latest_csv(context: WebContext) -> Endpoint:
    async def answer(request: Request) -> Response:
        event = await _last_envelope(context, request.state.role)
        return _tagged(request, event, (await off_loop(envelope_csv, event)).encode(), "text/csv; charset=utf-8")

    return answer


def _latest_json(context: WebContext) -> Endpoint:
    async def answer(request: Request) -> Response:
        event = await _last_envelope(context, request.state.role)
        return _tagged(request, event, json.dumps(event).encode(), "application/json")

    return answer


def _tagged(request: Request, event: dict[str, Any], content: bytes, media_type: str) -> Response:
    """With the event's identity as tag, so that whoever asks again and again gets it once."""
    tag = f'"{event.get("journal")}-{event["seq"]}"'
    headers = {"etag": tag, "cache-control": "no-cache"}
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return Response(content, media_type=media_type, headers=headers)


def _events(context: WebContext) -> Endpoint:
    async def answer(request: Request) -> Any:
        try:
            after = first_seq(request.query_params, request.headers.get("last-event-id"))
        except ValueError as exc:
            raise HTTPException(400, str(exc)) from None
        return CountedStream(context, after)

    return answer


def _command(context: WebContext) -> Endpoint:
    async def answer(request: Request) -> Response:
        body = await _operators_body(request, context)
        try:
            params = parse_json(body) if body.strip() else {}
        except ValueError as exc:
            raise HTTPException(400, f"not JSON: {bounded_text(exc, 200)}") from None
        if not isinstance(params, dict):
            raise HTTPException(400, "parameters are a JSON object")
        if (where := surrogate_in(params)) is not None:
            raise HTTPException(400, f"{bounded_text(where)} is no text: it has half a surrogate pair")
        return _answer(await call_command(context.execute, request.path_params["name"], params, request.state.role))

    return answer


def _rpc(context: WebContext) -> Endpoint:
    async def answer(request: Request) -> Response:
        body = await _operators_body(request, context)
        try:
            call = messages.parse_request(body)
        except messages.BadRequestError as exc:
            return Response(messages.error_bytes(exc.code, str(exc), exc.id), 400, media_type="application/json")
        content = await context.execute(call, request.state.role)
        if call.is_notification:
            return Response(status_code=204)
        return Response(content, media_type="application/json")

    return answer


async def _operators_body(request: Request, context: WebContext) -> bytes:
    """The body of an operator's request.

    Raises
    ------
    HTTPException
        The client is none, or the body is too long or no JSON by its type.
    """
    if context.access.operator is None:
        raise HTTPException(403, "commands need a token; name its file under [web] token_file")
    if request.state.role is not Role.OPERATOR or "authorization" not in request.headers:
        raise HTTPException(403, "commands are for operators: send Authorization: Bearer TOKEN")
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise HTTPException(415, "send Content-Type: application/json")
    if int(request.headers.get("content-length", "0")) > MAX_BODY_BYTES:
        raise HTTPException(413, f"a body has at most {MAX_BODY_BYTES} bytes")
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY_BYTES:
            raise HTTPException(413, f"a body has at most {MAX_BODY_BYTES} bytes")
    return bytes(body)


def _answer(answer: CommandAnswer) -> Response:
    if answer.error is None:
        return Response(json.dumps({"result": answer.result}).encode(), media_type="application/json")
    code = answer.error.get("code")
    status = STATUS_OF.get(code, 500) if isinstance(code, int) else 500
    headers = {"retry-after": "1"} if status == 503 else {}
    return Response(json.dumps({"error": answer.error}).encode(), status, headers, "application/json")


async def _refuse(request: Request, exc: Exception) -> Response:
    assert isinstance(exc, HTTPException)
    return PlainTextResponse(f"{exc.detail}\n", exc.status_code, headers=exc.headers)


async def _leave(request: Request, exc: Exception) -> Response:
    """The client has left in the middle of its request; this answer reaches no one."""
    return Response(status_code=400)


async def _fail(request: Request, exc: Exception) -> Response:
    log.error("%s failed", request.url.path[:80], exc_info=exc)
    return PlainTextResponse("the daemon failed; see its log\n", 500)


HANDLERS: dict[Any, Callable[[Request, Exception], Awaitable[Response]]] = {
    HTTPException: _refuse,
    ClientDisconnect: _leave,
    Exception: _fail,
}
