"""The shaker's driver against simulated instruments that nobody here wrote: pyvisa-sim's device engine on a pty.

Two of them: a generator spelled in pyvisa-sim's own language, and QCoDeS's model of a Keysight 33522B, which knows
neither frequency nor level and answers ERROR to them, where a real one would be silent.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError
from labdrivers.sim.wire import PtyPort, WireDevice

GENERATOR = """
spec: "1.1"
devices:
  generator:
    eom:
      ASRL INSTR:
        q: "\\n"
        r: "\\n"
    error:
      response: {}
      error_queue:
        - q: "SYST:ERR?"
          default: '+0,"No error"'
          command_error: '-113,"Undefined header"'
    dialogues:
      - q: "*IDN?"
        r: "Third Party,Generator,1,1.0"
      - q: "*CLS"
      - q: "FUNC SIN"
      - q: "VOLT:UNIT VPP"
      - q: "VOLT:OFFS 0"
    properties:
      frequency:
        default: 1000.0
        getter: {q: "FREQ?", r: "{:+.6E}"}
        setter: {q: "FREQ {:.6f}"}
        specs: {min: 0.001, max: 1000000.0, type: float}
      level:
        default: 0.1
        getter: {q: "VOLT?", r: "{:+.6E}"}
        setter: {q: "VOLT {:.5f}"}
        specs: {min: 0.002, max: 20.0, type: float}
      output:
        default: 0
        getter: {q: "OUTP?", r: "{}"}
        setter: {q: "OUTP {}"}
        specs: {valid: ["0", "1", "ON", "OFF"], type: str}
resources:
  ASRL1::INSTR:
    device: generator
"""


class PyvisaSimWire(WireDevice):
    """A pyvisa-sim device as a serial one: whole lines in, bytes out."""

    def __init__(self, device):
        super().__init__()
        self._device, self._lock = device, threading.Lock()
        self._rest = b""

    def receive(self, data):
        *lines, self._rest = (self._rest + data).split(b"\n")
        with self._lock:
            for line in filter(None, lines):
                self._device.write(line + b"\n")
                answer = bytearray()
                while chunk := self._device.read()[0]:
                    answer += chunk
                if answer:
                    self.send(bytes(answer))


@pytest.fixture
def generator(tmp_path):
    parser = pytest.importorskip("pyvisa_sim.parser", reason="pyvisa-sim, a SCPI peer of others, is not installed")
    file = tmp_path / "generator.yaml"
    file.write_text(GENERATOR)
    device = parser.get_devices(file, False)["ASRL1::INSTR"]
    port = PtyPort(PyvisaSimWire(device))
    yield device, port.path
    port.close()


def value(device, name):
    return device._properties[name].get_value()


def test_a_whole_excitation(generator, make_shaker):
    device, path = generator
    shaker = make_shaker(path)
    assert shaker.connect() == "Third Party,Generator,1,1.0"
    assert not shaker.state().running
    shaker.set(5.0, 1.0)
    assert value(device, "frequency") == 5.0
    assert value(device, "output") == "ON"
    assert shaker.state().amplitude_mm == pytest.approx(1.0, rel=1e-3)
    shaker.set(8.0, 0.5)
    assert value(device, "frequency") == 8.0
    shaker.stop()
    assert value(device, "output") == "OFF"
    shaker.set(8.0, 0.5)
    shaker.stop_now()
    assert value(device, "output") == "OFF"


def test_its_error_queue_is_read(generator, make_shaker):
    _, path = generator
    shaker = make_shaker(path, commands={"setup": ["*CLS", "BURS:STAT OFF"]})
    with pytest.raises(DeviceRefused, match="Undefined header"):
        shaker.set(5.0, 1.0)
    shaker.stop_now()


def test_qcodes_33522b_answers_error_to_frequency(make_shaker):
    parser = pytest.importorskip("pyvisa_sim.parser", reason="pyvisa-sim, a SCPI peer of others, is not installed")
    qcodes = pytest.importorskip("qcodes.instrument.sims", reason="QCoDeS, whose model this is, is not installed")
    file = Path(qcodes.__file__).with_name("Keysight_33xxx.yaml")
    port = PtyPort(PyvisaSimWire(parser.get_devices(file, False)["GPIB0::1::INSTR"]))
    shaker = make_shaker(port.path)
    assert "33522B" in shaker.connect()
    for call in (shaker.state, lambda: shaker.set(5.0, 1.0), shaker.stop_now):
        start = time.monotonic()
        with pytest.raises((ProtocolError, DeviceError), match="ERROR"):
            call()
        assert time.monotonic() - start < 60.0
    assert "33522B" in shaker.connect()  # it is back in step
    port.close()
