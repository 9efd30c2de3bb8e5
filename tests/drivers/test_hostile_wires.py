"""Whatever bytes come, a driver works or raises a `DeviceError` in bounded time; nothing else, and it never hangs.

Peers send valid answers cut, changed, doubled, delayed and mixed with noise, by seed.
"""

from __future__ import annotations

import os
import random
import threading
import time

import pytest

from labdaemon.errors import DeviceError
from labdrivers.gauge import LineGauge
from labdrivers.scpi import ScpiShaker
from labdrivers.sim.wire import PtyPort, WireDevice
from labdrivers.trigger_box import TriggerBox

pytestmark = pytest.mark.slow


def spoil(rng, data):
    """A valid answer as a bad cable, a wrong baud rate or a restarting device leaves it."""
    match rng.randrange(9):
        case 0:
            return b""
        case 1:
            return data[: rng.randrange(len(data) + 1)]
        case 2:
            at = rng.randrange(len(data))
            return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
        case 3:
            return data + data
        case 4:
            return rng.randbytes(rng.randrange(60)) + data
        case 5:
            return rng.randbytes(rng.randrange(200))
        case 6:
            return data[rng.randrange(len(data)) :] + b"\n"
    return data


class Spoiled(WireDevice):
    """Between a sound device and its host; attaches to the one as its host, to the other as its device."""

    def __init__(self, device, rng):
        super().__init__()
        self._device, self._rng = device, rng
        self._listener = lambda data: self.send(spoil(self._rng, data))
        device.attach(self._listener, lambda: None)

    def receive(self, data):
        self._device.receive(data)


def outcome(call, name):
    """How a call ended: ``worked``, or the kind of the device's error; it took bounded time and names the device."""
    start = time.monotonic()
    try:
        call()
        found = "worked"
    except DeviceError as exc:
        found = type(exc).__name__ if str(exc).startswith(name) else f"nameless: {exc}"
    assert time.monotonic() - start < 60.0
    assert "nameless" not in found
    return found


def calls_of(driver):
    if isinstance(driver, ScpiShaker):
        return [driver.connect, driver.state, lambda: driver.set(5.0, 0.2), driver.stop, driver.stop_now]
    if isinstance(driver, TriggerBox):
        shot = [lambda: driver.fire(0.01), lambda: driver.wait(0.05)]
        return [driver.connect, driver.raise_enable, driver.heartbeat, *shot, driver.drop_enable]
    return [driver.connect, lambda: driver.read(8.0, duration_s=0.2)]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ["shaker", "trigger", "gauge-table"])
def test_spoiled_serial_answers(rig, make_shaker, kind, seed):
    port = PtyPort(Spoiled(rig.wires[kind], random.Random(seed)))
    if kind == "shaker":
        driver = make_shaker(port.path, connect=False, timeout_s=0.1, ramp_mm_s=100.0)
    elif kind == "trigger":
        driver = TriggerBox("trigger", {"port": port.path, "timeout_s": 0.1})
    else:
        driver = LineGauge("gauge", {"port": port.path})
    outcomes = set()
    end = time.monotonic() + 2.0
    while time.monotonic() < end:
        outcomes.update(outcome(call, driver.name) for call in calls_of(driver))
    driver.close()
    port.close()
    assert len(outcomes) > 1, outcomes


@pytest.mark.parametrize("seed", range(2))
def test_spoiled_usb_answers(rig, make_camera, tmp_path, seed):
    usb, rng = rig.bus.cameras["left"], random.Random(seed)
    usb.body.card.add(os.urandom(3000))
    sound = usb._queue

    def queue(data, *, breaks=False):
        if rng.random() < 0.3:
            data = spoil(rng, data) if data else data
        sound(data, breaks=breaks or rng.random() < 0.02)

    usb._queue = queue
    camera = make_camera(connect=False, timeout_s=0.15)
    files = []
    calls = [
        camera.connect, lambda: files.extend(camera.files()), camera.status, camera.exposure_steps_s,
        lambda: camera.configure(exposure_s=0.01, iso=100), lambda: camera.wait_file(0.05),
        lambda: [camera.download(file, tmp_path / "f") for file in files[:1]],
    ]  # fmt: skip
    outcomes = set()
    end = time.monotonic() + 3.0
    while time.monotonic() < end:
        outcomes.update(outcome(call, "left") for call in calls)
        files.clear()
    usb._queue = sound
    assert len(outcomes) > 2, outcomes
    camera.close()
    camera.connect()
    (file,) = camera.files()
    (tmp_path / "f").unlink(missing_ok=True)
    camera.download(file, tmp_path / "f")
    assert (tmp_path / "f").stat().st_size == 3000


def test_a_host_killed_in_the_middle_of_a_transfer(rig, make_camera, tmp_path):
    """The next host finds half a data phase in the pipe and a session that is open already."""
    usb = rig.bus.cameras["left"]
    content = os.urandom(300_000)
    usb.body.card.add(content)
    first = make_camera()
    (file,) = first.files()
    from labdrivers.ptp.container import pack, pack_parameters

    session = first._session
    session._pipe.send(pack(1, 0x101B, 500, pack_parameters(file.handle, 0, 300_000)), 1.0)
    session._pipe._in.read(512, 1000)
    first._events.close()
    first._pipe.close()  # as the kernel does for a dead process: nothing is said to the camera
    first._session = first._events = first._pipe = None
    second = make_camera()
    second.download(file, tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == content


def test_nothing_is_left_behind_by_connecting_again_and_again(rig, make_shaker, make_camera):
    """Descriptors and threads stay what they are over many connections, failed ones included."""
    port = PtyPort(rig.trigger)
    shaker, camera = make_shaker(connect=False), make_camera(connect=False)
    trigger = TriggerBox("trigger", {"port": port.path})
    gauge = LineGauge("gauge", {"port": "sim://gauge-table"})
    drivers = [shaker, camera, trigger, gauge]

    def round_trip():
        for driver in drivers:
            driver.connect()
        rig.bus.unplug("left")
        with pytest.raises(DeviceError):
            camera.connect()
        rig.bus.plug("left")
        for driver in drivers:
            driver.close()

    round_trip()
    before = (len(os.listdir("/proc/self/fd")), threading.active_count())
    for _ in range(10):
        round_trip()
    assert (len(os.listdir("/proc/self/fd")), threading.active_count()) <= before
    port.close()
