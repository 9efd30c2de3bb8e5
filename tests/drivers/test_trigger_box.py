from __future__ import annotations

import binascii
import math
import statistics
import threading
import time
from datetime import UTC, datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import ConfigError, DeviceRefused, ProtocolError, UsageError
from labdrivers.sim.assembly import SimulatedRig, set_default_rig
from labdrivers.sim.wire import PtyPort, TcpPort, WireDevice
from labdrivers.trigger_box import TriggerBox
from labdrivers.trigger_wire import CLOCK_WRAP, decode, elapsed_us, encode


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 65535), st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="*")))
def test_a_frame_survives_and_no_changed_byte_does(sequence, text):
    line = encode("<", sequence, text)
    frame = decode("<", line)
    assert frame is not None
    assert (frame.sequence, " ".join(frame.words)) == (sequence, text)
    assert decode(">", line) is None
    for at in range(1, len(line) - 6):
        changed = bytearray(line)
        changed[at] ^= 0x01
        assert decode("<", bytes(changed)) is None


@given(st.binary(max_size=40))
def test_rubbish_is_no_frame(data):
    frame = decode("<", data)
    assert frame is None or b"*" in data


def test_the_checksum_is_the_one_documented():
    assert encode(">", 7, "FIRE 1000000") == b">7 FIRE 1000000*%04X\n" % binascii.crc_hqx(b"7 FIRE 1000000", 0)


@given(st.integers(0, CLOCK_WRAP - 1), st.integers(-(2**30), 2**30))
def test_the_box_clock_may_wrap(start, step):
    assert elapsed_us((start + step) % CLOCK_WRAP, start) == step


def test_fires_all_cameras_and_tells_their_openings(rig, trigger):
    before = datetime.now(UTC)
    firing = trigger.fire(1.0)
    after = datetime.now(UTC)
    assert firing.opening_s["left"] == pytest.approx(0.0621, abs=4e-4)
    assert firing.opening_s["right"] == pytest.approx(0.0634, abs=4e-4)
    assert before < firing.opened_at < after
    assert firing.phase_rad is None  # nothing shakes


def test_opening_times_are_the_true_ones_on_the_host_clock(rig, trigger, camera):
    errors_s = []
    for _ in range(5):  # a busy machine may delay one answer of the box, not each
        firing = trigger.fire(0.01)
        assert camera.wait_file(30) is not None
        true = {record["camera"]: record["opened_s"] for record in rig.rig.records}
        measured = firing.opened_at.timestamp() - time.time() + rig.clock()
        errors_s.append(abs(measured - true["left"] - 0.00065))  # the mean of two
        if errors_s[-1] < 5e-3:
            break
        time.sleep(0.15)  # until the bodies can be released again
    assert errors_s[-1] < 5e-3, errors_s


@pytest.mark.parametrize("wanted", [0.0, math.pi / 2, 4.0])
def test_fires_at_a_phase_and_tells_the_phase_that_was(rig, trigger, shaker, camera, wanted):
    shaker.set(8.0, 0.2)
    trigger.fire(0.01, frequency_hz=8.0, phase_rad=wanted)  # learns the bodies' lag
    assert camera.wait_file(30) is not None
    time.sleep(0.15)
    firing = trigger.fire(0.01, frequency_hz=8.0, phase_rad=wanted)
    assert abs((firing.phase_rad - wanted + math.pi) % (2 * math.pi) - math.pi) < 0.03
    assert camera.wait_file(30) is not None
    record = next(r for r in reversed(rig.rig.records) if r["camera"] == "left")
    mean = sum(firing.opening_s.values()) / 2
    own = firing.phase_rad + 2 * math.pi * 8.0 * (firing.opening_s["left"] - mean)
    error = (own - record["phase_rad"] + math.pi) % (2 * math.pi) - math.pi
    assert abs(error) < 3 * firing.sd_phase_rad
    assert 0 < firing.sd_phase_rad < 0.02


def test_no_excitation_no_phase(trigger):
    with pytest.raises(DeviceRefused, match="NOSYNC"):
        trigger.fire(1.0, frequency_hz=5.0, phase_rad=0.0)
    with pytest.raises(UsageError):
        trigger.fire(1.0, phase_rad=0.0)
    with pytest.raises(UsageError):
        trigger.fire(-1.0)


