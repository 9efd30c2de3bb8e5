"""Every fault of the generator: noticed in bounded time by what it breaks, and over once the fault is."""

from __future__ import annotations

import threading
import time

import pytest

from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError
from labdrivers.sim.scpi_device import FAULTS as TABLE

pytestmark = pytest.mark.slow


LONGEST_S = 30.0
"""Of one call with a timeout of 0.4 s: three tries and their clearing up take 2 s, on a busy machine more."""

ON_SET = {
    "silent": (TransportError, "no answer"),
    "rubbish": (ProtocolError, "baud rate"),
    "no_line_end": (ProtocolError, "end of line"),
    "late": (TransportError, "no answer"),
    "hang_up": (TransportError, "lost"),
    "half_answer": (TransportError, "lost"),
    "output_stays_off": (DeviceRefused, "output off"),
    "ignores_level": (DeviceRefused, "set to 5 Hz, 1 mm, reports 5 Hz"),
    "ignores_frequency": (DeviceRefused, "reports 1000 Hz"),
    "queue_full": (ProtocolError, "never empties.*overflow"),
    "refuses": (DeviceRefused, "Settings conflict"),
    "deaf": (DeviceRefused, "reports 1000 Hz"),
    "wrong_value": (DeviceRefused, "set to 5 Hz, 1 mm, reports 5 Hz, 1.5 mm"),
}
ON_STOP = {
    "stuck_output": (DeviceRefused, "stays on"),
    "reboots": (None, ""),
    "absent": (TransportError, "lost"),
}


def test_the_tables_cover_every_fault():
    assert set(ON_SET) | set(ON_STOP) == set(TABLE)
    assert len(TABLE) >= 12


@pytest.mark.parametrize("fault", ON_SET)
def test_setting_with_a_fault(rig, shaker, eventually, fault):
    error, words = ON_SET[fault]
    rig.shaker.faults.inject(fault, value=1.0 if fault == "late" else None)
    start = time.monotonic()
    with pytest.raises(error, match=words):
        shaker.set(5.0, 1.0)
    assert time.monotonic() - start < LONGEST_S
    rig.shaker.faults.clear()
    shaker.connect()
    shaker.stop_now()
    assert not rig.shaker._output
    assert eventually(lambda: not rig.moving())
    shaker.set(5.0, 1.0)
    assert shaker.state().amplitude_mm == pytest.approx(1.0, rel=5e-3)


@pytest.mark.parametrize("fault", ["silent", "rubbish", "late", "hang_up", "half_answer", "no_line_end"])
def test_stopping_with_a_broken_wire_switches_off_all_the_same(rig, shaker, eventually, fault):
    """The answers are broken, the commands get through: the table must be at rest although the driver cannot know."""
    shaker.set(5.0, 1.0)
    rig.shaker.faults.inject(fault, value=1.0 if fault == "late" else None)
    start = time.monotonic()
    with pytest.raises(DeviceError):
        shaker.stop_now()
    assert time.monotonic() - start < LONGEST_S
    assert not rig.shaker._output
    assert eventually(lambda: not rig.moving())


@pytest.mark.parametrize("fault", ["silent", "rubbish", "late", "no_line_end"])
def test_one_lost_answer_does_not_spoil_a_stop(rig, shaker, fault):
    shaker.set(5.0, 1.0)
    rig.shaker.faults.inject(fault, count=1, value=0.6 if fault == "late" else None)
    shaker.stop_now()
    assert not shaker.state().running


def test_an_output_that_stays_on_is_never_called_rest(rig, shaker):
    shaker.set(5.0, 1.0)
    rig.shaker.faults.inject("stuck_output")
    for stop in (shaker.stop, shaker.stop_now):
        with pytest.raises(DeviceRefused, match=r"stays on although it was switched off; drop the enable line"):
            stop()
    rig.shaker.faults.clear()
    shaker.stop()


def test_an_answer_that_comes_late_is_not_taken_for_the_next(rig, shaker):
    """The late answer to one question arrives while the next is asked; the numbers must not change places."""
    shaker.set(5.0, 1.0)
    for delay in (0.5, 0.6, 0.8):
        rig.shaker.faults.inject("late", count=1, value=delay)
        with pytest.raises(TransportError):
            shaker.state()
        state = shaker.state()
        assert (state.frequency_hz, state.amplitude_mm) == (5.0, pytest.approx(1.0, rel=5e-3))


def test_a_generator_that_restarts_is_found_out(rig, shaker, eventually):
    shaker.set(5.0, 1.0)
    rig.shaker.faults.inject("reboots", count=1)
    state = None
    try:
        state = shaker.state()  # its question falls into the restart
    except TransportError:
        state = shaker.state()
    assert not state.running
    assert state.frequency_hz == 1000.0
    shaker.set(5.0, 1.0)
    assert shaker.state().running


def test_a_restart_while_ramping_is_found_out(rig, make_shaker):
    shaker = make_shaker(ramp_mm_s=0.1)  # the ramp takes 20 s, the restart comes in its first
    threading.Timer(0.6, rig.shaker.faults.inject, args=("reboots",), kwargs={"count": 1}).start()
    with pytest.raises(DeviceError):
        shaker.set(5.0, 2.0)
    shaker.stop_now()


def test_a_pulled_plug_and_its_return(rig, make_shaker):
    from labdrivers.sim.wire import TcpPort

    port = TcpPort(rig.shaker)
    shaker = make_shaker(port.url)
    shaker.set(5.0, 1.0)
    rig.shaker.hang_up()
    with pytest.raises(TransportError, match="check cable"):
        shaker.state()
    assert rig.moving()  # the cable's loss does not stop a generator: that is what the enable line is for
    shaker.connect()
    shaker.stop_now()
    assert not shaker.state().running
    port.close()
