from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labdrivers.ptp.camera import PtpCamera
from labdrivers.ptp.codes import Prop
from labdrivers.scpi import ScpiShaker
from labdrivers.sim.assembly import SimulatedRig, set_default_rig
from labdrivers.sim.spec import RigSpec
from labdrivers.trigger_box import TriggerBox

SPEC = RigSpec()
PATIENCE_S = 30.0
"""Longer than a busy machine takes for anything here; what never happens costs so long."""
LIMITS = {
    "stroke_mm": SPEC.table.stroke_mm,
    "velocity_mm_s": SPEC.table.velocity_mm_s,
    "acceleration_mm_s2": SPEC.table.acceleration_mm_s2,
    "frequency_hz": list(SPEC.table.frequency_hz),
}
DRIVE = [{"frequency_hz": f, "mm_per_v": gain} for f, gain in SPEC.table.calibration()]


def small_spec(**changes: Any) -> RigSpec:
    """The usual rig with frames of 64 x 48 pixels."""
    return replace(SPEC, cameras={n: replace(c, image_size=(64, 48)) for n, c in SPEC.cameras.items()}, **changes)


def shaker_settings(port: str = "sim://shaker", **changes: Any) -> dict[str, Any]:
    base = {"driver": "scpi", "port": port, "limits": LIMITS, "drive": DRIVE, "timeout_s": 0.4, "ramp_mm_s": 40.0}
    return {**base, **changes}


def eventually(condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> bool:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.01)
    return condition()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[SimulatedRig]:
    """A rig of its own behind ``sim://`` and the ``sim`` backend; its amplifier needs no enable line.

    Its cameras stand at 1/100 s.
    """
    found = SimulatedRig(small_spec(), cards=tmp_path / "cards", enable_wired=False)
    for usb_camera in found.bus.cameras.values():
        usb_camera.body.settings.set(Prop.EXPOSURE_TIME, 100)
    set_default_rig(found)
    yield found
    set_default_rig(None)
    found.shut_down()


@pytest.fixture(name="eventually")
def eventually_fixture() -> Callable[..., bool]:
    """Wait until a condition holds; whether it did in time."""
    return eventually


@pytest.fixture
def spec() -> RigSpec:
    return small_spec()


@pytest.fixture
def make_shaker() -> Iterator[Callable[..., ScpiShaker]]:
    """Build a shaker's driver, settings changed as told, and connect it."""
    made: list[ScpiShaker] = []

    def make(port: str = "sim://shaker", *, connect: bool = True, **changes: Any) -> ScpiShaker:
        driver = ScpiShaker("shaker", shaker_settings(port, **changes))
        made.append(driver)
        if connect:
            driver.connect()
        return driver

    yield make
    for driver in made:
        driver.close()


@pytest.fixture
def make_camera(rig: SimulatedRig) -> Iterator[Callable[..., PtpCamera]]:
    """Build a camera's driver on the simulated bus and connect it."""
    made: list[PtpCamera] = []

    def make(serial: str = "6000001", *, connect: bool = True, **changes: Any) -> PtpCamera:
        settings = {"driver": "ptp", "backend": "sim", "serial": serial, "timeout_s": 1.0, **changes}
        driver = PtpCamera("left", settings)
        made.append(driver)
        if connect:
            driver.connect()
        return driver

    yield make
    for driver in made:
        driver.close()


@pytest.fixture
def shaker(rig: SimulatedRig, make_shaker: Callable[..., ScpiShaker]) -> ScpiShaker:
    return make_shaker()


@pytest.fixture
def trigger(rig: SimulatedRig) -> Iterator[TriggerBox]:
    driver = TriggerBox("trigger", {"driver": "box", "port": "sim://trigger", "timeout_s": 0.3})
    driver.connect()
    yield driver
    driver.close()


@pytest.fixture
def camera(make_camera: Callable[..., PtpCamera]) -> PtpCamera:
    return make_camera()
