"""A light daemon for tests of clients: real sockets and keys, a journal in memory, and no rig."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from labdaemon.clock import SystemClock
from labdaemon.journal.event import EventText
from labdaemon.off_loop import off_loop
from labdaemon.stream.access import CLIENTS, KeyAccess, own_pair
from labdaemon.stream.commands import CommandServer
from labdaemon.stream.key_files import KeyPair, make_pair
from labdaemon.stream.key_list import ListedClient, add_client
from labdaemon.stream.publisher import EventPublisher, Outbox, latest, replay
from labdaemon.stream.roles import Role
from labdaemon.stream.sockets import ANYBODY, DoorPolicy
from labdaemon.testing.free_port import free_address

START_S = 20.0
METHODS = (
    *("status", "rig", "capture", "stop", "events.replay", "events.latest", "rpc.discover"),
    *("campaign.submit", "campaign.list", "campaign.show", "campaign.move"),
)
"""Commands that it answers, each with what `StreamDaemon.results` has."""


class MemoryOutbox:
    """Committed events, in memory."""

    def __init__(self, uuid: str = "11111111-1111-1111-1111-111111111111") -> None:
        self.uuid = uuid
        self.events: list[EventText] = []
        self.cut: int = 0
        """Events up to this `seq` are gone."""

    @property
    def last_seq(self) -> int:
        """`seq` of the last one."""
        return self.events[-1].seq if self.events else self.cut

    def add(self, kind: str, data: dict[str, Any], campaign: str | None = None) -> int:
        """Commit an event, and return its `seq`."""
        seq = self.last_seq + 1
        about = {"v": 1, "seq": seq, "at": "2026-05-04T10:11:12.000000Z", "kind": kind, "campaign": campaign}
        text = json.dumps(about | {"journal": self.uuid, "data": data})
        self.events.append(EventText(seq, kind, text.encode()))
        return seq

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        """Events after a `seq`."""
        first = self.events[0].seq if self.events else 1
        return self.events[max(seq - first + 1, 0) :][:limit]

    history = recent

    def latest(self) -> list[EventText]:
        """The last one of each kind."""
        return sorted({event.kind: event for event in self.events}.values(), key=lambda event: event.seq)


class StreamDaemon:
    """Serves commands and events from a thread of its own, so that a test may use blocking clients.

    Attributes
    ----------
    asked
        Commands that were carried out, in order.
    """

    def __init__(self, policy: DoorPolicy = ANYBODY, *, outbox: Outbox | None = None) -> None:
        self.policy: DoorPolicy = policy
        self.outbox: Outbox = outbox or MemoryOutbox()
        self.commands: str = free_address()
        self.events: str = free_address()
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.results: dict[str, Any] = {
            "status": {"state": "idle"},
            "rig": {"version": "0", "service": {}},
            "capture": {"capture": "0001-a", "opened_at": "2026-05-04T10:11:12Z"},
            "stop": {"rest": "shaker", "table": "rest", "seen": "read-back", "troubles": []},
        }
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Serve; the addresses are known when this returns."""
        started = threading.Event()
        failure: list[BaseException] = []

        def run() -> None:
            try:
                asyncio.run(self._serve(started))
            except BaseException as exc:
                failure.append(exc)
            finally:
                started.set()

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()
        if not started.wait(START_S) or failure:
            raise failure[0] if failure else TimeoutError("the daemon did not start")

    def stop(self) -> None:
        """End; `start` begins again at the same addresses."""
        if self._thread is not None:
            self.call(self._end.set)
            self._thread.join(START_S)
            self._thread = None

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        """Await something on the daemon's loop."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(START_S)

    def call(self, work: Callable[[], Any]) -> None:
        """Do something on the daemon's loop, and wait for it."""
        done = threading.Event()

        def do() -> None:
            work()
            done.set()

        self._loop.call_soon_threadsafe(do)
        if not done.wait(START_S):
            raise TimeoutError("the daemon's loop does not run")

    def publish(self, kind: str, data: dict[str, Any]) -> None:
        """Commit an event and have it sent."""

        def commit() -> None:
            assert isinstance(self.outbox, MemoryOutbox)
            self.outbox.add(kind, data)
            self.publisher.wake()

        self.call(commit)

    async def _serve(self, started: threading.Event) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self.server: CommandServer = CommandServer(
            self.commands, {name: self._handler(name) for name in METHODS}, None, self.policy
        )
        self.publisher: EventPublisher = EventPublisher(
            self.events, self.outbox, lambda: {"state": "idle"}, SystemClock(), self.policy
        )
        try:
            self.server.bind()
            self.publisher.bind()
            self.commands, self.events = self.server.address, self.publisher.address
            tasks = [asyncio.create_task(part.run()) for part in (self.server, self.publisher)]
            started.set()
            await self._end.wait()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        finally:
            self.server.close()
            self.publisher.close()

    def _handler(self, method: str) -> Callable[[dict[str, Any]], Any]:
        async def handle(params: dict[str, Any]) -> Any:
            self.asked.append((method, params))
            if method == "events.replay":
                return await off_loop(replay, self.outbox, params)
            if method == "events.latest":
                return await off_loop(latest, self.outbox, params)
            if method == "status":
                return {**self.results["status"], "seq": self.outbox.last_seq, "journal": self.outbox.uuid}
            return self.results.get(method, {})

        return handle


class FakeKeys:
    """A folder of keys with an operator, olga, and an observer, otto.

    Parameters
    ----------
    folder
        Where they lie.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemon: KeyPair = own_pair(folder)
        self.operator: KeyPair = self.make("olga", Role.OPERATOR)
        self.observer: KeyPair = self.make("otto", Role.OBSERVER)
        self.access: KeyAccess = KeyAccess(folder)

    def make(self, name: str, role: Role) -> KeyPair:
        """A new client's pair, listed."""
        pair = make_pair(self.daemon.public)
        add_client(self.folder / CLIENTS, ListedClient(name, role, pair.public))
        return pair
