"""Coded light as a capture asks for it and as it was played, and the ability of a trigger to play it.

The lamp's brightness follows the excitation (`labdaemon.blur.light_code`), so that one exposure shows the phase. A
trigger device plays the code between the opening of the last shutter and the closing of the first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from labdaemon.capture.devices import Firing
from labdaemon.journal.light_record import LightRecord

SHUTTER_MARGIN_S = 0.02
"""Difference of the bodies' release lags, and jitter: so much of an exposure is not open on all cameras at once."""


@dataclass(frozen=True, slots=True)
class LightRequest:
    """A code to be played.

    Attributes
    ----------
    brightness
        In equal sectors of one excitation cycle, 0 to 1 in parts of the lamp's full brightness.
    cycles
        Whole cycles in which it is played.
    phase_rad
        Excitation phase at which the first sector begins.
    """

    brightness: tuple[float, ...]
    cycles: int
    phase_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class PlayedLight:
    """A code as the device played it, to its last cycle.

    Attributes
    ----------
    brightness
        As the lamp can show it.
    cycles, phase_rad
        As in `LightRequest`.
    sd_phase_rad
        Standard deviation of the phase: clock and edges of the device.
    period_s
        Period of the excitation that it was timed by.
    """

    brightness: tuple[float, ...]
    cycles: int
    phase_rad: float
    sd_phase_rad: float
    period_s: float


@dataclass(frozen=True, slots=True)
class Lamp:
    """The rig's lamp, as its rig file describes it.

    Attributes
    ----------
    rise_s
        Time from dark to full brightness and back, seconds.
    ambient
        Other light in the room, in parts of the lamp's full brightness.
    levels
        How many levels it can show; 2 where it only switches.
    margin_s
        Part of an exposure in which not all shutters are open.
    flicker_hz
        Flicker of the ambient light, hertz; None where it does not flicker.
    sd_ambient
        Standard deviation of `ambient`, None where it was not stated.
    """

    rise_s: float = 0.0
    ambient: float = 0.0
    levels: int = 2
    margin_s: float = SHUTTER_MARGIN_S
    flicker_hz: float | None = None
    sd_ambient: float | None = None

    @property
    def assumed_sd_ambient(self) -> float:
        """Standard deviation of the ambient light, as measuring takes it where the rig file does not say it."""
        return 0.1 * self.ambient + 0.02 if self.sd_ambient is None else self.sd_ambient

    def shown(self, brightness: tuple[float, ...]) -> tuple[float, ...]:
        """The same in levels that the lamp can show."""
        steps = self.levels - 1
        return tuple(round(value * steps) / steps for value in brightness)

    def cycles_within(self, exposure_s: float, frequency_hz: float, sectors: int) -> int:
        """Whole cycles of a code that are sure to fit into the time in which all shutters are open.

        The code waits for the edge of its next sector, at most one sector.
        """
        return max(math.floor((exposure_s - self.margin_s) * frequency_hz - 1.0 / sectors + 1e-9), 0)

    def record(self, played: PlayedLight) -> LightRecord:
        """A code as it was played by this lamp, for the journal."""
        return LightRecord(
            played.brightness,
            played.cycles,
            played.phase_rad,
            played.sd_phase_rad,
            self.ambient,
            self.rise_s,
            self.sd_ambient,
        )


@runtime_checkable
class LightCodePlayer(Protocol):
    """A trigger driver whose device has a lamp output.

    A driver class says ``plays_light = True``, so that a rig file with a lamp on another one is refused.
    """

    plays_light: bool

    def set_lamp(self, level: float) -> None:
        """Constant light of this brightness, 0 to 1, from now on.

        Raises
        ------
        DeviceRefused
            The device has no lamp output, or cannot show this level.
        """
        ...

    def fire_coded(self, exposure_s: float, light: LightRequest, *, frequency_hz: float) -> Firing:
        """Release all shutters once and play the code while they are open; returns when they have opened.

        Raises
        ------
        DeviceRefused
            The device does not play it: no sync of the excitation, no lamp output, or a code that does not fit.
        """
        ...

    def read_played(self, timeout_s: float) -> PlayedLight:
        """What was played with the last coded shot, once it has ended.

        Raises
        ------
        DeviceError
            The code was not played to its end, or with another period than the excitation's: the frames hold a light
            that is not known.
        """
        ...


def plays_light(trigger: object) -> bool:
    """Whether a trigger driver's device can play a code; only where the driver says so."""
    return isinstance(trigger, LightCodePlayer) and bool(trigger.plays_light)
