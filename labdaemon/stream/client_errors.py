"""What can go wrong between a client and its daemon."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zmq

from labdaemon.errors import LabdaemonError
from labdaemon.stream import messages


class NoDaemon(LabdaemonError):
    """No daemon answers at the address."""

    retryable = True


CLOSED = (zmq.ETERM, zmq.ENOTSOCK, zmq.ENOTSUP)
"""What libzmq and pyzmq say of a socket that another thread or task has closed."""


class ClientClosed(LabdaemonError):
    """The program has closed its client, and still uses it, most likely in another thread."""

    def __init__(self) -> None:
        super().__init__("this client is closed; end what uses it first, or make a new client")


@contextmanager
def refuse_closed() -> Iterator[None]:
    """Raise `ClientClosed` where a socket turns out to be closed.

    Raises
    ------
    ClientClosed
        It is.
    """
    try:
        yield
    except zmq.ZMQError as exc:
        if exc.errno not in CLOSED:
            raise
        raise ClientClosed from exc


class HeartbeatLost(NoDaemon):
    """The daemon's heartbeat is missing; `silent_s` says for how long."""

    def __init__(self, address: str, silent_s: float) -> None:
        self.silent_s: float = silent_s
        super().__init__(f"no heartbeat from {address} for {silent_s:.0f} s: has the daemon ended?")


class RemoteError(LabdaemonError):
    """The daemon said no.

    Attributes
    ----------
    code, name
        Of the answer, as -32002 and ``limits``.
    data
        What it sent with the error.
    """

    def __init__(self, error: dict[str, Any]) -> None:
        self.code: int = int(error.get("code", messages.INTERNAL_ERROR))
        self.data: dict[str, Any] = dict(error.get("data") or {})
        self.name: str = str(self.data.get("name", "error"))
        self.retryable: bool = self.code == messages.BUSY
        self.exit_status: int = 2 if self.code in {messages.INVALID_PARAMS, messages.LIMITS} else 1
        super().__init__(str(error.get("message", "the daemon refused")))


class JournalChanged(LabdaemonError):
    """The daemon writes another history than before; the stream continues from that one's beginning."""

    def __init__(self, before: str, now: str) -> None:
        self.before: str = before
        self.now: str = now
        super().__init__(f"the daemon's journal is {now} now, it was {before}: seq starts anew")


class HistoryCut(LabdaemonError):
    """Events that were asked for are no longer kept; the stream continues with the first that is.

    Attributes
    ----------
    after, gone_before
        Events after the one and before the other are gone.
    """

    def __init__(self, after: int, gone_before: int) -> None:
        self.after: int = after
        self.gone_before: int = gone_before
        super().__init__(
            f"events {after + 1} to {gone_before - 1} are no longer kept by the daemon; ask after {gone_before - 1}"
        )
