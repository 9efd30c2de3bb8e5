"""Daemons that clients connect to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq

from labdaemon.stream.sockets import DoorPolicy
from labdaemon.testing.stream_daemon import FakeKeys, StreamDaemon


@pytest.fixture
def sockets() -> Iterator[Callable[[int], zmq.Socket[bytes]]]:
    """Makes client sockets, and closes them."""
    context, made = zmq.Context(), []

    def make(kind: int) -> zmq.Socket[bytes]:
        made.append(context.socket(kind))
        return made[-1]

    yield make
    context.destroy(linger=0)


@pytest.fixture
def keys(tmp_path: Path) -> FakeKeys:
    return FakeKeys(tmp_path / "keys")


@pytest.fixture
def daemon() -> Iterator[StreamDaemon]:
    daemon = StreamDaemon()
    daemon.start()
    yield daemon
    daemon.stop()


@pytest.fixture
def guarded(keys: FakeKeys) -> Iterator[StreamDaemon]:
    """A daemon that lets listed keys in and no others."""
    daemon = StreamDaemon(DoorPolicy(keys.access))
    daemon.start()
    yield daemon
    daemon.stop()
