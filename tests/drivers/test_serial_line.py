from __future__ import annotations

import os
import socket
import threading
import time
from types import SimpleNamespace

import pytest
import serial

from labdaemon.errors import ConfigError, ProtocolError, TransportError
from labdrivers.serial_line import PortSettings, SerialLine
from labdrivers.sim.wire import PtyPort, TcpPort, WireDevice


class Echo(WireDevice):
    """Says what it is told to, and keeps what it hears."""

    def __init__(self) -> None:
        super().__init__()
        self.heard = bytearray()

    def receive(self, data: bytes) -> None:
        self.heard += data
        self.send(data)


@pytest.fixture(params=["pty", "tcp"])
def wire(request):
    device = Echo()
    port = PtyPort(device) if request.param == "pty" else TcpPort(device)
    url = port.path if request.param == "pty" else port.url
    line = SerialLine("box", PortSettings(port=url, timeout_s=5.0), raise_lines=False)
    line.open()
    yield device, port, line
    line.close()
    port.close()


def until(seconds: float) -> float:
    return time.monotonic() + seconds


def talk_for(seconds, line):
    end = until(seconds)
    while time.monotonic() < end:
        line.write(b"anyone?\n")
        line.read_line(until(60))


def test_lines_come_back_whole_however_they_are_cut(wire):
    device, _, line = wire
    line.write(b"one\r\ntw")
    assert line.read_line(until(20)) == b"one"
    line.write(b"o\n\r\n\nthree\n")
    assert line.read_line(until(20)) == b"two"
    assert line.read_line(until(20)) == b"three"
    assert bytes(device.heard) == b"one\r\ntwo\n\r\n\nthree\n"


def test_silence_ends_at_the_deadline_and_says_what_came(wire):
    _, _, line = wire
    line.write(b"half")
    start = time.monotonic()
    with pytest.raises(TransportError, match=r"box: no answer on .*only b'half' came.*check power"):
        line.read_line(until(0.2))
    assert 0.2 <= time.monotonic() - start < 20.0


def test_bytes_without_an_end_of_line_are_rubbish(wire):
    _, _, line = wire
    line.write(b"U" * 5000)
    with pytest.raises(ProtocolError, match="baud rate"):
        line.read_line(until(20))


def test_discard_throws_everything_away(wire):
    _, _, line = wire
    line.write(b"old rubbish\nmore")
    assert line.discard(quiet_s=0.1) == b"old rubbish\nmore"
    line.write(b"new\n")
    assert line.read_line(until(20)) == b"new"


def test_a_closed_peer_is_a_transport_error_at_once(wire):
    device, port, line = wire
    line.write(b"x\n")
    line.read_line(until(20))
    device.hang_up() if isinstance(port, TcpPort) else port.close()
    start = time.monotonic()
    with pytest.raises(TransportError, match="lost while"):
        talk_for(60, line)
    assert time.monotonic() - start < 30.0
    line.close()
    with pytest.raises(TransportError, match="not connected"):
        line.write(b"x")


@pytest.mark.parametrize("call", ["read_line", "read_block", "discard", "write"])
def test_a_port_that_another_thread_closes_during_a_call_is_lost(wire, call):
    """The other thread's `close` has run, and this one's call is in pyserial already."""
    _, port, line = wire
    if isinstance(port, TcpPort):
        line._port._socket.close()
    else:
        os.close(line._port.fd)
        line._port.fd = None
    calls = {
        "read_line": lambda: line.read_line(until(0.2)),
        "read_block": lambda: line.read_block(5),
        "discard": line.discard,
        "write": lambda: line.write(b"x"),
    }
    with pytest.raises(TransportError, match="lost while"):
        calls[call]()


@pytest.mark.parametrize(
    ("number", "words"), [(13, "add your user to the group"), (2, "check cable"), (16, "check cable")]
)
def test_a_port_that_does_not_open_says_what_to_do(monkeypatch, number, words):
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "could not open port")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(TransportError, match=words):
        SerialLine("box", PortSettings(port="/dev/ttyUSB0")).open()


@pytest.mark.parametrize("error", [TypeError("an integer is required"), ValueError("-1"), OSError(9, "Bad file")])
def test_closing_a_port_that_another_thread_closes_is_harmless(wire, monkeypatch, error):
    line = wire[2]
    port = line._port

    def close() -> None:
        raise error

    with monkeypatch.context() as patched:
        patched.setattr(port, "close", close)
        line.close()
    assert not line.is_open
    port.close()


@pytest.mark.parametrize(
    ("url", "error", "words"),
    [
        ("/dev/does-not-exist", TransportError, "does not open"),
        ("socket://127.0.0.1:1", TransportError, "does not open"),
        ("nonsense://x", ConfigError, "protocol 'nonsense' not known"),
        ("socket://nothing", (ConfigError, TransportError), "socket://nothing"),
        ("sim://toaster", TransportError, "no simulated device 'toaster'"),
    ],
)
def test_ports_that_do_not_open(rig, url, error, words):
    with pytest.raises(error, match="box") as caught:
        SerialLine("box", PortSettings(port=url)).open()
    assert words in str(caught.value)


def test_a_port_can_be_opened_again(wire):
    _, _, line = wire
    line.close()
    line.open()
    line.write(b"again\n")
    assert line.read_line(until(20)) == b"again"


@pytest.mark.filterwarnings("ignore::DeprecationWarning:serial")  # pyserial's own, from its last release of 2020
def test_a_serial_server_by_rfc_2217(rig):
    """pyserial's own server side before a simulated device, its client side under the driver's line."""
    import serial.rfc2217

    known = SerialLine("box", PortSettings(port="sim://shaker"))
    known.open()  # makes the scheme known to pyserial
    known.close()
    listener = socket.create_server(("127.0.0.1", 0))
    far = serial.serial_for_url("sim://shaker", timeout=0.02)
    ended = threading.Event()

    def serve():
        peer, _ = listener.accept()
        manager = serial.rfc2217.PortManager(far, SimpleNamespace(write=peer.sendall))

        def outward():
            while not ended.is_set():
                if data := far.read(far.in_waiting or 1):
                    peer.sendall(b"".join(manager.escape(data)))

        back = threading.Thread(target=outward)
        back.start()
        while data := peer.recv(1024):
            far.write(b"".join(manager.filter(data)))
        ended.set()
        back.join()
        peer.close()

    server = threading.Thread(target=serve)
    server.start()
    line = SerialLine("box", PortSettings(port=f"rfc2217://127.0.0.1:{listener.getsockname()[1]}"))
    line.open()
    line.write(b"*IDN?\n")
    assert b"33522B" in line.read_line(until(20))
    line.close()
    server.join(30)
    assert not server.is_alive()
    far.close()
    listener.close()
