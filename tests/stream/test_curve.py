"""Keys over real sockets: who gets in, as what, and how they are put out."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
import zmq

from labdaemon.stream.access import CLIENTS
from labdaemon.stream.client import Client, NoDaemon, RemoteError
from labdaemon.stream.client_sockets import connect
from labdaemon.stream.key_files import KeyPair, make_pair
from labdaemon.stream.key_list import remove_client
from labdaemon.stream.roles import Role
from labdaemon.testing.stream_daemon import FakeKeys, StreamDaemon

SocketMaker = Callable[[int], "zmq.Socket[bytes]"]


def client(daemon: StreamDaemon, pair: KeyPair | None, timeout_s: float = 20.0) -> Client:
    return Client(daemon.commands, daemon.events, timeout_s=timeout_s, key=pair)


def look(daemon: StreamDaemon, keys: FakeKeys) -> None:
    """What the daemon does every second."""
    daemon.run(keys.access.look())


def test_an_operator_commands_and_hears(guarded: StreamDaemon, keys: FakeKeys) -> None:
    with client(guarded, keys.operator) as lab:
        events = lab.events(timeout_s=20)
        assert next(events)["kind"] == "status"
        assert lab.call("capture", label="a")["capture"] == "0001-a"
        guarded.publish("fault", {"message": "m"})
        assert next(event for event in events if event["kind"] == "fault")["seq"] == 1


def test_an_observer_hears_and_reads_and_cannot_even_stop(guarded: StreamDaemon, keys: FakeKeys) -> None:
    with client(guarded, keys.observer) as lab:
        assert next(lab.events(timeout_s=20))["kind"] == "status"
        assert lab.call("status")["state"] == "idle"
        for method in ("capture", "stop", "campaign.submit"):
            with pytest.raises(RemoteError) as refused:
                lab.call(method)
            assert refused.value.name == "forbidden"
    assert {method for method, _ in guarded.asked} == {"status"}


@pytest.fixture(params=["plain", "unlisted", "wrong daemon"])
def stranger(request: pytest.FixtureRequest, keys: FakeKeys) -> KeyPair | None:
    return {
        "plain": None,
        "unlisted": make_pair(keys.daemon.public),
        "wrong daemon": KeyPair(keys.operator.public, keys.operator.secret, make_pair().public),
    }[request.param]


def test_strangers_get_nothing(guarded: StreamDaemon, keys: FakeKeys, stranger: KeyPair | None) -> None:
    with client(guarded, stranger, timeout_s=0.4) as lab:
        heard = lab.subscribe()
        with pytest.raises(NoDaemon):
            lab.call("status")
        assert not heard.poll(50)
    with client(guarded, keys.operator) as lab:  # who is listed is served all the same
        assert lab.call("status")["state"] == "idle"
    assert [method for method, _ in guarded.asked] == ["status"]


def test_a_revocation_ends_what_is_connected(guarded: StreamDaemon, keys: FakeKeys) -> None:
    with client(guarded, keys.operator) as lost, client(guarded, keys.observer) as kept:
        stream, heard = lost.listen(timeout_s=20), kept.events(timeout_s=20)
        assert next(heard)["kind"] == "status"
        lost.call("status")
        remove_client(keys.folder / CLIENTS, "olga")
        look(guarded, keys)
        guarded.publish("fault", {"message": "secret"})
        assert next(event for event in heard if event["kind"] == "fault")
        while (event := stream.receive(2.5)) is not None:  # heartbeats from before; one a second if it went on
            assert event["kind"] == "status"
        stream.close()
        lost.timeout_s = 0.3
        with pytest.raises(NoDaemon):
            lost.call("status")
        assert kept.call("status")["state"] == "idle"


def test_a_changed_role_holds_for_connections_that_exist(guarded: StreamDaemon, keys: FakeKeys) -> None:
    with client(guarded, keys.observer) as lab:
        with pytest.raises(RemoteError):
            lab.call("capture")
        path = keys.folder / CLIENTS
        path.write_text(path.read_text().replace("observer otto", "operator otto"))
        look(guarded, keys)
        assert lab.call("capture")["capture"] == "0001-a"


def test_a_client_listed_later_gets_in_without_a_new_start(guarded: StreamDaemon, keys: FakeKeys) -> None:
    late = keys.make("late", Role.OBSERVER)
    look(guarded, keys)
    with client(guarded, late) as lab:
        assert lab.call("status")["state"] == "idle"


def test_subscriptions_are_bounded_though_they_are_encrypted(
    guarded: StreamDaemon, keys: FakeKeys, sockets: SocketMaker
) -> None:
    greedy = sockets(zmq.SUB)
    for number in range(150):
        greedy.set(zmq.SUBSCRIBE, b"%d" % number)
    connect(greedy, guarded.events, keys.observer)
    wait_for(lambda: refusals(guarded.publisher) > 0)
    with client(guarded, keys.observer) as lab:
        assert next(lab.events(timeout_s=20))["kind"] == "status"


def test_subscriptions_that_end_are_counted_back(guarded: StreamDaemon, keys: FakeKeys, sockets: SocketMaker) -> None:
    busy = connect(sockets(zmq.SUB), guarded.events, keys.observer)
    for number in range(150):
        busy.set(zmq.SUBSCRIBE, b"t%d" % number)
        busy.set(zmq.UNSUBSCRIBE, b"t%d" % number)
    busy.set(zmq.SUBSCRIBE, b"status")
    assert busy.poll(20_000)
    assert refusals(guarded.publisher) == 0


def test_a_message_without_end_is_ended(
    guarded: StreamDaemon, keys: FakeKeys, sockets: SocketMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labdaemon.stream.peer_connection.ENDLESS_S", 0.3)
    greedy = connect(sockets(zmq.DEALER), guarded.commands, keys.operator)
    greedy.send_multipart([bytes(1 << 19)] * 24)  # libzmq sends nothing of a message before it is whole
    wait_for(lambda: refusals(guarded.server) > 0)
    with client(guarded, keys.operator) as lab:
        assert lab.call("status")["state"] == "idle"


def test_many_messages_are_no_message_without_end(guarded: StreamDaemon, keys: FakeKeys) -> None:
    with client(guarded, keys.operator) as lab:
        for _ in range(12):  # more bytes in all than one message may have
            lab.call("campaign.submit", toml="x" * 900_000)
    assert refusals(guarded.server) == 0


def test_no_client_gets_the_answers_of_another_by_its_identity(
    guarded: StreamDaemon, keys: FakeKeys, sockets: SocketMaker
) -> None:
    def ask(socket: zmq.Socket[bytes], number: int) -> None:
        socket.send_json({"jsonrpc": "2.0", "id": number, "method": "stop"})

    operator, thief = sockets(zmq.DEALER), sockets(zmq.DEALER)
    for socket in (operator, thief):
        socket.set(zmq.IDENTITY, b"olga-pc")
    connect(operator, guarded.commands, keys.operator)
    ask(operator, 1)
    assert operator.recv_json()["result"]["rest"] == "shaker"
    connect(thief, guarded.commands, keys.observer)
    ask(thief, 2)
    for number in range(3, 8):
        ask(operator, number)
        assert operator.recv_json()["id"] == number
    assert not thief.poll(200)


def refusals(part: object) -> int:
    return part._gate.refusals  # type: ignore[attr-defined, no-any-return]


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
