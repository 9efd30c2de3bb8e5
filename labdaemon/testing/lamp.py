"""A trigger with a lamp output, in memory, for simulated time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from labdaemon.capture.devices import Firing
from labdaemon.capture.lamp import LightRequest, PlayedLight
from labdaemon.capture.rig import DeviceHandle
from labdaemon.errors import DeviceError, DeviceRefused
from labdaemon.testing.rig import FakeRig, FakeTrigger


@dataclass(slots=True)
class FakeLampTrigger(FakeTrigger):
    """Plays what it is asked to.

    Attributes
    ----------
    lit
        Constant levels and codes, in the order in which they were asked for.
    cut
        So many of the next codes end after one cycle.
    """

    plays_light: ClassVar[bool] = True

    lit: list[float | LightRequest] = field(default_factory=list)
    cut: int = 0

    def set_lamp(self, level: float) -> None:
        self.world.enter(self.name, "set_lamp")
        self.lit.append(level)

    def fire_coded(self, exposure_s: float, light: LightRequest, *, frequency_hz: float) -> Firing:
        if not self.world.moves():
            raise DeviceRefused("NOSYNC: no edge on its sync input", device=self.name)
        firing = self.fire(exposure_s, frequency_hz=frequency_hz)
        self.lit.append(light)
        return replace(firing, phase_rad=0.25)

    def read_played(self, timeout_s: float) -> PlayedLight:
        self.world.enter(self.name, "read_played")
        asked = self.lit[-1]
        if not isinstance(asked, LightRequest):
            raise DeviceError("no code was played", device=self.name)
        if self.cut:
            self.cut -= 1
            raise DeviceError(f"played 1 of {asked.cycles} cycles of the light code", device=self.name)
        return PlayedLight(asked.brightness, asked.cycles, asked.phase_rad, 2e-4, 1 / self.world.frequency_hz)


def give_lamp(fake: FakeRig) -> FakeLampTrigger:
    """Replace the trigger of a rig in memory by one with a lamp output."""
    assert fake.rig.trigger is not None
    trigger = FakeLampTrigger(fake.world, fake.cameras)
    fake.trigger = trigger
    fake.rig = replace(fake.rig, trigger=DeviceHandle(trigger, fake.rig.trigger.executor))
    return trigger
