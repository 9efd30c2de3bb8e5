"""HTTP on a real socket: reading, commands, pages of other sites, and requests that are none."""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import socket
from contextlib import suppress
from typing import Any

import pytest

from labdaemon.stream import listener, messages
from labdaemon.stream.roles import Role
from labdaemon.testing.served import TARGETS, FakeDaemon
from labdaemon.web import guard, http_protocol
from labdaemon.web.event_stream import first_seq
from labdaemon.web.guard import host_name


@pytest.fixture(autouse=True)
def no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "WRONG_TOKEN_S", 0.01)


async def test_status_rig_and_index(serve, ask, daemon: FakeDaemon):
    server = serve()
    answer = await ask(server, "/status")
    assert json.loads(answer.body)["result"]["state"] == "idle"
    assert answer.headers["content-type"] == "application/json"
    assert answer.headers["content-security-policy"].startswith("default-src 'none'")
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "access-control-allow-origin" not in answer.headers
    assert "server" not in answer.headers
    assert daemon.asked == [("status", {}, Role.OBSERVER)]
    assert b"/latest/envelope.csv" in (await ask(server, "/")).body
    assert (await ask(server, "/nothing")).status == 404
    assert (await ask(server, "/status", "DELETE")).status == 405
    assert (await ask(server, "/status", "OPTIONS")).status == 405
    assert (await ask(server, "/status", "HEAD")).body == b""


async def test_the_last_envelope_as_csv_and_json(serve, ask, daemon: FakeDaemon):
    server = serve()
    assert (await ask(server, "/latest/envelope.csv")).status == 404
    daemon.outbox.add("envelope", capture="manual-000001", targets=TARGETS)
    answer = await ask(server, "/latest/envelope.csv")
    lines = answer.body.decode().splitlines()
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert lines[0].startswith("capture,target,x_mm")
    assert lines[1].startswith("manual-000001,P1,1.000000")
    again = await ask(server, "/latest/envelope.csv", headers={"If-None-Match": answer.headers["etag"]})
    assert (again.status, again.body) == (304, b"")
    event = json.loads((await ask(server, "/latest/envelope.json")).body)
    assert (event["kind"], event["data"]["targets"]) == ("envelope", TARGETS)


async def test_commands_are_for_operators_with_a_token(serve, ask, daemon: FakeDaemon, bearer, words):
    server = serve()
    body = b'{"frequency_hz": 5.0, "label": "web"}'
    observer = {"Authorization": f"Bearer {words['observer']}"}
    password = {"Authorization": "Basic " + base64.b64encode(f"x:{words['operator']}".encode()).decode()}
    for headers in ({}, observer, password):
        assert (await ask(server, "/command/capture", "POST", body, headers)).status == 403
    for word in ("", "wrong", words["operator"] + "x", "\xff"):
        assert (await ask(server, "/command/capture", "POST", body, {"Authorization": f"Bearer {word}"})).status == 401
    assert daemon.asked == []
    answer = await ask(server, "/command/capture", "POST", body, bearer)
    assert json.loads(answer.body)["result"]["capture"] == "manual-000001"
    assert daemon.asked == [("capture", {"frequency_hz": 5.0, "label": "web"}, Role.OPERATOR)]
    assert (
        await ask(server, "/command/stop", "POST", b"", bearer | {"Content-Type": "application/json"})
    ).status == 200
    assert (await ask(serve(has_token=False), "/command/stop", "POST", b"{}", bearer)).status in {401, 403}


async def test_rpc_takes_whole_requests(serve, ask, daemon: FakeDaemon, bearer):
    server = serve()
    request = b'{"jsonrpc": "2.0", "id": "x", "method": "status"}'
    assert json.loads((await ask(server, "/rpc", "POST", request, bearer)).body)["id"] == "x"
    assert (await ask(server, "/rpc", "POST", b"[]", bearer)).status == 400
    notification = b'{"jsonrpc": "2.0", "method": "status"}'
    assert (await ask(server, "/rpc", "POST", notification, bearer)).status == 204


async def test_refusals_have_a_status(serve, ask, daemon: FakeDaemon, bearer):
    server = serve()
    wanted = {messages.BUSY: 503, messages.LIMITS: 422, messages.WRONG_STATE: 409, messages.DEVICE: 502, -1: 500}
    for code, status in wanted.items():
        daemon.errors["capture"] = (code, "no")
        answer = await ask(server, "/command/capture", "POST", b"{}", bearer)
        assert (answer.status, json.loads(answer.body)["error"]["code"]) == (status, code)


