"""The chain in short: the box plays a code, the camera sees it, and one frame gives amplitude and phase."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import labdaemon as ld
from labdaemon.blur import ExposureWindow, LightCode
from labdaemon.capture.lamp import LightRequest
from labdaemon.flags import Flag
from labdrivers.ptp.camera import PtpCamera
from labdrivers.ptp.codes import Prop
from labdrivers.sim.assembly import SimulatedRig, set_default_rig
from labdrivers.sim.spec import LampSpec, RigSpec
from labdrivers.trigger_box import TriggerBox

SEVEN = (1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0)
LAMP = LampSpec(rise_s=1e-3, ambient=0.1)


@pytest.fixture(params=[True, False], ids=["wired", "not wired"])
def rig(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[SimulatedRig]:
    """A table without modes, so that nothing rings; one camera that sees a few dots."""
    left = RigSpec().cameras["left"]
    near = replace(
        left,
        aim_mm=(150.0, -100.0, 400.0),
        image_size=(260, 360),
        principal_point_px=(130.0, 180.0),
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    )
    spec = RigSpec(
        cameras={"left": near}, modes=(), lamp=replace(LAMP, is_wired=request.param), white_dn=2900.0, at_s=0.5
    )
    found = SimulatedRig(spec, cards=tmp_path / "cards", enable_wired=False)
    for usb_camera in found.bus.cameras.values():
        usb_camera.body.settings.set(Prop.EXPOSURE_TIME, 5000)
    set_default_rig(found)
    yield found
    set_default_rig(None)
    found.shut_down()


def test_one_frame_of_coded_light_gives_amplitude_and_phase(
    rig: SimulatedRig, tmp_path: Path, make_shaker: object
) -> None:
    trigger = TriggerBox("trigger", {"port": "sim://trigger", "cameras": ["left"]})
    trigger.connect()
    camera = PtpCamera("left", {"driver": "ptp", "backend": "sim", "serial": "6000001", "timeout_s": 5.0})
    camera.connect()

    def fetch(name: str) -> Path:
        file = camera.wait_file(120)
        assert file is not None
        camera.download(file, tmp_path / name)
        return tmp_path / name

    trigger.set_lamp(1.0)
    trigger.fire(0.5)
    sharp = fetch("sharp.dng")
    shaker = make_shaker()  # type: ignore[operator]
    shaker.set(8.0, 2.0)
    time.sleep(0.2)
    trigger.fire_coded(0.5, LightRequest(SEVEN, 3, 0.7), frequency_hz=8.0)
    played = trigger.read_played(30.0)
    blurred = fetch("blurred.dng")
    shaker.stop_now()

    rise_rad = 2 * np.pi * 8.0 * LAMP.rise_s
    light = LightCode(played.brightness, played.phase_rad, played.cycles, LAMP.ambient, rise_rad)
    motion = ld.measure(sharp, blurred, window=ExposureWindow(8.0, 0.5, light=light))
    truth = rig.rig.records[-1]["targets"]["R06"]
    expected = complex(truth["ax_mm"], truth["bx_mm"])
    assert abs(expected) == pytest.approx(2.0, rel=0.02)
    if not rig.rig.spec.lamp.is_wired:
        # The box has played, and the lamp was on all the time: the frame shows constant light.
        camera.close()
        trigger.close()
        assert all(Flag.LIGHT_MISMATCH in one.flags for one in motion)
        return
    found = [one for one in motion if not one.flags]
    assert len(found) >= 2
    for one in found:
        assert one.phased
        # The table moves along X, to the right in the image.
        lead = np.angle(complex(one.a_px[0], one.b_px[0]) / expected)
        assert abs(np.degrees(lead)) < 1.5
        assert 4.0 < one.amplitude_px < 7.0
    camera.close()
    trigger.close()
