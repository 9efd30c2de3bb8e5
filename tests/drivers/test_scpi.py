from __future__ import annotations

import math
import statistics
import threading
import time
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest

from labdaemon.errors import ConfigError, DeviceError, DeviceRefused, LimitError
from labdrivers.sim.scpi_device import ScpiDevice
from labdrivers.sim.wire import PtyPort, TcpPort, WireDevice


class Load:
    """Keeps what the generator puts out."""

    def __init__(self):
        self.history = []

    def drive(self, **output):
        self.history.append(output)


class OwnController(WireDevice):
    """Another maker's controller: millimetres, START and HALT, and an OK after each setting."""

    def __init__(self):
        super().__init__()
        self.f, self.mm, self.on, self.rest = 1.0, 0.0, False, b""

    def receive(self, data):
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in filter(None, lines):
            word, _, value = line.decode().partition(" ")
            answers = {
                "WHO": "SHAKE-O-MAT 7",
                "F?": f"{self.f} Hz",
                "D?": f"{self.mm} mm",
                "RUN?": "YES" * self.on or "NO",
            }
            if word in answers:
                self.send(answers[word].encode() + b"\r\n")
                continue
            if word == "F":
                self.f = float(value)
            elif word == "D":
                self.mm = float(value)
            elif word in ("START", "HALT"):
                self.on = word == "START"
            self.send(b"OK\r\n")


def test_identity_moves_nothing(rig, shaker):
    assert "33522B" in shaker.connect()
    assert not rig.moving()
    assert not shaker.state().running


def test_what_is_set_moves_the_table_by_so_much(rig, shaker, eventually):
    shaker.set(5.0, 2.0)
    state = shaker.state()
    assert state.running
    assert state.frequency_hz == pytest.approx(5.0)
    assert state.amplitude_mm == pytest.approx(2.0, rel=2e-3)
    time.sleep(0.6)  # the amplifier follows within a few tenths of a second
    now = rig.clock()
    table = rig.rig.table_mm(now - 0.2 + 0.001 * np.arange(200))
    assert abs(table).max() == pytest.approx(2.0, rel=5e-3)
    shaker.stop()
    assert not shaker.state().running
    assert eventually(lambda: not rig.moving())


@pytest.mark.parametrize("expose", [PtyPort, TcpPort])
def test_ramps_and_never_jumps(make_shaker, expose):
    load = Load()
    port = expose(ScpiDevice(load))
    shaker = make_shaker(getattr(port, "path", None) or port.url, ramp_mm_s=8.0)
    shaker.set(5.0, 2.0)
    shaker.set(12.0, 0.5)
    shaker.set(12.5, 0.5)
    shaker.stop()
    on = [output for output in load.history if output["running"]]
    levels = [output["level_v"] for output in on]
    assert max(abs(b - a) for a, b in pairwise(levels)) < 0.14  # 0.4 mm a tick at most
    for before, after in pairwise(on):
        if abs(after["frequency_hz"] / before["frequency_hz"] - 1) > 0.1:
            assert before["level_v"] == pytest.approx(0.01)  # a large change of frequency happens at rest
    assert {5.0, 12.0, 12.5} <= {output["frequency_hz"] for output in on}
    assert load.history[-1]["running"] is False
    port.close()


@pytest.mark.parametrize(
    ("frequency_hz", "amplitude_mm", "words"),
    [
        (0.5, 76.0, "stroke"),
        (2.3, 74.0, "velocity"),
        (20.0, 2.0, "acceleration"),
        (0.1, 1.0, "outside"),
        (math.nan, 1.0, "no excitation"),
        (5.0, -1.0, "no excitation"),
        (5.0, math.inf, "no excitation"),
        (40.0, 0.01, "calibrated from 2 to 30 Hz"),
        (5.0, 0.01, r"below the generator's 0\.01 V; at least 0\.037 mm"),
    ],
)
def test_beyond_the_table_nothing_is_sent(rig, shaker, frequency_hz, amplitude_mm, words):
    with pytest.raises(LimitError, match=words):
        shaker.set(frequency_hz, amplitude_mm)
    assert shaker.state().frequency_hz == 1000.0
    assert not shaker.state().running