BAD_BODIES = [
    (b"[1]", {}, 400),
    (b'{"a"', {}, 400),
    (b'{"label": "\\ud800"}', {}, 400),
    (b'{} , "method": "stop"', {}, 400),
    (b"\xff\xfe", {}, 400),
    (b"[" * 5000, {}, 400),
    (b"{}", {"Content-Type": "text/plain"}, 415),
    (b"{}", {"Content-Type": "application/x-www-form-urlencoded"}, 415),
    (b"x", {"Content-Length": "2000000"}, 413),
    (b"{}", {"Origin": "http://127.0.0.1"}, 403),
    (b"{}", {"Origin": "null"}, 403),
    (b"{}", {"Sec-Fetch-Site": "same-origin"}, 403),
]


async def test_bodies_and_pages_that_are_refused(serve, ask, daemon: FakeDaemon, bearer):
    server = serve()
    for body, headers, status in BAD_BODIES:
        answer = await ask(server, "/command/capture", "POST", body, bearer | headers)
        assert answer.status == status, (body[:40], headers)
    assert daemon.asked == []


PAGES = [
    ({"Host": "evil.example"}, 421),
    ({"Host": "evil.example:5580"}, 421),
    ({"Host": "127.0.0.1.evil.example"}, 421),
    ({"Host": "localhost:99"}, 200),
    ({"Host": "[::1]:5580"}, 200),
    ({"Host": "LOCALHOST."}, 200),
    ({"Origin": "http://evil.example"}, 403),
    ({"Origin": "null"}, 403),
    ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}, 403),
    ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}, 200),
    ({"Sec-Fetch-Site": "none"}, 200),
]


async def test_pages_of_other_sites_get_nothing(serve, ask, daemon: FakeDaemon):
    server = serve()
    for headers, status in PAGES:
        assert (await ask(server, "/status", headers=headers)).status == status, headers


async def test_a_page_of_this_server_may_read(serve, ask):
    server = serve()
    assert (
        await ask(server, "/status", headers={"Origin": server.address, "Sec-Fetch-Site": "same-origin"})
    ).status == 200


async def test_off_loopback_reading_needs_a_token_too(serve, ask, daemon: FakeDaemon, words):
    server = serve(is_open=False)
    answer = await ask(server, "/status")
    assert answer.status == 401
    assert answer.headers["www-authenticate"].startswith("Basic ")
    for headers in (
        {"Authorization": f"Bearer {words['observer']}"},
        {"Authorization": "Basic " + base64.b64encode(f"excel:{words['observer']}".encode()).decode()},
    ):
        assert (await ask(server, "/status", headers=headers)).status == 200
    for wrong in ("Basic !!!", "Basic " + base64.b64encode(b"\xff").decode(), "Digest x", "Bearer"):
        assert (await ask(server, "/status", headers={"Authorization": wrong})).status == 401


NO_REQUESTS = [
    b"STOP\r\n\r\n",
    b"*IDN?\n\n",
    b"\xff" + b"\0" * 8 + b"\x7f\x03\x00NULL" + b"\0" * 48,
    b"GET /status HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 40_000 + b"\r\n\r\n",
    b"GET /" + b"x" * 40_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /status HTTP/1.1\r\n\r\n",
    b"GET /status HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n",
    b"GET /status HTTP/1.1\r\nHost : localhost\r\n\r\n",
    b"POST /rpc HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello",
    b"POST /rpc HTTP/1.1\r\nHost: localhost\r\nContent-Length: +5\r\n\r\nhello",
    b"POST /rpc HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: xchunked\r\n\r\n0\r\n\r\n",
    b"POST /rpc HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n\r\n",
    b"GET /status\r\n HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /status HTTP/1.1\r\nHost: localhost\r\nA: b\r\n\tc\0: d\r\n\r\n",
]


async def test_what_is_no_request_is_answered_by_400_and_the_next_bytes_are_not_read(serve, raw, daemon: FakeDaemon):
    server = serve()
    smuggled = b"GET /status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    for request in NO_REQUESTS:
        data = await raw(server, request + smuggled)
        assert data.startswith(b"HTTP/1.1 4"), request[:60]
        assert data.count(b"HTTP/1.1 ") == 1, request[:60]
    assert daemon.asked == []


