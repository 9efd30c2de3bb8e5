"""How a shaker's controller is spelled: Keysight's generators built in, anything else by templates in the rig file.

A template is a line with one quantity in braces, named with its unit, as ``VOLT {level_vpp:.4f}`` or
``AMPL {amplitude_mm:.3f}``; the same quantity is then expected back from the matching question. So a laboratory's own
box needs no code::

    [shaker.commands]
    set_level = "DISP {amplitude_mm:.3f}"
    get_level = "DISP?"
    output_on = "START"
"""

from __future__ import annotations

import math
import string
from collections.abc import Callable
from typing import Literal

from pydantic import field_validator

from labdrivers.settings import DriverSettings

Dialect = Literal["keysight", "33120a"]


LEVELS: dict[str, Callable[[float, float], float]] = {
    "level_v": lambda frequency_hz, mm_per_volt: 1 / mm_per_volt,
    "level_vpp": lambda frequency_hz, mm_per_volt: 2 / mm_per_volt,
    "level_vrms": lambda frequency_hz, mm_per_volt: math.sqrt(0.5) / mm_per_volt,
    "amplitude_mm": lambda frequency_hz, mm_per_volt: 1.0,
    "peak_to_peak_mm": lambda frequency_hz, mm_per_volt: 2.0,
    "velocity_mm_s": lambda frequency_hz, mm_per_volt: 2 * math.pi * frequency_hz,
    "acceleration_m_s2": lambda frequency_hz, mm_per_volt: (2 * math.pi * frequency_hz) ** 2 / 1000,
    "acceleration_g": lambda frequency_hz, mm_per_volt: (2 * math.pi * frequency_hz) ** 2 / 9806.65,
}
"""Quantities that a level template may name, and how much of each makes one millimetre of the table, zero to peak.
The bare volt is zero to peak too."""


class ScpiCommands(DriverSettings):
    """Every line that the driver ever sends. An empty string means that the controller has no such command."""

    identify: str = "*IDN?"
    setup: tuple[str, ...] = ("*CLS", "FUNC SIN", "VOLT:UNIT VPP", "VOLT:OFFS 0")
    """Sent before the first start, with the output off."""
    set_frequency: str = "FREQ {frequency_hz:.6f}"
    get_frequency: str = "FREQ?"
    set_level: str = "VOLT {level_vpp:.5f}"
    get_level: str = "VOLT?"
    output_on: str = "OUTP ON"
    output_off: str = "OUTP OFF"
    get_output: str = "OUTP?"
    get_amplifier: str = ""
    """Asks for the state of the amplifier behind the controller, of a controller that knows it."""
    on_replies: tuple[str, ...] = ("1", "ON")
    off_replies: tuple[str, ...] = ("0", "OFF")
    error: str = "SYST:ERR?"
    acknowledge: str = ""
    """What the controller answers to a setting, for those that do; Keysight's answer nothing."""

    @field_validator("set_frequency")
    @classmethod
    def _frequency_only(cls, template: str) -> str:
        return _check_template(template, {"frequency_hz"})

    @field_validator("set_level")
    @classmethod
    def _one_level(cls, template: str) -> str:
        return _check_template(template, set(LEVELS))

    @property
    def level_name(self) -> str:
        """The quantity in `set_level`."""
        return _fields(self.set_level)[0]

    @property
    def in_volts(self) -> bool:
        """Whether levels are volts, so that a calibration is needed."""
        return self.level_name.startswith("level_")

    @property
    def can_switch_off(self) -> bool:
        """Whether there is a real output-off, not just a lowest level."""
        return bool(self.output_off)


DIALECTS: dict[Dialect, ScpiCommands] = {
    "keysight": ScpiCommands(),
    # No OUTPut subsystem at all: the lowest level is as much rest as it knows.
    "33120a": ScpiCommands(
        setup=("*CLS", "FUNC:SHAP SIN", "VOLT:UNIT VPP", "VOLT:OFFS 0"), output_on="", output_off="", get_output=""
    ),
}


def _fields(template: str) -> list[str]:
    return [name for _, name, _, _ in string.Formatter().parse(template) if name is not None]


def _check_template(template: str, known: set[str]) -> str:
    try:
        names = _fields(template)
        template.format(**dict.fromkeys(known, 1.0))
    except (KeyError, IndexError, ValueError, AttributeError) as exc:
        raise ValueError(f"{template!r} is no template ({exc}); write one of {sorted(known)} in braces") from None
    if len(names) != 1:
        raise ValueError(f"{template!r} must hold exactly one of {sorted(known)} in braces")
    return template