def test_a_level_beyond_the_generator_is_refused(rig, make_shaker):
    shaker = make_shaker(highest_level_v=1.0)
    with pytest.raises(LimitError, match="limit 1 V"):
        shaker.set(5.0, 20.0)


def test_trim_corrects_a_wrong_calibration(rig, make_shaker, eventually):
    wrong = [{"frequency_hz": f, "mm_per_v": 3.0} for f in (4.0, 6.0)]
    shaker = make_shaker(drive=wrong)
    shaker.set(5.0, 1.0)
    moved = abs(rig.rig.spec.table.response(5.0)) / 3.0
    shaker.trim(moved)
    shaker.set(5.0, 1.0)
    assert rig.shaker._level_vpp / 2 * abs(rig.rig.spec.table.response(5.0)) == pytest.approx(1.0, rel=1e-3)
    assert shaker.state().amplitude_mm == pytest.approx(1.0, rel=2e-3)
    with pytest.raises(DeviceRefused, match="calibration"):
        shaker.trim(10.0)
    shaker.set(4.0, 1.0)  # another frequency: the correction is forgotten
    assert rig.shaker._level_vpp / 2 == pytest.approx(1 / 3, rel=1e-3)
    shaker.stop()


def test_a_generator_left_running_at_an_unknown_frequency_is_stopped(rig, make_shaker):
    rig.shaker.receive(b"FREQ 45;VOLT 1;OUTP ON\n")
    shaker = make_shaker()
    assert shaker.state().running
    assert math.isnan(shaker.state().amplitude_mm)
    shaker.set(5.0, 0.5)
    assert shaker.state().amplitude_mm == pytest.approx(0.5, rel=1e-2)
    rig.shaker.receive(b"FREQ 45\n")
    shaker.stop()
    assert not shaker.state().running


def test_stop_now_interrupts_a_ramp_and_it_stays_stopped(rig, make_shaker, eventually):
    shaker = make_shaker(ramp_mm_s=0.05)  # the ramp takes 100 s
    outcome = []

    def ramp():
        try:
            shaker.set(5.0, 5.0)
        except DeviceError as exc:
            outcome.append(exc)

    thread = threading.Thread(target=ramp)
    thread.start()
    assert eventually(lambda: rig.shaker._output)
    start = time.monotonic()
    shaker.stop_now()
    thread.join(30)
    assert time.monotonic() - start < 30
    assert not thread.is_alive()
    assert isinstance(outcome[0], DeviceRefused)
    assert "stopped" in str(outcome[0])
    time.sleep(0.2)
    assert not shaker.state().running


def test_output_off_is_sent_within_100_ms_whatever_the_driver_waits_for(rig, make_shaker, eventually):
    """While another thread waits for an answer that does not come. The bench states the 99th percentile; a busy
    machine may delay single ones here, but half of them only if the stop waits for that thread."""
    shaker = make_shaker(timeout_s=2.0)
    delays = []
    for _ in range(15):
        rig.shaker.receive(b"OUTP ON\n")
        rig.shaker.faults.inject("silent", count=1)
        waiting = threading.Thread(target=lambda: _swallow(shaker.state))
        waiting.start()
        assert eventually(lambda: not rig.shaker.faults.is_on("silent"))
        start = time.monotonic()
        stopping = threading.Thread(target=shaker.stop_now)
        stopping.start()
        while rig.shaker._output and time.monotonic() < start + 2:
            time.sleep(0.0005)
        delays.append(time.monotonic() - start)
        rig.shaker.send(b"1\n")  # wake the waiting thread: its answer comes late
        stopping.join(30)
        waiting.join(30)
        assert not stopping.is_alive()
    assert statistics.median(delays) < 0.1, delays
    assert max(delays) < 2.0, delays


def _swallow(call):
    with suppress(DeviceError):
        call()


def test_stop_now_works_right_after_connect(rig, make_shaker):
    rig.shaker.receive(b"FREQ 5;VOLT 1;OUTP ON\n")
    make_shaker().stop_now()
    assert not rig.shaker._output


def test_a_generator_without_output_switch_needs_the_enable_line(make_shaker):
    with pytest.raises(ConfigError, match=r"shaker\.enable_line.*no output-off"):
        make_shaker(dialect="33120a", connect=False)