def test_an_outside_release_is_noticed_once(rig, trigger):
    assert trigger.wait(0.05) is None
    threading.Timer(0.1, rig.trigger.external_edge).start()
    firing = trigger.wait(30.0)
    assert firing is not None
    assert set(firing.opening_s) == {"left", "right"}
    assert trigger.wait(0.05) is None


def test_edges_before_arming_do_nothing(rig, trigger):
    rig.trigger.external_edge()
    assert trigger.wait(0.1) is None
    assert rig.rig.records == []


class TestEnableLine:
    @pytest.fixture
    def wired(self, spec, tmp_path):
        found = SimulatedRig(spec, cards=tmp_path)
        set_default_rig(found)
        yield found
        set_default_rig(None)
        found.shut_down()

    @pytest.fixture
    def box(self, wired):
        driver = TriggerBox("trigger", {"port": "sim://trigger", "hold_enable_ms": 1500})
        driver.connect()
        yield driver
        driver.close()

    def test_without_it_the_table_stays_at_rest(self, wired, box, make_shaker):
        shaker = make_shaker()
        shaker.set(5.0, 1.0)
        time.sleep(0.3)
        assert not wired.moving()

    def test_when_heartbeats_stop_the_table_comes_to_rest(self, wired, box, make_shaker, eventually):
        shaker = make_shaker()
        box.raise_enable()
        shaker.set(5.0, 1.0)
        for _ in range(5):
            box.heartbeat()
            time.sleep(0.1)
        assert wired.moving()
        assert eventually(lambda: not wired.moving())
        with pytest.raises(DeviceRefused, match="enable line is down"):
            box.heartbeat()
        assert shaker.state().running  # the generator knows nothing of it: that is why it must be stopped first
        time.sleep(0.2)
        assert not wired.moving()

    def test_drop_is_at_once_and_lasts(self, wired, box, make_shaker, eventually):
        shaker = make_shaker()
        box.raise_enable()
        shaker.set(5.0, 1.0)
        box.drop_enable()
        assert not wired.trigger.enable_up
        with pytest.raises(DeviceRefused):
            box.heartbeat()
        assert eventually(lambda: not wired.moving())
        box.raise_enable()
        box.heartbeat()

    def test_it_falls_when_the_host_is_gone(self, wired, box, eventually):
        box.raise_enable()
        box.close()
        assert eventually(lambda: not wired.trigger.enable_up)

    def test_heartbeats_get_through_while_a_shot_is_awaited(self, wired, box):
        box.raise_enable()
        for camera in wired.bus.cameras.values():
            camera.body.faults.inject("no_shutter")  # so that the box waits two seconds for contacts
        shot = threading.Thread(target=box.fire, args=(1.0,))
        shot.start()
        delays = []
        while shot.is_alive():
            start = time.monotonic()
            box.heartbeat()
            delays.append(time.monotonic() - start)
            time.sleep(0.05)
        shot.join()
        assert len(delays) > 3
        assert statistics.median(delays) < 0.2, delays  # each would take 2 s if it waited for the shot


def test_a_lost_answer_does_not_fire_twice(rig, trigger):
    rig.trigger.faults.inject("silent", count=1)
    trigger.fire(1.0)
    assert rig.trigger._last_shot == 1


@pytest.mark.parametrize("expose", [PtyPort, TcpPort])
def test_over_a_pty_and_a_socket(rig, expose):
    port = expose(rig.trigger)
    driver = TriggerBox("trigger", {"port": getattr(port, "path", None) or port.url, "timeout_s": 0.5})
    assert driver.connect() == "labtrigger 1 SIM0001 4"
    assert set(driver.fire(1.0).opening_s) == {"left", "right"}
    driver.close()
    port.close()


def test_something_else_on_the_port():
    class Parrot(WireDevice):
        def receive(self, data):
            self.send(data)

    port = PtyPort(Parrot())
    driver = TriggerBox("trigger", {"port": port.path, "timeout_s": 0.1})
    with pytest.raises(ProtocolError, match="rubbish"):
        driver.connect()
    driver.close()
    port.close()


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"cameras": []}, "trigger.cameras"),
        ({"cameras": ["a", "b", "c", "d", "e"]}, "trigger.cameras"),
        ({"hold_enable_ms": 60000}, "trigger.hold_enable_ms"),
        ({"speed": 9600}, "trigger.speed"),
    ],
)
def test_wrong_settings(changes, key):
    with pytest.raises(ConfigError) as caught:
        TriggerBox("trigger", {"port": "sim://trigger", **changes})
    assert str(caught.value).startswith(key)
