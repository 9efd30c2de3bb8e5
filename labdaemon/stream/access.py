"""Who gets in: the daemon's own key, the clients that are listed, and what happens when the list changes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from labdaemon.clock import Clock
from labdaemon.errors import LabdaemonError
from labdaemon.off_loop import off_loop
from labdaemon.stream.key_files import KeyPair, make_pair, pair_text, read_pair, write_secret
from labdaemon.stream.key_list import ListedClient, read_clients
from labdaemon.stream.roles import Role

OWN_KEY = "daemon.key"
CLIENTS = "clients.txt"
LOOK_S = 1.0
"""How often the list is read again: a revoked client is out within about twice this time."""
ABSENT_LOOKS = 3
"""So many times in a row the list is not there before all clients are out: some editors remove a file, then write."""

log: logging.Logger = logging.getLogger(__name__)


def own_pair(folder: Path) -> KeyPair:
    """The daemon's own key pair; made when it is needed for the first time.

    Raises
    ------
    ConfigError
        Its file is damaged, or others can read it.
    StorageError
        It cannot be written.
    """
    path = folder / OWN_KEY
    if not path.exists():
        with suppress(FileExistsError):  # another process made it meanwhile
            write_secret(path, pair_text(make_pair()))
    return read_pair(path, is_client=False)


class KeyAccess:
    """Knows the role of each key. The list is read again every second, by its content and not by its time.

    Parameters
    ----------
    folder
        Where the daemon's key and the list of clients lie.

    Raises
    ------
    ConfigError
        A file in it is damaged or open to others.
    """

    def __init__(self, folder: Path) -> None:
        self.folder: Path = folder
        self.pair: KeyPair = own_pair(folder)
        self._clients: Mapping[str, ListedClient] = {}
        self._listeners: list[Callable[[], None]] = []
        self._absent = 0
        self._trouble = ""
        self._take(read_clients(folder / CLIENTS))

    @property
    def clients(self) -> tuple[ListedClient, ...]:
        """Who is listed."""
        return tuple(self._clients.values())

    def name_of(self, public: str) -> str:
        """Who a key is, for messages."""
        client = self._clients.get(public)
        return client.name if client is not None else "the daemon's own key" if public == self.pair.public else public

    def role_of(self, public: str) -> Role | None:
        """The role of a key now; None where it is not listed (any more).

        The daemon's own key is an operator's: who can read it can do everything already, and ``safe-stop`` needs it.
        """
        if public == self.pair.public:
            return Role.OPERATOR
        client = self._clients.get(public)
        return client.role if client is not None else None

    def listen(self, listener: Callable[[], None]) -> None:
        """Call this after each change of the list."""
        self._listeners.append(listener)

    async def run(self, clock: Clock) -> None:
        """Follow the list until cancelled."""
        while True:
            await clock.sleep(LOOK_S)
            await self.look()

    async def look(self) -> None:
        """Read the list again. One that cannot be read changes nothing: a slip of an editor locks no one out."""
        path = self.folder / CLIENTS
        try:
            clients, is_there = await off_loop(lambda: (read_clients(path), path.exists()))
        except (LabdaemonError, OSError) as exc:
            if str(exc) != self._trouble:
                self._trouble = str(exc)
                log.error("the list of clients stays as it was: %s", exc)
            return
        self._absent = 0 if is_there else self._absent + 1
        if 0 < self._absent < ABSENT_LOOKS:
            return
        self._trouble = ""
        before = self._clients
        self._take(clients)
        if before != self._clients:
            gone = sorted(client.name for public, client in before.items() if public not in self._clients)
            log.warning(
                "clients listed now: %d%s", len(self._clients), f"; no longer {', '.join(gone)}" if gone else ""
            )
            for listener in self._listeners:
                listener()

    def _take(self, clients: tuple[ListedClient, ...]) -> None:
        self._clients = {client.public: client for client in clients}