def test_a_generator_without_output_switch_stops_at_its_lowest_level(make_shaker):
    load = Load()
    port = TcpPort(ScpiDevice(load, output_switch=False, identity="HEWLETT-PACKARD,33120A,0,7.0-4.0-1.0"))
    shaker = make_shaker(port.url, dialect="33120a", enable_line=True)
    assert not shaker.can_switch_off
    shaker.set(5.0, 1.0)
    assert shaker.state().running
    shaker.stop()
    assert load.history[-1]["level_v"] == pytest.approx(0.01)
    assert not shaker.state().running
    shaker.set(5.0, 1.0)
    shaker.stop_now()
    assert load.history[-1]["level_v"] == pytest.approx(0.01)
    port.close()


def test_no_level_follows_a_stop_where_only_levels_stop(make_shaker):
    """Without an output switch a ramp's next step would start the table again."""
    load = Load()
    port = TcpPort(ScpiDevice(load, output_switch=False))
    shaker = make_shaker(port.url, dialect="33120a", enable_line=True, ramp_mm_s=2.0)
    for delay in (0.1, 0.23, 0.31):
        ramp = threading.Thread(target=_swallow, args=(lambda: shaker.set(5.0, 5.0),))
        ramp.start()
        time.sleep(delay)
        shaker.stop_now()
        ramp.join(30)
        assert not ramp.is_alive()
        time.sleep(0.1)
        assert load.history[-1]["level_v"] == pytest.approx(0.01)
    port.close()


def test_another_makers_controller_needs_no_code(make_shaker):
    controller = OwnController()
    port = PtyPort(controller)
    commands = {
        "identify": "WHO", "setup": [], "set_frequency": "F {frequency_hz:.3f}", "get_frequency": "F?",
        "set_level": "D {amplitude_mm:.4f}", "get_level": "D?", "output_on": "START", "output_off": "HALT",
        "get_output": "RUN?", "on_replies": ["YES"], "off_replies": ["NO"], "error": "", "acknowledge": "OK",
    }  # fmt: skip
    shaker = make_shaker(port.path, commands=commands, drive=[])
    assert shaker.connect() == "SHAKE-O-MAT 7"
    shaker.set(8.0, 1.25)
    assert (controller.f, controller.mm, controller.on) == (8.0, 1.25, True)
    assert shaker.state().amplitude_mm == 1.25
    shaker.stop()
    assert not controller.on
    port.close()


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"prot": "x"}, "shaker.prot"),
        ({"limits": {"stroke_mm": 150}}, "shaker.limits"),
        ({"limits": None}, "shaker.limits"),
        ({"ramp_mm_s": -1}, "shaker.ramp_mm_s"),
        ({"dialect": "klingon"}, "shaker.dialect"),
        ({"drive": []}, "shaker.drive"),
        ({"drive": [{"frequency_hz": 5, "mm_per_v": 0}]}, "shaker.drive.0.mm_per_v"),
        ({"drive": [{"frequency_hz": 5, "mm_per_v": 1}] * 2}, "shaker.drive"),
        ({"commands": {"set_level": "VOLT"}}, "shaker.commands.set_level"),
        ({"commands": {"set_level": "VOLT {speed}"}}, "shaker.commands.set_level"),
        ({"commands": {"set_levle": "VOLT {level_v}"}}, "shaker.commands.set_levle"),
        ({"calibration": "/nowhere.csv"}, "/nowhere.csv"),
    ],
)
def test_wrong_settings_are_named_with_their_path(make_shaker, changes, key):
    with pytest.raises(ConfigError) as caught:
        make_shaker(connect=False, **changes)
    assert str(caught.value).startswith(key)


def test_calibration_file(tmp_path, rig, make_shaker):
    file = tmp_path / "drive.csv"
    file.write_text("frequency_hz,mm_per_v,sd\n4,4.0,0.1\n9,1.5,0.1\n")
    shaker = make_shaker(calibration=str(file))
    shaker.set(6.0, 0.4)  # halfway in log-log: sqrt(4 * 1.5) mm/V
    assert rig.shaker._level_vpp / 2 == pytest.approx(0.4 / math.sqrt(6.0), rel=1e-3)
    file.write_text("frequency_hz,mm_per_v\n4,4.0\n9,many\n")
    with pytest.raises(ConfigError, match=r"drive\.csv: line 3"):
        make_shaker(calibration=str(file))
