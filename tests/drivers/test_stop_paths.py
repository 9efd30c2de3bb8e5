"""Stops on wires that broke, hang or are slow: opened anew by the stop itself, and on the wire at once."""

from __future__ import annotations

import re
import statistics
import threading
import time
from contextlib import suppress

import pytest

from labdaemon.errors import DeviceError, TransportError
from labdrivers.scpi import ScpiShaker
from labdrivers.sim.scpi_device import ScpiDevice
from labdrivers.sim.wire import TcpPort

pytestmark = pytest.mark.slow

BYTE_S = 10 / 9600
REPLY_S = 0.02
LOWERS = re.compile(rb"OUTP OFF|VOLT (?P<level>[0-9.]+)")


@pytest.mark.parametrize("how", ["stop", "stop_now"])
def test_a_wire_that_broke_is_opened_anew_by_the_stop(rig, shaker, eventually, how: str):
    shaker.set(5.0, 1.0)
    rig.shaker.hang_up()
    if how == "stop":
        with pytest.raises(TransportError):  # the soft stop leaves a broken wire to the hard one
            shaker.stop()
    shaker.stop_now()
    assert not shaker.state().running
    assert eventually(lambda: not rig.moving())


def test_a_port_that_is_gone_for_a_while_is_stopped_when_it_is_back(rig, shaker, eventually):
    shaker.set(5.0, 1.0)
    rig.shaker.faults.inject("absent")
    rig.shaker.hang_up()
    for _ in range(3):
        with pytest.raises(TransportError):
            shaker.stop_now()
    assert rig.moving()
    rig.shaker.faults.clear()
    shaker.stop_now()
    assert eventually(lambda: not rig.moving())


def test_a_stop_needs_no_connect_before_it(rig, shaker):
    shaker.set(5.0, 1.0)
    other = ScpiShaker.for_stopping("shaker", {"driver": "scpi", "port": "sim://shaker", "colour": 3})
    other.stop_now()
    assert not other.state().running
    other.close()


def test_a_controller_that_obeys_nothing_is_never_called_rest(rig, shaker):
    shaker.set(5.0, 1.0)
    rig.shaker.faults.inject("deaf")
    for stop in (shaker.stop, shaker.stop_now):
        with pytest.raises(DeviceError, match="stays on although it was switched off"):
            stop()
    assert shaker.state().running


def test_a_drop_opens_a_broken_wire_anew(rig, trigger):
    trigger.raise_enable()
    rig.trigger.hang_up()
    trigger.drop_enable()
    assert not rig.trigger.enable_up
    rig.trigger.faults.inject("absent")
    rig.trigger.hang_up()
    with pytest.raises(TransportError):
        trigger.drop_enable()
    rig.trigger.faults.clear()
    trigger.drop_enable()


def test_a_drop_does_not_wait_for_another_thread_s_exchange(rig, trigger, eventually):
    trigger.raise_enable()
    rig.trigger.faults.inject("silent", count=1)

    def hold() -> None:
        with suppress(DeviceError):  # asked again after the drop, it finds the line down
            trigger.heartbeat()

    waiting = threading.Thread(target=hold)
    waiting.start()
    eventually(lambda: not rig.trigger.faults.is_on("silent"))
    trigger.drop_enable()
    assert not rig.trigger.enable_up
    with pytest.raises(DeviceError, match="enable line is down"):
        trigger.heartbeat()
    waiting.join()


class SlowGenerator(ScpiDevice):
    """A generator on a wire of 9600 baud that takes 20 ms for a reply; notes when commands are in.

    Attributes
    ----------
    heard
        Monotonic time and text of each command, when its last byte is in.
    """

    def __init__(self, load: object) -> None:
        self.heard: list[tuple[float, bytes]] = []
        self._free_s = 0.0
        super().__init__(load)  # type: ignore[arg-type]

    def receive(self, data: bytes) -> None:
        for line in data.splitlines(keepends=True):
            self._free_s = max(time.monotonic(), self._free_s) + len(line) * BYTE_S
            time.sleep(max(self._free_s - time.monotonic(), 0.0))
            self.heard.append((self._free_s, line))
            super().receive(line)

    def send(self, data: bytes) -> None:
        self.send_later(REPLY_S + len(data) * BYTE_S, data)

    def _send_held(self) -> None:
        with self._wire_lock:
            held, self._held = bytes(self._held or b""), None
        ScpiDevice.__base__.send(self, held)  # type: ignore[union-attr]


class NoLoad:
    """Nothing hangs on it."""

    def drive(self, **output: object) -> None:
        """Ignored."""


def test_the_first_lowering_command_of_a_soft_stop_is_on_a_slow_wire_within_a_tenth_of_a_second(make_shaker, request):
    generator = SlowGenerator(NoLoad())
    port = TcpPort(generator)
    request.addfinalizer(port.close)
    shaker = make_shaker(port.url, timeout_s=2.0)
    delays = []
    for _ in range(6):
        shaker.set(5.0, 2.0)
        asking = threading.Thread(target=shaker.state)
        asking.start()
        time.sleep(0.015)  # in mid-exchange
        before = len(generator.heard)
        asked_s = time.monotonic()
        shaker.stop()
        asking.join()
        level = 2.0 / 1.85 * 2
        lowering = [
            at_s
            for at_s, line in generator.heard[before:]
            if (found := LOWERS.match(line)) and (found["level"] is None or float(found["level"]) < level)
        ]
        delays.append(lowering[0] - asked_s)
    shaker.close()
    assert statistics.median(delays) <= 0.1, delays


def test_a_controller_that_reports_its_amplifier_says_when_the_line_drops(rig, make_shaker, trigger):
    shaker = make_shaker(commands={"get_amplifier": "AMPL:STAT?"})
    assert shaker.reports_amplifier
    assert shaker.state().amplifier_on is True  # this rig's amplifier is always enabled
    assert make_shaker().state().amplifier_on is None


@pytest.mark.parametrize("how", ["stop", "stop_now"])
def test_a_stop_at_rest_moves_nothing(rig, shaker, how: str):
    shaker.set(5.0, 1.0)
    shaker.stop_now()
    for _ in range(3):
        getattr(shaker, how)()
        assert not rig.shaker._output
    assert not shaker.state().running
