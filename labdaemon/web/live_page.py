"""The live page: its files are the report's own; they fetch nothing from elsewhere."""

from __future__ import annotations

from functools import cache

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from labdaemon.report.html import live_files

POLICY = "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
"""Scripts, styles and connections of this server alone; nothing inline."""
MEDIA_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
PAGE = "live.html"


def live_routes() -> list[Route]:
    """``/`` and the files that it names."""
    return [Route("/", _index), Route("/live/{name}", _file)]


async def _index(request: Request) -> Response:
    return _answer(PAGE)


async def _file(request: Request) -> Response:
    name = request.path_params["name"]
    return _answer(name) if name in _files() and name != PAGE else Response("no such file\n", 404)


def _answer(name: str) -> Response:
    media_type = f"{MEDIA_TYPES[name.rpartition('.')[2]]}; charset=utf-8"
    headers = {"content-security-policy": POLICY, "cache-control": "no-cache"}
    return Response(_files()[name], media_type=media_type, headers=headers)


@cache
def _files() -> dict[str, bytes]:
    return {name: text.encode() for name, text in live_files().items()}
