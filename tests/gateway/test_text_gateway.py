"""The text gateway on a real socket: commands, captures, `STOP` out of turn, and clients that misbehave."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable
from typing import Any

import pytest

from labdaemon.gateway import client_state, text_connection, text_gateway
from labdaemon.stream import listener, messages
from labdaemon.stream.roles import Role
from labdaemon.testing.served import TARGETS, FakeDaemon


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(120.0):
        while not condition():
            await asyncio.sleep(0.005)


async def test_identity_help_and_errors(serve, connect):
    client = await connect(serve())
    assert await client.ask("*IDN?") == "labdaemon,sim,1,0"
    assert await client.ask("SYST:ERR?") == '0,"No error"'
    await client.send("FOO")
    assert await client.ask("*ESR?") == "160"  # power on, and a command error
    assert await client.ask("*STB?") == "4"
    assert await client.ask("syst:err?") == '-113,"Undefined header;FOO"'
    assert await client.ask("SYST:VERS?;*TST?") == "1999.0;0"
    assert "TRIGger[:IMMediate]" in await client.ask("SYST:HELP?")
    await client.send("*IDN", "TRIG?", "CAPT:FREQ", "CAPT:FREQ 1,2", "*CLS 1")
    assert (await client.ask("SYST:ERR:ALL?")).split(",")[::2] == ["-113", "-113", "-109", "-108", "-108"]
    assert await client.ask("SYST:ERR:COUN?") == "0"
    await client.send("SYST:HELP:HEAD?")
    head = await client.reader.readexactly(2)
    size = int(await client.reader.readexactly(int(head[1:])))
    assert b"SYSTem:HELP:HEADers?/qonly/\n" in await client.reader.readexactly(size + 1)


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
async def test_a_line_ends_as_terminals_and_visa_programs_end_it(serve, connect, end: bytes):
    client = await connect(serve())
    for _ in range(2):
        client.writer.write(b"*IDN?" + end)
        assert await client.answer() == "labdaemon,sim,1,0"
    assert await client.ask("SYST:ERR?") == '0,"No error"'


async def test_a_trigger_carries_what_was_stated(serve, connect, daemon: FakeDaemon):
    client = await connect(serve())
    await client.send('CAPT:FREQ 5.5;AMPL 2 MM;PHAS 90 DEG;GRO "night 1";EXP 1;LAB "crack; 7"', "TRIG")
    assert await client.ask("*OPC?") == "1"
    assert await client.ask("CAPT?") == '"manual-000001","2026-05-04T10:11:12.123456Z"'
    [(method, params, role)] = daemon.asked
    assert (method, role) == ("capture", "operator")
    assert params == pytest.approx(
        {"frequency_hz": 5.5, "excitation_amplitude_mm": 2.0, "phase_rad": 1.5707963, "exposure_s": 1.0}
        | {"group": "night 1", "label": "crack; 7"}
    )
    await client.send("*RST;:TRIG:IMM 'second'")
    assert await client.ask("*OPC?;CAPT:FREQ?") == "1;9.91E+37"
    assert daemon.asked[-1][1] == {"label": "second"}


async def test_what_the_daemon_refuses_is_in_the_queue_and_nothing_waits(serve, connect, daemon: FakeDaemon):
    daemon.errors["capture"] = (messages.DEVICE, "trigger: the port is gone")
    client = await connect(serve())
    await client.send("*OPC", "TRIG")
    assert await client.ask("*OPC?") == "1"
    assert await client.ask("SYST:ERR?") == '-240,"Hardware error;trigger: the port is gone"'
    assert await client.ask("CAPT?") == '"",""'


async def test_envelopes_in_a_line_by_target_as_csv_and_as_json(serve, connect, daemon: FakeDaemon):
    client = await connect(serve())
    assert await client.ask("ENV?") == '"",9.91E+37,0'
    daemon.outbox.add("envelope", capture="manual-000001", frequency_hz=5.0, targets=TARGETS)
    nan = "9.91E+37"
    first = f'0.5,0,0,0,-0.25,{nan},"at_rest;occluded"'
    second = ",".join([nan] * 6) + ',""'
    assert await client.ask("ENV?") == f'"manual-000001",5,2,"P1",{first},"P""2",{second}'
    assert await client.ask('ENV? "P1"') == first
    await client.send("ENV? 'P9'")
    assert (await client.ask("SYST:ERR?")).startswith("-230,")
    await client.send("ENV:CSV?")
    head = await client.reader.readexactly(5)
    text = (await client.reader.readexactly(int(head[2:]) + 1)).decode()
    lines = text.splitlines()
    assert lines[0].startswith("capture,target,x_mm")
    assert lines[1].startswith("manual-000001,P1,1.000000,,,0.500000,0.000000")
    assert lines[2:] == ['manual-000001,"P""2"' + "," * (lines[0].count(",") - 1), ""]
    await client.send("ENV:JSON?")
    assert (await client.answer()).startswith("#3")


async def test_the_next_envelope_is_waited_for(serve, connect, daemon: FakeDaemon):
    gateway = serve()
    client = await connect(gateway)
    assert await client.ask("ENV:NEXT? 0.05") == '"",9.91E+37,0'
    await client.send("ENV:NEXT?")
    answer = asyncio.create_task(client.answer())
    while not answer.done():  # the question may be on its way still when the first are committed
        daemon.outbox.add("fault", message="no envelope")
        gateway.feed.wake()
        daemon.outbox.add("envelope", capture="c", targets=[])
        gateway.feed.wake()
        await asyncio.sleep(0.01)
    assert await answer == '"c",9.91E+37,0'


async def test_stop_waits_for_nothing(serve, connect, daemon: FakeDaemon):
    daemon.hold.clear()
    client = await connect(serve())
    await client.send("TRIG", "*WAI", "STAT?", 'CAPT:LAB "stop";STOP')
    await until(lambda: "stop" in daemon.methods())
    assert "status" not in daemon.methods()
    daemon.hold.set()
    assert (await client.answer()).startswith('IDLE,REST,""')
    assert await client.ask("STOP?") == "REST"
    assert daemon.methods().count("stop") == 2
    await client.send('CAPT:LAB "stop;STOP')  # a string without its end: the table stops all the same
    await until(lambda: daemon.methods().count("stop") == 3)


async def test_a_query_that_waits_is_interrupted_by_the_next_line(serve, connect, daemon: FakeDaemon):
    daemon.hold.clear()
    client = await connect(serve())
    await client.send("TRIG", "*OPC?")
    await until(lambda: daemon.methods() == ["capture"])
    await asyncio.sleep(0.05)
    assert (await client.ask("STAT?")).startswith("IDLE")
    assert (await client.ask("SYST:ERR?")).startswith('-410,"Query INTERRUPTED')
    daemon.hold.set()
    assert await client.ask("*OPC?") == "1"


async def test_no_more_than_a_few_captures_of_one_client_wait(serve, connect, daemon: FakeDaemon):
    daemon.hold.clear()
    client = await connect(serve())
    await client.send(*["TRIG"] * (client_state.MOST_TRIGGERS + 1))
    assert (await client.ask("SYST:ERR?")).startswith("-211,")
    daemon.hold.set()
    assert await client.ask("*OPC?") == "1"
    assert daemon.shots == client_state.MOST_TRIGGERS


async def test_a_token_comes_first_where_one_is_set(serve, connect, daemon: FakeDaemon, token, monkeypatch):
    monkeypatch.setattr(client_state, "WRONG_TOKEN_S", 0.01)
    monkeypatch.setattr(text_gateway, "TOKEN_S", 0.3)
    gateway = serve(token=True)
    client = await connect(gateway)
    assert await client.ask("*IDN?") == "labdaemon,sim,1,0"
    await client.send("STOP", "TRIG", f"AUTH '{token[:-1]}'")
    assert (await client.ask("SYST:ERR:ALL?")).count("-203") == 3
    assert daemon.asked == []
    await client.send(f"AUTH '{token}'", "TRIG")
    assert await client.ask("*OPC?") == "1"
    assert daemon.asked[0][2] == "operator"
    guesser = await connect(gateway)
    await guesser.send("AUTH 'aaaaaaaaaaaaaaaaaaaa'", "AUTH 'b'", "AUTH 'c'", "*IDN?")
    assert await guesser.is_closed()
    silent = await connect(gateway)
    assert await silent.is_closed()
    assert (await client.ask("STAT?")).startswith("IDLE")


async def test_an_observer_may_look(serve, connect, daemon: FakeDaemon):
    client = await connect(serve(role=Role.OBSERVER))
    await client.send("TRIG")
    assert await client.ask("*OPC?") == "1"
    assert (await client.ask("SYST:ERR?")).startswith("-203,")
    assert {role for _, _, role in daemon.asked} == {Role.OBSERVER}


@pytest.mark.parametrize(
    "request_", [b"POST / HTTP/1.1\r", b"GET /x HTTP/1.0\r", b"Host: localhost\r", b"origin: http://evil\r"]
)
async def test_a_page_in_a_browser_cannot_post_commands(serve, connect, daemon: FakeDaemon, request_: bytes, caplog):
    client = await connect(serve())
    with caplog.at_level(logging.WARNING):
        await client.send(request_ + b"\n\r\nTRIG\nSTOP")
        assert await client.is_closed()
    assert daemon.asked == []
    assert "browser" in caplog.text


async def test_rubbish_half_lines_and_endless_lines(serve, connect, daemon: FakeDaemon, monkeypatch):
    gateway = serve()
    client = await connect(gateway)
    await client.send(bytes(set(range(256)) - set(b"\r\n")), b"\xff\xfb\x01", "x" * 5000, "*IDN?;" * 100)
    numbers = [int(error) for error in (await client.ask("SYST:ERR:ALL?")).replace('"', "").split(",")[::2]]
    assert numbers == [-101, -101, -363, -223]
    client.writer.write(b"TRI")
    client.writer.write_eof()
    assert await client.is_closed()
    assert daemon.asked == []
    monkeypatch.setattr("labdaemon.gateway.line_splitter.MOST_WITHOUT_END", 20_000)
    flood = await connect(gateway)
    flood.writer.write(b"x" * 60_000)
    assert await flood.is_closed()


async def test_lines_of_a_client_that_has_closed_its_side_are_carried_out(serve, connect, daemon: FakeDaemon):
    client = await connect(serve())
    await client.send("TRIG;*OPC?")
    client.writer.write_eof()
    assert await client.answer() == "1"
    assert await client.is_closed()


async def test_who_does_not_read_loses_the_connection(serve, connect, daemon: FakeDaemon, monkeypatch, caplog):
    monkeypatch.setattr(text_connection, "READS_S", 0.2)
    monkeypatch.setattr(text_gateway, "LINES_PER_S", 1e6)
    rows = [{"target": f"P{place}", "flags": []} for place in range(3000)]
    daemon.outbox.add("envelope", capture="c", targets=rows)
    gateway = serve()
    client, other = await connect(gateway), await connect(gateway)
    client.writer.transport.pause_reading()
    with caplog.at_level(logging.WARNING):
        await client.send(*["ENV:JSON?"] * 200)
        await until(lambda: len(gateway._connections) == 1)
    assert "did not read" in caplog.text
    assert (await other.ask("STAT?")).startswith("IDLE")


async def test_lines_that_come_in_one_segment_or_byte_by_byte_are_all_answered(serve, connect):
    client = await connect(serve())
    client.writer.write(b"*CLS\n*ESR?\r\n\n *IDN? \n")
    assert [await client.answer() for _ in range(2)] == ["0", "labdaemon,sim,1,0"]
    for byte in b"SYST:ERR?\n":
        client.writer.write(bytes([byte]))
        await client.writer.drain()
        await asyncio.sleep(0)
    assert await client.answer() == '0,"No error"'


async def test_many_connections_are_bounded_and_idle_ones_give_way(serve, connect, monkeypatch, caplog):
    monkeypatch.setattr(text_gateway, "MOST_CLIENTS", 3)
    gateway = serve()
    clients = [await connect(gateway) for _ in range(3)]
    for client in clients:
        assert await client.ask("*IDN?")
    with caplog.at_level(logging.WARNING):
        for _ in range(5):
            assert await (await connect(gateway)).is_closed()
    assert len(caplog.records) == 1  # one line a peer and minute
    monkeypatch.setattr(text_gateway, "IDLE_S", 0.0)
    assert await (await connect(gateway)).ask("*IDN?")
    assert await clients[0].is_closed()
    assert await clients[2].ask("*IDN?")


async def test_a_flood_leaves_others_their_turn(serve, connect, daemon: FakeDaemon):
    gateway = serve()
    flood, other = await connect(gateway), await connect(gateway)
    flood.writer.write(b"STAT?\n" * 3000)
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    for _ in range(5):
        assert await other.ask("STAT?")
    await other.send("STOP")
    await until(lambda: "stop" in daemon.methods())
    assert loop.time() - began_s < 60.0
    assert daemon.methods().count("status") < 3000


async def test_an_address_that_is_taken_is_refused_by_its_key(serve):
    from labdaemon.errors import ConfigError

    gateway = serve()
    other = text_gateway.TextGateway(gateway.address, gateway._context)
    with pytest.raises(ConfigError, match=r"gateway\.address.*taken"):
        other.bind()


def test_pyvisa_reads_and_triggers(serve_in_thread: Any, daemon_of_thread: Any):
    pyvisa = pytest.importorskip("pyvisa", reason="pyvisa is not installed")
    pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")
    daemon_of_thread.outbox.add("envelope", capture="manual-000001", frequency_hz=5.0, targets=TARGETS[:1])
    manager = pyvisa.ResourceManager("@py")
    try:
        name = f"TCPIP::127.0.0.1::{serve_in_thread}::SOCKET"
        with manager.open_resource(name, read_termination="\n", write_termination="\n", timeout=20_000) as lab:
            assert lab.query("*IDN?").split(",")[0] == "labdaemon"
            lab.write('CAPT:FREQ 5;AMPL 2;LAB "visa"')
            lab.write("TRIG")
            assert lab.query("*OPC?") == "1"
            assert lab.query("CAPT?").startswith('"manual-000001"')
            assert lab.query_ascii_values('ENV? "P1"', converter="s")[0] == "0.5"
            csv = lab.query_binary_values("ENV:CSV?", datatype="s", container=bytes)
            assert b"manual-000001,P1" in csv if isinstance(csv, bytes) else "manual-000001,P1" in csv[0].decode()
            assert lab.query("SYST:ERR?") == '0,"No error"'
    finally:
        manager.close()


async def test_a_client_that_went_without_a_word_is_watched_for(serve, connect, monkeypatch: pytest.MonkeyPatch):
    watched: list[int] = []

    def watch(peer: socket.socket, *, is_written_to: bool) -> None:
        listener.watch_peer(peer, is_written_to=is_written_to)
        watched.append(peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT))

    monkeypatch.setattr(text_gateway, "watch_peer", watch)
    client = await connect(serve())
    assert "labdaemon" in await client.ask("*IDN?")
    assert watched == [1000 * listener.GONE_S]
