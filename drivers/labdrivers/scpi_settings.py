"""``[shaker]`` of the rig file for a controller that speaks SCPI."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from labdaemon.campaign.limits import ShakerLimits
from labdrivers.drive_table import DrivePoint
from labdrivers.serial_line import PortSettings


class ShakerSettings(PortSettings):
    """``[shaker]`` of the rig file."""

    dialect: Literal["keysight", "33120a"] = "keysight"
    commands: dict[str, Any] = Field(default_factory=dict)
    """Overrides of the dialect, see `ScpiCommands`."""
    limits: ShakerLimits
    drive: tuple[DrivePoint, ...] = ()
    """Calibration, needed when levels are volts; a controller that takes millimetres or g does its own."""
    calibration: Path | None = None
    """The same as a CSV file (``frequency_hz,mm_per_v``); it wins over `drive`."""
    ramp_mm_s: float = Field(default=4.0, gt=0)
    """Change of amplitude while ramping."""
    glide_ratio: float = Field(default=1.1, ge=1.0)
    """A frequency that changes by no more than this factor is changed in motion; by more, at rest."""
    lowest_level_v: float = Field(default=0.01, gt=0)
    """Smallest level (zero to peak) the generator takes: where ramps begin and end."""
    lowest_mm: float = Field(default=0.005, gt=0)
    """The same for a controller whose levels are not volts."""
    highest_level_v: float = Field(default=10.0, gt=0)
    readback_tolerance: float = Field(default=2e-3, gt=0, lt=0.1)
    enable_line: bool = False
    """The amplifier's enable is held by the trigger box. Needed where the generator cannot switch its output off."""


STOPPING: dict[str, Any] = {
    "limits": {"stroke_mm": 1.0, "velocity_mm_s": 1.0, "acceleration_mm_s2": 10.0, "frequency_hz": (1.0, 2.0)},
    "calibration": None,
    "drive": [{"frequency_hz": 1.0, "mm_per_v": 1.0}],
    "enable_line": True,
}
"""For keys that the driver needs, and that switching an output off does not."""
