"""Every fault of the trigger box: noticed in bounded time or harmless, and never a second shot."""

from __future__ import annotations

import time
from contextlib import suppress

import pytest

from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError
from labdrivers.sim.trigger_device import FAULTS as TABLE

pytestmark = pytest.mark.slow


ON_FIRE = {
    "silent": (TransportError, "no answer"),
    "rubbish": (ProtocolError, "rubbish"),
    "late": (TransportError, "no answer|does not answer"),
    "hang_up": (TransportError, "lost"),
    "half_answer": (TransportError, "lost"),
    "wrong_checksum": (ProtocolError, "rubbish"),
    "wrong_sequence": (TransportError, "no answer"),
    "babble": (None, ""),
    "reboots": (TransportError, "no answer"),
    "no_release": (None, "no opening"),
    "no_contact": (None, "no opening"),
    "no_sync": (None, ""),
    "busy": (DeviceRefused, "BUSY"),
    "enable_drops": (None, ""),
    "enable_stuck": (None, ""),
    "absent": (None, ""),
}


def test_the_table_covers_every_fault():
    assert set(ON_FIRE) == set(TABLE)
    assert len(TABLE) >= 12


@pytest.mark.parametrize("fault", ON_FIRE)
def test_firing_with_a_fault(rig, trigger, eventually, fault):
    error, words = ON_FIRE[fault]
    rig.trigger.faults.inject(fault, value=2.0 if fault == "late" else None)
    start = time.monotonic()
    if error is None:
        firing = trigger.fire(1.0)
        assert bool(firing.opening_s) == (words != "no opening")
    else:
        with pytest.raises(error, match=words):
            trigger.fire(1.0)
    assert time.monotonic() - start < 30.0
    assert rig.trigger._last_shot <= 1
    rig.trigger.faults.clear()
    trigger.connect()
    time.sleep(0.2)  # a body that did fire is ready again
    assert eventually(lambda: fires(trigger))


def fires(trigger):
    with suppress(DeviceRefused):  # the shot that nobody was told of may still be under way
        return bool(trigger.fire(1.0).opening_s)


@pytest.mark.parametrize("fault", ["silent", "rubbish", "wrong_checksum", "wrong_sequence", "babble", "late"])
def test_one_bad_answer_costs_a_retry_and_no_second_shot(rig, trigger, fault):
    rig.trigger.faults.inject(fault, count=1, value=0.4 if fault == "late" else None)
    assert trigger.fire(1.0).opening_s
    assert rig.trigger._last_shot == 1


def test_an_enable_line_that_falls_is_noticed_by_the_next_heartbeat(rig, trigger):
    trigger.raise_enable()
    trigger.heartbeat()
    rig.trigger.faults.inject("enable_drops", count=1)
    with pytest.raises(DeviceRefused, match="down"):
        trigger.heartbeat()
    with pytest.raises(DeviceRefused, match="down"):
        trigger.heartbeat()


def test_a_box_that_restarts_drops_the_line_and_forgets_its_shots(rig, trigger):
    trigger.raise_enable()
    trigger.fire(1.0)
    rig.trigger.faults.inject("reboots", count=1)
    with pytest.raises(DeviceError):
        trigger.heartbeat()
    assert not rig.trigger.enable_up
    assert trigger.fire(1.0).opening_s


def test_no_sync_means_no_phase(rig, trigger, shaker):
    shaker.set(5.0, 0.2)
    rig.trigger.faults.inject("no_sync")
    assert trigger.fire(1.0, frequency_hz=5.0).phase_rad is None
    time.sleep(1.2)
    with pytest.raises(DeviceRefused, match="NOSYNC"):
        trigger.fire(1.0, frequency_hz=5.0, phase_rad=0.0)