@pytest.mark.parametrize(
    "second",
    ["Transfer-Encoding: chunked\r\nContent-Length: 4", "Content-Length: 0\r\nTransfer-Encoding: chunked"],
)
async def test_two_lengths_are_not_read_in_two_ways(serve, raw, daemon: FakeDaemon, bearer, second: str):
    """With both headers the chunks count (RFC 9112, 6.3), or the request is refused: never a second request."""
    head = f"POST /rpc HTTP/1.1\r\nHost: localhost\r\nAuthorization: {bearer['Authorization']}\r\n"
    head += f"Content-Type: application/json\r\n{second}\r\n\r\n"
    inner = b'{"jsonrpc":"2.0","id":1,"method":"status"}'
    body = b"%x\r\n%s\r\n0\r\n\r\n" % (len(inner), inner)
    data = await raw(
        serve(), head.encode() + body + b"GET /rig HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    )
    assert data.count(b"HTTP/1.1 ") <= 2
    assert [method for method, _, _ in daemon.asked] in ([], ["status"], ["status", "rig"])


async def test_a_client_that_leaves_in_mid_request_is_no_failure(serve, ask, bearer, caplog, daemon: FakeDaemon):
    server = serve()
    head = "POST /rpc HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 100\r\n"
    _, writer = await asyncio.open_connection("127.0.0.1", int(server.address.rpartition(":")[2]))
    writer.write(f"{head}Authorization: {bearer['Authorization']}\r\n\r\n{{".encode())
    await writer.drain()
    assert (await ask(server, "/status")).status == 200
    writer.transport.abort()
    for _ in range(3):
        assert (await ask(server, "/status")).status == 200
    assert "failed" not in caplog.text
    assert set(daemon.methods()) == {"status"}


async def test_a_flood_of_readers_leaves_operators_their_turn(serve, ask, raw, daemon: FakeDaemon, bearer, monkeypatch):
    monkeypatch.setattr(guard, "REQUESTS_PER_S", 20.0)
    monkeypatch.setattr(guard, "BURST", 5.0)
    server = serve()
    one = b"GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n"
    floods = [asyncio.create_task(raw(server, one * 200)) for _ in range(5)]
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    await asyncio.sleep(0.3)
    assert (await ask(server, "/command/stop", "POST", b"{}", bearer)).status == 200
    most = 5 * (5.0 + 20.0 * (loop.time() - began_s) + 1.0)  # burst and rate of each connection
    assert daemon.methods().count("status") <= most
    for flood in floods:
        flood.cancel()
    await asyncio.gather(*floods, return_exceptions=True)


@pytest.mark.parametrize("is_operator", [True, False])
async def test_a_body_that_turns_out_to_be_none_is_refused_once(
    serve, ask, bearer, caplog, daemon: FakeDaemon, is_operator: bool
):
    server = serve()
    head = "POST /command/capture HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    head += f"Authorization: {bearer['Authorization']}\r\n" if is_operator else ""
    reader, writer = await asyncio.open_connection("127.0.0.1", int(server.address.rpartition(":")[2]))
    writer.write(f"{head}Transfer-Encoding: chunked\r\n\r\n1\r\n{{\r\n".encode())
    await writer.drain()
    if not is_operator:
        assert (await reader.readline()).startswith(b"HTTP/1.1 403")
    else:
        assert (await ask(server, "/status")).status == 200  # the first part has been read by now
    writer.write(b"zz\r\n\r\nGET /status HTTP/1.1\r\nHost: localhost\r\n\r\n")
    rest = b""
    async with asyncio.timeout(120.0):
        with suppress(ConnectionResetError):  # it was closed with bytes that no one had read
            while part := await reader.read(4096):
                rest += part
    assert rest.count(b"HTTP/1.1 400") == is_operator
    assert (await ask(server, "/status")).status == 200
    assert "capture" not in daemon.methods()
    assert "failed" not in caplog.text
    assert "Fatal" not in caplog.text
    writer.transport.abort()


async def test_pipelined_requests_are_answered_in_order(serve, raw):
    one = b"GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n"
    last = one.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n")
    data = await raw(serve(), one * 3 + last)
    assert data.count(b"HTTP/1.1 200") == 4


class EventReader:
    """An event source."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def next(self) -> dict[str, str]:
        """The next event's fields; comments under an empty name."""
        fields: dict[str, str] = {}
        async with asyncio.timeout(120.0):
            while True:
                line = (await self.reader.readline()).decode().rstrip("\r\n")
                if not line and fields:
                    return fields
                name, colon, value = line.partition(":")
                if colon:
                    fields[name] = value.strip()


@pytest.fixture
async def listen() -> Any:
    readers: list[EventReader] = []

    async def join(server: Any, path: str, headers: str = "") -> EventReader:
        reader, writer = await asyncio.open_connection("127.0.0.1", int(server.address.rpartition(":")[2]))
        writer.write(f"GET {path} HTTP/1.0\r\nHost: localhost\r\n{headers}\r\n".encode())
        async with asyncio.timeout(120.0):
            while (await reader.readline()).strip():
                pass
        readers.append(EventReader(reader, writer))
        return readers[-1]

    yield join
    for one in readers:
        one.writer.transport.abort()


async def test_events_from_a_seq_and_live(serve, listen, daemon: FakeDaemon):
    for place in range(3):
        daemon.outbox.add("fault", message=str(place))
    server = serve()
    source = await listen(server, "/events?after=1")
    about = json.loads((await source.next())["data"])
    assert about == {"journal": "j", "last": 3, "after": 1, "reset": False}
    assert [(await source.next())["id"] for _ in range(2)] == ["2", "3"]
    daemon.outbox.add("envelope", capture="c", targets=[])
    server.wake()
    event = await source.next()
    assert (event["id"], event["event"], json.loads(event["data"])["seq"]) == ("4", "envelope", 4)
    back = await listen(server, "/events?after=0", "Last-Event-ID: 3\r\n")
    await back.next()
    assert (await back.next())["id"] == "4"
    fresh = await listen(server, "/events")
    assert json.loads((await fresh.next())["data"])["after"] == 4


async def test_a_seq_of_another_journal_begins_anew(serve, listen, daemon: FakeDaemon):
    daemon.outbox.add("fault", message="first")
    source = await listen(serve(), "/events?after=77")
    assert json.loads((await source.next())["data"])["reset"]
    assert (await source.next())["id"] == "1"


async def test_silence_has_a_heartbeat(serve, listen, monkeypatch):
    monkeypatch.setattr("labdaemon.web.event_stream.HEARTBEAT_S", 0.05)
    source = await listen(serve(), "/events")
    await source.next()
    assert (await source.next()) == {"": "heartbeat"}


async def test_many_are_far_behind_and_the_journal_is_read_once_for_all(serve, listen, daemon: FakeDaemon, monkeypatch):
    for place in range(250):
        daemon.outbox.add("fault", message=str(place))
    sources = [await listen(server, "/events?after=200") for server in [serve()] for _ in range(10)]
    for source in sources:
        await source.next()
        assert [int((await source.next())["id"]) for _ in range(50)] == list(range(201, 251))


async def test_what_is_no_seq_is_refused(serve, ask):
    server = serve()
    for written in ("-1", "x", "%D9%A3", "9" * 30, "1.5"):
        assert (await ask(server, f"/events?after={written}")).status == 400


async def test_streams_are_bounded_and_end_with_the_server(serve, ask, listen, monkeypatch):
    monkeypatch.setattr("labdaemon.web.event_stream.MOST_STREAMS", 2)
    server = serve()
    sources = [await listen(server, "/events") for _ in range(2)]
    for source in sources:
        await source.next()
    assert (await ask(server, "/events")).status == 503
    server._end()
    async with asyncio.timeout(120.0):
        for source in sources:
            assert await source.reader.read() == b""


async def test_a_stream_whose_client_has_left_ends(serve, listen):
    server = serve()
    source = await listen(server, "/events")
    await source.next()
    assert server._context.streams == 1
    source.writer.transport.abort()
    async with asyncio.timeout(120.0):
        while server._context.streams:
            await asyncio.sleep(0.005)


async def test_silent_and_slow_clients_lose_their_place(serve, ask, monkeypatch, caplog, daemon: FakeDaemon):
    monkeypatch.setattr(http_protocol, "REQUEST_S", 0.2)
    monkeypatch.setattr(http_protocol, "READS_S", 0.2)
    server = serve()
    port = int(server.address.rpartition(":")[2])
    with caplog.at_level(logging.WARNING):
        for first in (b"", b"GET /sta", b"POST /rpc HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{"):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(first)
            async with asyncio.timeout(120.0):
                with suppress(ConnectionResetError):
                    assert not (await reader.read()).startswith(b"HTTP/1.1 200")
            writer.close()
    assert len([record for record in caplog.records if "web" in record.name]) == 1  # one line a peer and minute
    monkeypatch.setattr(http_protocol, "REQUEST_S", 15.0)  # requests that are whole must pass on a busy machine
    daemon.outbox.add("envelope", capture="c", targets=[{"target": f"P{n}", "flags": []} for n in range(20_000)])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.transport.pause_reading()
    writer.write(b"GET /latest/envelope.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 30)
    async with asyncio.timeout(120.0):
        while not await _is_gone(writer):
            await asyncio.sleep(0.05)
    assert (await ask(server, "/status")).status == 200


async def _is_gone(writer: asyncio.StreamWriter) -> bool:
    try:
        writer.write(b"\r\n")
        await asyncio.sleep(0.01)
    except OSError:
        return True
    return writer.transport.is_closing()


async def test_connections_are_bounded_and_idle_ones_give_way(serve, ask, monkeypatch):
    monkeypatch.setattr(http_protocol, "MOST_CONNECTIONS", 3)
    server = serve()
    port = int(server.address.rpartition(":")[2])
    crowd = [await asyncio.open_connection("127.0.0.1", port) for _ in range(6)]
    async with asyncio.timeout(120.0):
        for reader, _ in crowd[3:]:
            with suppress(ConnectionResetError):
                assert await reader.read() == b""
    monkeypatch.setattr(http_protocol, "IDLE_S", 0.0)
    assert (await ask(server, "/status")).status == 200
    for _, writer in crowd:
        writer.transport.abort()


async def test_an_address_that_is_taken_is_refused_by_its_key(serve, daemon: FakeDaemon):
    from labdaemon.errors import ConfigError
    from labdaemon.web.web_server import WebServer

    other = WebServer(serve().address, daemon.execute, daemon.outbox, guard.WebAccess(frozenset(), None, None, True))
    with pytest.raises(ConfigError, match=r"web\.address.*taken"):
        other.bind()


async def test_what_was_cut_from_the_journal_is_said(serve, listen, daemon: FakeDaemon):
    for place in range(5):
        daemon.outbox.add("fault", message=str(place))
    daemon.outbox.cut_before = 4
    source = await listen(serve(), "/events?after=1")
    await source.next()
    assert json.loads((await source.next())["data"]) == {"gone_before": 4}
    assert [(await source.next())["id"] for _ in range(2)] == ["4", "5"]


@pytest.mark.parametrize(
    ("name", "loopback", "wide"), [("10.0.0.5", False, True), ("fe80::1", False, True), ("a", True, True)]
)
def test_a_number_is_a_host_where_the_network_reaches_it(name: str, loopback: bool, wide: bool):
    names = frozenset({"a"})
    assert guard.WebAccess(names, None, None, True).is_host(name) is loopback
    assert guard.WebAccess(names, None, None, False, takes_numbers=True).is_host(name) is wide
    assert not guard.WebAccess(names, None, None, False, takes_numbers=True).is_host("evil.example")


@pytest.mark.parametrize(
    ("host", "name"),
    [("localhost:80", "localhost"), ("[::1]", "::1"), ("[::1]:80", "::1"), ("A.b.", "a.b"), ("", ""), ("x:y", "x:y")],
)
def test_names_of_hosts(host: str, name: str):
    assert host_name(host) == name


def test_what_a_browser_has_seen_comes_before_its_address():
    assert first_seq({"after": "3"}, "7") == 7
    assert first_seq({"after": "3"}, "") == 3
    assert first_seq({}, None) is None


async def test_a_client_that_went_without_a_word_is_watched_for(serve, ask, monkeypatch: pytest.MonkeyPatch):
    """As a browser whose computer leaves the network: heartbeats alone would fill no buffer for hours."""
    watched: list[int] = []

    def watch(peer: socket.socket, *, is_written_to: bool) -> None:
        listener.watch_peer(peer, is_written_to=is_written_to)
        watched.append(peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT))

    monkeypatch.setattr(http_protocol, "watch_peer", watch)
    assert (await ask(serve(), "/status")).status == 200
    assert watched == [1000 * listener.GONE_S]
