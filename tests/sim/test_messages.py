"""Messages between a simulator's process and those who use it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labdrivers.sim.messages import BIGGEST_HEAD, LENGTHS, connect, receive, send


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    one, other = socket.socketpair()
    with one, other:
        one.settimeout(5.0)
        other.settimeout(5.0)
        yield one, other


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.text(max_size=10), st.integers() | st.text(max_size=20), max_size=5), st.binary(max_size=500))
def test_a_message_arrives_as_it_was_sent(
    pair: tuple[socket.socket, socket.socket], head: dict[str, object], data: bytes
) -> None:
    send(pair[0], head, data)
    assert receive(pair[1]) == (head, data)


def test_a_large_message_arrives_in_parts(pair: tuple[socket.socket, socket.socket]) -> None:
    data = bytes(range(256)) * 20_000
    sending = threading.Thread(target=send, args=(pair[0], {"a": 1}, data))
    sending.start()
    assert receive(pair[1]) == ({"a": 1}, data)
    sending.join()


@pytest.mark.parametrize("cut", [0, 3, 8, 12])
def test_a_peer_that_goes_in_mid_message_is_an_end(cut: int) -> None:
    one, other = socket.socketpair()
    with one, other:
        whole = LENGTHS.pack(7, 4) + b'{"a":1}' + b"data"
        one.sendall(whole[:cut])
        one.close()
        with pytest.raises(EOFError, match="closed"):
            receive(other)


def test_what_is_no_message_does_not_take_the_memory() -> None:
    one, other = socket.socketpair()
    with one, other:
        one.sendall(LENGTHS.pack(BIGGEST_HEAD + 1, 0))
        with pytest.raises(EOFError, match="not a message"):
            receive(other)


@pytest.mark.parametrize("url", ["127.0.0.1:80", "http://127.0.0.1:80", "tcp://127.0.0.1", "tcp://:80", ""])
def test_an_address_is_a_host_and_a_port(url: str) -> None:
    with pytest.raises(ValueError, match="write tcp://host:port"):
        connect(url)


def test_it_connects() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        connect(f"tcp://127.0.0.1:{server.getsockname()[1]}") as peer,
    ):
        near, _ = server.accept()
        with near:
            send(near, {"hello": True})
            assert receive(peer) == ({"hello": True}, b"")
