"""Text gateway and web server, where the rig file has them: ways in for what speaks no ZeroMQ."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from labdaemon.clock import Clock
from labdaemon.gateway.answers import identity_text
from labdaemon.gateway.client_state import GatewayAccess, GatewayContext
from labdaemon.gateway.text_gateway import TextGateway
from labdaemon.journal.journal import Journal
from labdaemon.off_loop import off_loop
from labdaemon.rig_sections import LOOPBACK_NAMES
from labdaemon.service.config import RigConfig
from labdaemon.service.supervise import supervise
from labdaemon.stream.access_token import AccessToken
from labdaemon.stream.command_call import Execute
from labdaemon.stream.event_feed import EventFeed
from labdaemon.stream.roles import Role
from labdaemon.version import __version__

if TYPE_CHECKING:
    from labdaemon.web.web_server import WebServer

log: logging.Logger = logging.getLogger(__name__)


class SideServers:
    """The servers of ``[gateway]`` and ``[web]``. What fails in them is logged, and ends neither daemon nor campaign.

    Parameters
    ----------
    config
        The rig file.
    execute
        Carries commands out.
    journal
        Where events come from.
    """

    def __init__(self, config: RigConfig, execute: Execute, journal: Journal) -> None:
        self._config, self._execute, self._journal = config, execute, journal
        self._feed: EventFeed | None = None
        self._gateway: TextGateway | None = None
        self._web: WebServer | None = None

    async def bind(self) -> None:
        """Take the addresses.

        Raises
        ------
        ConfigError
            One is taken, or a token file is not as it must be.
        """
        if self._config.gateway is not None:
            self._gateway = self._make_gateway()
            self._gateway.bind()
        if self._config.web is not None:
            module = await off_loop(import_module, "labdaemon.web.web_server")  # takes half a second to load
            self._web = self._make_web(module)
            self._web.bind()

    def start(self, clock: Clock) -> list[asyncio.Task[None]]:
        """Serve; tasks that end only when they are cancelled."""
        servers: list[tuple[str, Callable[[], Awaitable[None]]]] = []
        if self._gateway is not None:
            servers.append(("text gateway", self._gateway.run))
        if self._web is not None:
            servers.append(("web server", self._web.run))
        return [asyncio.create_task(_keep(name, run, clock)) for name, run in servers]

    def addresses(self) -> dict[str, str]:
        """Where they serve, by section."""
        servers = {"gateway": self._gateway, "web": self._web}
        return {name: server.address for name, server in servers.items() if server is not None}

    def wake(self) -> None:
        """Something was committed. Cheap; call it on the loop's thread."""
        if self._feed is not None:
            self._feed.wake()
        if self._web is not None:
            self._web.wake()

    def close(self) -> None:
        """Give the addresses back."""
        for server in (self._gateway, self._web):
            if server is not None:
                server.close()

    def _make_gateway(self) -> TextGateway:
        section = self._config.gateway
        assert section is not None
        token = self._token(section.token_file, "gateway.token_file")
        self._feed = EventFeed(self._journal)
        identity = identity_text(self._config.source.stem, self._journal.uuid, __version__)
        access = GatewayAccess(token, None if token is not None else Role.OPERATOR)
        return TextGateway(section.address, GatewayContext(self._execute, self._feed, access, identity))

    def _make_web(self, module: Any) -> WebServer:
        from labdaemon.web.guard import WebAccess

        section = self._config.web
        assert section is not None
        access = WebAccess(
            hosts=LOOPBACK_NAMES | {section.host} | {name.lower() for name in section.hosts},
            operator=self._token(section.token_file, "web.token_file"),
            observer=self._token(section.observer_token_file, "web.observer_token_file"),
            is_open=section.is_loopback and not self._config.service.restricts_operators,
            takes_numbers=not section.is_loopback,
        )
        server: WebServer = module.WebServer(section.address, self._execute, self._journal, access)
        return server

    def _token(self, written: str | None, key: str) -> AccessToken | None:
        return AccessToken(self._config.path(written), key) if written is not None else None


async def _keep(name: str, run: Callable[[], Awaitable[None]], clock: Clock) -> None:
    """Run a server until cancelled. One that fails for good is missed by its clients, and by nothing else."""
    try:
        await supervise(name, run, clock)
    except Exception:
        log.exception("%s failed too often and is left; the rest of the daemon serves", name)
    await asyncio.get_running_loop().create_future()
