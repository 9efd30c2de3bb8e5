from __future__ import annotations

import time
from datetime import UTC, datetime

import pytest

from labdaemon.errors import ConfigError, DeviceRefused, TransportError, UsageError
from labdrivers.rts_trigger import RtsTrigger
from labdrivers.sim.wire import PtyPort


@pytest.fixture
def cable(rig):
    return rig.wires["shutter"]


def make(**changes):
    return RtsTrigger("trigger", {"driver": "rts", "port": "sim://shutter", "press_s": 0.05, **changes})


def shots(rig):
    return len(rig.rig.records)


def test_a_shot(rig, cable, camera):
    trigger = make()
    assert trigger.connect() == "RTS line of sim://shutter"
    cable.armed = True
    errors_s = []
    for _ in range(5):  # a busy machine may make one shot late between its time and the edge, not each
        before = datetime.now(UTC)
        firing = trigger.fire(0.01)
        assert firing.opening_s == {}
        assert firing.phase_rad is None
        assert 0.05 < (firing.opened_at - before).total_seconds() < 20.0
        assert camera.wait_file(30.0) is not None
        opened = rig.rig.records[-1]["opened_s"] - rig.clock() + time.time()
        errors_s.append(abs(firing.opened_at.timestamp() - opened))
        if errors_s[-1] < 0.02:
            break
        time.sleep(0.15)  # until the body can be released again
    assert errors_s[-1] < 0.02, errors_s
    trigger.close()


def test_opening_the_port_twitches_the_line(rig, cable, eventually):
    """With the switch off nothing happens; with it on there is a shot, and wired back it is refused."""
    make().connect()
    time.sleep(0.3)
    assert shots(rig) == 0
    cable.armed = True
    with pytest.raises(DeviceRefused, match="switch it off, connect"):
        make(arm_input="cts").connect()
    assert eventually(lambda: shots(rig) == 2)


def test_a_switch_that_is_off_is_an_error_and_no_empty_capture(rig, cable):
    trigger = make(arm_input="dsr")
    trigger.connect()
    with pytest.raises(DeviceRefused, match="arm switch is off"):
        trigger.fire(0.01)
    cable.armed = True
    trigger.fire(0.01)
    trigger.close()


def test_bulb_is_held_for_the_exposure(cable):
    trigger = make(bulb=True)
    trigger.connect()
    cable.armed = True
    start = time.monotonic()
    trigger.fire(0.4)
    assert 0.4 <= time.monotonic() - start < 20.0
    trigger.close()


def test_what_it_cannot_do(cable):
    trigger = make()
    trigger.connect()
    with pytest.raises(UsageError, match="does not see the excitation"):
        trigger.fire(1.0, frequency_hz=5.0, phase_rad=0.0)
    assert trigger.wait(0.01) is None
    trigger.raise_enable()
    trigger.heartbeat()
    trigger.drop_enable()
    trigger.close()


def test_ports_without_lines(rig):
    with pytest.raises(ConfigError, match=r"trigger\.port.*carries no RTS"):
        make(port="socket://127.0.0.1:1")
    port = PtyPort(rig.trigger)
    trigger = make(port=port.path)
    trigger.connect()
    with pytest.raises(TransportError, match="has no such line"):
        trigger.fire(0.01)
    trigger.close()
    port.close()
