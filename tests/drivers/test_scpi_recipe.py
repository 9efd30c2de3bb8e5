"""The guardian stops what the SCPI driver has set moving, from its recipe alone, in every dialect and on every wire."""

from __future__ import annotations

import socket
import threading
import time
from types import SimpleNamespace

import pytest

from labdaemon.capture.devices import StopRecipeSource
from labdaemon.guardian.recipe import from_json, to_json
from labdaemon.guardian.wire import StopFailure, open_port, stop_shaker
from labdrivers.sim.scpi_device import ScpiDevice
from labdrivers.sim.wire import PtyPort, TcpPort, WireDevice


class Load:
    level_v, running = 0.0, False

    def drive(self, *, level_v, running, **_):
        self.level_v, self.running = level_v, running

    @property
    def moves(self):
        return self.running and self.level_v > 0.0101


class OwnController(WireDevice):
    """Millimetres, START and HALT, and an OK after each setting; says how far it moves, not whether it is on."""

    def __init__(self, *, has_switch):
        super().__init__()
        self.mm, self.on, self.rest, self.has_switch = 0.0, False, b"", has_switch

    def receive(self, data):
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in filter(None, lines):
            word, _, value = line.decode().partition(" ")
            if word == "D":
                self.mm = float(value)
            elif word in ("START", "HALT"):
                self.on = word == "START"
                self.mm *= self.on
            answers = {"WHO": "SHAKE-O-MAT 7", "F?": "5 Hz", "D?": f"{self.mm} mm", "RUN?": "YES" * self.on or "NO"}
            self.send(answers.get(word, "OK").encode() + b"\r\n")


KEYSIGHT = {}
OLD = {"dialect": "33120a", "enable_line": True}
OWN = {
    "identify": "WHO", "setup": [], "set_frequency": "F {frequency_hz:.3f}", "get_frequency": "F?",
    "set_level": "D {amplitude_mm:.4f}", "get_level": "D?", "output_on": "START", "output_off": "HALT",
    "get_output": "RUN?", "on_replies": ["YES"], "off_replies": ["NO"], "error": "", "acknowledge": "OK",
}  # fmt: skip


def keysight():
    load = Load()
    device = ScpiDevice(load)
    device.receive(b"FREQ 5;VOLT 1;OUTP ON\n")
    return device, lambda: load.moves


def old_keysight():
    load = Load()
    device = ScpiDevice(load, output_switch=False)
    device.receive(b"FREQ 5;VOLT 1\n")
    return device, lambda: load.moves


def own(has_switch):
    controller = OwnController(has_switch=has_switch)
    controller.receive(b"D 2.0\nSTART\n")
    return controller, lambda: controller.on and controller.mm > 0


MAKERS = {
    "keysight": (KEYSIGHT, keysight),
    "33120a": (OLD, old_keysight),
    "templates": ({"commands": OWN, "drive": []}, lambda: own(True)),
    "templates without a switch": ({"commands": {**OWN, "get_output": ""}, "drive": []}, lambda: own(False)),
}


def recipe_of(make_shaker, url, **settings):
    driver = make_shaker(url, connect=False, **settings)
    assert isinstance(driver, StopRecipeSource)
    return from_json(to_json(driver.stop_recipe()))


@pytest.mark.parametrize("wire", ["pty", "tcp"])
@pytest.mark.parametrize("maker", MAKERS)
def test_a_moving_table_comes_to_rest(make_shaker, maker, wire):
    settings, make = MAKERS[maker]
    device, moves = make()
    port = PtyPort(device) if wire == "pty" else TcpPort(device)
    assert moves()
    stop_shaker(recipe_of(make_shaker, port.path if wire == "pty" else port.url, **settings), sleep=lambda _: None)
    assert not moves()
    port.close()


@pytest.mark.filterwarnings("ignore::DeprecationWarning:serial")  # pyserial's own, from its last release of 2020
def test_over_a_serial_server_by_rfc_2217(make_shaker):
    import serial.rfc2217

    device, moves = keysight()
    inner = TcpPort(device)
    far = serial.serial_for_url(inner.url, timeout=0.02)
    far.rts = far.dtr = True
    listener = socket.create_server(("127.0.0.1", 0))
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
    url = f"rfc2217://127.0.0.1:{listener.getsockname()[1]}"
    stop_shaker(recipe_of(make_shaker, url), sleep=lambda _: None)
    assert not moves()
    server.join(30)
    far.close()
    listener.close()
    inner.close()


@pytest.mark.parametrize(
    "fault", ["silent", "rubbish", "late", "hang_up", "half_answer", "no_line_end", "stuck_output"]
)
def test_it_is_no_rest_that_was_not_seen(make_shaker, fault):
    device, moves = keysight()
    port = TcpPort(device)
    recipe = recipe_of(make_shaker, port.url, timeout_s=0.2)
    device.faults.inject(fault, value=0.5 if fault == "late" else None)
    with pytest.raises(StopFailure):
        stop_shaker(recipe, sleep=lambda _: None)
    assert moves() == (fault == "stuck_output")  # the command comes through where only answers are broken
    device.faults.clear()
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:  # an answer that is still late may spoil a try
        try:
            stop_shaker(recipe, sleep=lambda _: None)
            break
        except StopFailure:
            continue
    assert not moves()
    port.close()


@pytest.mark.parametrize("delay_s", [0.01, 0.05, 0.1, 0.2])
def test_a_late_answer_to_the_dead_daemon_is_not_taken_for_rest(make_shaker, delay_s):
    """The daemon asked while the output was off; its answer comes when the guardian asks whether it is off now."""
    device, moves = keysight()
    port = TcpPort(device)
    recipe = recipe_of(make_shaker, port.url, timeout_s=0.3)
    device.faults.inject("stuck_output")
    device.send_later(delay_s, b"0\n" * 8)
    with pytest.raises(StopFailure):
        stop_shaker(recipe, sleep=lambda _: None)
    assert moves()
    port.close()


def test_what_starts_it_again_after_the_stop_is_seen(make_shaker):
    """Bytes of the dead daemon may be on their way in a serial server."""
    device, moves = keysight()
    port = TcpPort(device)
    recipe = recipe_of(make_shaker, port.url)
    stop_shaker(recipe, sleep=lambda _: device.receive(b"OUTP ON\n"))
    assert not moves()
    port.close()


def test_a_port_that_is_not_there(make_shaker):
    for port in ("/dev/nonexistent", "socket://127.0.0.1:1"):
        with pytest.raises(StopFailure, match="does not open"):
            stop_shaker(recipe_of(make_shaker, port))


def test_a_port_that_another_process_has_locked_is_opened_all_the_same(make_shaker):
    """A killed daemon that waits for a disk holds its lock on the port for as long."""
    device, moves = keysight()
    port = PtyPort(device)
    holder = make_shaker(port.path)
    recipe = recipe_of(make_shaker, port.path)
    open_port(recipe).close()
    stop_shaker(recipe, sleep=lambda _: None)
    assert not moves()
    holder.close()
    port.close()


def test_a_device_of_this_process_gives_no_recipe(make_shaker):
    assert make_shaker("sim://shaker", connect=False).stop_recipe() is None
    assert make_shaker("loop://", connect=False).stop_recipe() is None
