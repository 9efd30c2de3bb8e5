"""What every request has to pass, whatever it asks for: the right host, no page of another site, a role.

A page of any site can make a browser on this machine send requests here. It cannot read the answers (there are no CORS
headers), it must not cause anything (requests that say an origin, or another site, are refused unless they are this
server's own reads), and by a name that it lets point to this machine it gets nowhere (the host is checked).
"""

from __future__ import annotations

import asyncio
import base64
import binascii
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import ip_address

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from labdaemon.stream.access_token import AccessToken
from labdaemon.stream.pace import Pace
from labdaemon.stream.peer_log import PeerLog
from labdaemon.stream.roles import Role

WRONG_TOKEN_S = 0.5
REQUESTS_PER_S = 200.0
BURST = 100.0
"""Of all that are no operators together: a flood leaves the interpreter to the rig."""
HEADERS = {
    "cache-control": "no-store",
    "content-security-policy": "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}
"""Of every answer; a page may set its own content security policy."""
READS = frozenset({"GET", "HEAD"})


@dataclass(frozen=True, slots=True)
class WebAccess:
    """Who may what.

    Attributes
    ----------
    hosts
        Names, without port, under which the server may be asked.
    operator, observer
        Tokens; None where none is set.
    is_open
        Whether reading needs no token.
    takes_numbers
        Whether it may also be asked under any address in numbers. A page's own name cannot be one, so this lets no
        rebinding in.
    """

    hosts: frozenset[str]
    operator: AccessToken | None
    observer: AccessToken | None
    is_open: bool
    takes_numbers: bool = False

    def is_host(self, name: str) -> bool:
        """Whether the server may be asked under this name."""
        if name in self.hosts:
            return True
        try:
            ip_address(name)
        except ValueError:
            return False
        return self.takes_numbers

    def role_of(self, scheme: str, word: str) -> Role | None:
        """The role that a word gives; None for a wrong one.

        A password that a browser remembers (``basic``) reads only: it is sent along whatever page asks.
        """
        if self.operator is not None and self.operator.matches(word):
            return Role.OPERATOR if scheme == "bearer" else Role.OBSERVER
        if self.observer is not None and self.observer.matches(word):
            return Role.OBSERVER
        return None


class RequestGuard:
    """Middleware in front of everything.

    Parameters
    ----------
    app
        What is guarded.
    access
        Who may what.
    peers
        Where refusals are logged.
    """

    def __init__(self, app: ASGIApp, access: WebAccess, peers: PeerLog) -> None:
        self._app, self._access, self._peers = app, access, peers
        self._pace = Pace(REQUESTS_PER_S, BURST)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or pass it on with ``state.role``."""
        if scope["type"] != "http":
            return
        headers = Headers(scope=scope)

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                sent = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    sent.setdefault(name, value)
            await send(message)

        refusal = self._refusal(scope["method"], headers)
        role: Role | None = None
        if refusal is None:
            role, refusal = await self._role(headers)
        if role is not Role.OPERATOR:
            await self._pace.take(1.0)
        if refusal is not None:
            status, text = refusal
            client = scope.get("client")
            self._peers.warn(client[0] if client else "a client", f"{status}: {text}")
            more = {"www-authenticate": 'Basic realm="labdaemon", charset="UTF-8"'} if status == 401 else {}
            answer = PlainTextResponse(text + "\n", status, headers=more)
            await answer(scope, receive, send_guarded)
            return
        scope.setdefault("state", {})["role"] = role
        await self._app(scope, receive, send_guarded)

    def _refusal(self, method: str, headers: Headers) -> tuple[int, str] | None:
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self._access.is_host(host_name(hosts[0])):
            return 421, "this server is not asked under that name; list it under [web] hosts"
        origins = headers.getlist("origin")
        if method not in READS:
            return (403, "commands are not taken from pages") if origins or _is_of_page(headers) else None
        if origins and any(origin != f"http://{hosts[0]}" for origin in origins):
            return 403, "pages of other origins get nothing"
        is_visit = headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site") in {"cross-site", "same-site"} and not is_visit:
            return 403, "pages of other sites get nothing"
        return None

    async def _role(self, headers: Headers) -> tuple[Role | None, tuple[int, str] | None]:
        given = read_authorization(headers)
        if given is None:
            return (Role.OBSERVER, None) if self._access.is_open else (None, (401, "a token is needed"))
        role = self._access.role_of(*given)
        if role is None:
            await asyncio.sleep(WRONG_TOKEN_S)
            return None, (401, "wrong token")
        return role, None


def host_name(host: str) -> str:
    """A host header's name in small letters, without port and brackets."""
    name, _, port = host.rpartition(":")
    if not name or not port.isascii() or not (port.isdigit() or not port):
        name = host
    return name.strip("[]").rstrip(".").lower()


def read_authorization(headers: Mapping[str, str]) -> tuple[str, str] | None:
    """Scheme and word of a request's ``Authorization``; the word of ``basic`` is its password."""
    scheme, _, rest = headers.get("authorization", "").partition(" ")
    match scheme.lower():
        case "":
            return None
        case "bearer":
            return "bearer", rest.strip()
        case "basic":
            try:
                text = base64.b64decode(rest.strip(), validate=True).decode()
            except (binascii.Error, UnicodeDecodeError):  # a header that is no token is a wrong token
                return "basic", ""
            return "basic", text.partition(":")[2]
    return scheme.lower(), ""


def _is_of_page(headers: Headers) -> bool:
    return headers.get("sec-fetch-site", "none") != "none"
