"""The cheapest trigger: the RTS line of a serial adapter, through an opto-coupler, at the shutters' cable.

It needs no box, and knows next to nothing: no opening times, no excitation phase, no outside trigger, no enable line.
Two things make it safe to use. Linux raises RTS for a moment whenever a port is opened, which fires the shutters; so an
**arm switch** belongs in the cable, off while the daemon starts. And wired back to CTS or DSR (`arm_input`) the switch
reports its position: then an armed cable at opening is refused, and a shot into an open switch is an error and not a
capture without files.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator

from labdaemon.capture.devices import Firing
from labdaemon.errors import DeviceRefused, UsageError
from labdrivers.serial_line import PortSettings, SerialLine
from labdrivers.settings import read_settings


class RtsSettings(PortSettings):
    """``[trigger]`` of the rig file for ``driver = "rts"``."""

    press_s: float = Field(default=0.2, gt=0, le=5)
    """How long the release is pressed; on bulb it is the exposure instead."""
    bulb: bool = False
    """The bodies are on bulb: hold the line for the exposure."""
    opening_lag_s: float = Field(default=0.06, ge=0, lt=2)
    """From press to opening, as measured once for these bodies: all that is known of the opening's time."""
    arm_input: Literal["none", "cts", "dsr"] = "none"
    """Where the arm switch is wired back to."""

    @field_validator("port")
    @classmethod
    def _has_lines(cls, port: str) -> str:
        if port.startswith("socket://"):
            raise ValueError("a plain socket carries no RTS line; use a local adapter or rfc2217://")
        return port


class RtsTrigger:
    """Driver of the group ``labdaemon.triggers``.

    Parameters
    ----------
    name
        Section's name in the rig file.
    settings
        The section.
    """

    SETTINGS: ClassVar[frozenset[str]] = frozenset(RtsSettings.model_fields)
    holds_enable: ClassVar[bool] = False

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        self.name = name
        self._settings = read_settings(RtsSettings, settings, key=name, ignore=frozenset({"driver"}))
        self._line = SerialLine(name, self._settings, raise_lines=False)
        self._closing = threading.Event()

    def connect(self) -> str:
        """Open the port with RTS low.

        Raises
        ------
        DeviceRefused
            The arm switch is on: opening the port may just have fired the shutters.
        """
        self._closing.clear()
        self._line.open()
        if self._armed() and self._settings.arm_input != "none":
            self._line.close()
            raise DeviceRefused(
                "arm switch is on while the port is opened, which may have fired the shutters; "
                "switch it off, connect, then switch it on",
                device=self.name,
            )
        return f"RTS line of {self._settings.port}"

    def close(self) -> None:
        """Give the port back."""
        self._closing.set()
        self._line.close()

    def fire(self, exposure_s: float, *, frequency_hz: float | None = None, phase_rad: float | None = None) -> Firing:
        """Press the release once; the opening is only as good as `opening_lag_s`.

        Raises
        ------
        UsageError
            A phase is asked for, which this trigger cannot know.
        DeviceRefused
            The arm switch is off.
        """
        if phase_rad is not None:
            raise UsageError("the RTS trigger does not see the excitation; plan without phase_rad or use the box")
        if not self._armed():
            raise DeviceRefused("arm switch is off; switch it on", device=self.name)
        opened_at = datetime.now(UTC) + timedelta(seconds=self._settings.opening_lag_s)
        self._line.set_rts(True)
        try:
            self._closing.wait(exposure_s if self._settings.bulb else self._settings.press_s)
        finally:
            self._line.set_rts(False)
        return Firing(opened_at, {})

    def wait(self, timeout_s: float) -> Firing | None:
        """Nothing outside can release through this trigger: passes the time."""
        self._line.check_open()
        self._closing.wait(timeout_s)
        return None

    def raise_enable(self) -> None:
        """There is no enable line: the amplifier is always enabled."""

    def heartbeat(self) -> None:
        """Look whether the port is still there; there is no enable line to hold."""
        self._armed()

    def drop_enable(self) -> None:
        """There is no enable line to drop."""

    def _armed(self) -> bool:
        if self._settings.arm_input == "none":
            self._line.check_open()
            return True
        return self._line.input_line(self._settings.arm_input)
