"""What the daemon asks of a device: small Protocols that drivers fulfil.

All calls block, and return or raise a `DeviceError` within the deadline that they are given or know; the service runs
each device on a thread of its own. A driver is a class named by an entry point in one of the groups
``labdaemon.shakers``, ``labdaemon.triggers``, ``labdaemon.cameras``, ``labdaemon.gauges``; it is built by
``Driver(name, settings)`` where `settings` is its section of the rig file as a plain mapping. Building one opens
nothing: `connect` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol, runtime_checkable

from labdaemon.guardian.recipe import StopRecipe


@dataclass(frozen=True, slots=True)
class ShakerState:
    """What the controller itself says it is doing. Amplitude is the table's, zero to peak.

    `amplifier_on` is the state of the amplifier behind it, None from a controller that does not report it.
    """

    running: bool
    frequency_hz: float
    amplitude_mm: float
    amplifier_on: bool | None = None


@runtime_checkable
class Shaker(Protocol):
    """A shaker table's controller."""

    name: str

    def connect(self) -> str:
        """Open the wire, handshake, and return the device's identity. Never moves the table."""
        ...

    def set(self, frequency_hz: float, amplitude_mm: float) -> None:
        """Ramp to this excitation, start if at rest, and confirm that the controller took it."""
        ...

    def state(self) -> ShakerState:
        """Ask the controller."""
        ...

    def stop(self) -> None:
        """Soft stop: ramp to rest and confirm. Raises if the device does not confirm."""
        ...

    def stop_now(self) -> None:
        """Hard stop: output off at once, needing no earlier state. Works right after `connect`, in every state.

        A driver whose class says ``reopens = True`` opens a broken wire anew by itself; others are connected to first.
        """
        ...

    def close(self) -> None:
        """Give the wire back. Does not stop the table: that is the caller's duty, before."""
        ...


@runtime_checkable
class StopRecipeSource(Protocol):
    """A shaker driver that can say as data how its device is stopped, for a guardian that outlives the daemon."""

    def stop_recipe(self) -> StopRecipe | None:
        """Bytes and answers of a hard stop, from the settings alone; None where no other process reaches the port."""
        ...


@dataclass(frozen=True, slots=True)
class Firing:
    """One synchronised release of all shutters, as the trigger device measured it.

    Attributes
    ----------
    opened_at
        UTC of the opening (host clock, for records): the mean of the cameras'.
    opening_s
        Opening time of each camera after the release, seconds, by camera name; without those not measured.
    phase_rad
        Excitation phase ωt at the mean of `opening_s`, None if the device does not see the excitation's sync. A
        camera's own is ``phase_rad + ω (opening_s[camera] - mean)``.
    sd_phase_rad
        Its standard deviation.
    """

    opened_at: datetime
    opening_s: dict[str, float]
    phase_rad: float | None = None
    sd_phase_rad: float = 0.0


@runtime_checkable
class Trigger(Protocol):
    """Whatever releases the shutters. It may also hold the shaker's enable line by a heartbeat.

    A driver without such a line says ``holds_enable = False`` in its class.
    """

    name: str

    def connect(self) -> str:
        """Open the wire, handshake, and return the device's identity. Fires nothing."""
        ...

    def fire(self, exposure_s: float, *, frequency_hz: float | None = None, phase_rad: float | None = None) -> Firing:
        """Release all shutters once, at this excitation phase if one is given, and return when they have opened.

        `exposure_s` says how long a bulb line must be held; bodies on a fixed shutter time ignore it.
        """
        ...

    def wait(self, timeout_s: float) -> Firing | None:
        """Wait for a release that an outside system caused; None when none came in time."""
        ...

    def raise_enable(self) -> None:
        """Raise the shaker's enable line. The caller has just seen the shaker's output off: a table must not jump."""
        ...

    def heartbeat(self) -> None:
        """Keep the shaker's enable line up for another second or so. Without it the line drops by itself.

        Never raises a line that is down; a `DeviceRefused` says that it is.
        """
        ...

    def drop_enable(self) -> None:
        """Drop the enable line now; only `raise_enable` brings it back. For ``reopens`` see `Shaker.stop_now`."""
        ...

    def close(self) -> None:
        """Give the wire back; the enable line drops by itself."""
        ...


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Who a camera is: never taken from its address on the bus, which changes with every replug."""

    manufacturer: str
    model: str
    serial: str


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """What can end a night early. None where the body does not report it."""

    battery_percent: int | None
    free_bytes: int | None


@dataclass(frozen=True, slots=True)
class CardFile:
    """A file as the camera names it, on its card or in its memory.

    All of it together is what it is known by: bodies use names and handles again, and some have no clock.

    Attributes
    ----------
    format
        PTP's object format code, 0 where the driver knows none.
    """

    handle: int
    name: str
    size_bytes: int
    captured_at: str
    format: int = 0


@runtime_checkable
class Camera(Protocol):
    """A camera body on USB."""

    name: str

    def connect(self) -> CameraInfo:
        """Find the body by its serial number and open a session."""
        ...

    def configure(
        self, *, exposure_s: float | None = None, f_number: float | None = None, iso: int | None = None
    ) -> float:
        """Set what is given; return the body's own exposure time in seconds (the step nearest to what was asked)."""
        ...

    def exposure_steps_s(self) -> tuple[float, ...]:
        """Exposure times the body offers now, seconds, ascending; a single one when its dial decides."""
        ...

    def status(self) -> CameraStatus:
        """Battery and free space."""
        ...

    def wait_file(self, timeout_s: float) -> CardFile | None:
        """Next file that appeared since the last call (any format, folders skipped); None when none came in time.

        A file whose size is 0 or still changes is not reported before it has settled.
        """
        ...

    def files(self) -> list[CardFile]:
        """All image files still on the camera, oldest first (for recovery after a crash)."""
        ...

    def download(self, file: CardFile, to: Path) -> None:
        """Write the file to `to`, going on from its present length if it exists. Leaves the camera's copy alone."""
        ...

    def delete(self, file: CardFile) -> None:
        """Delete the camera's copy; the caller has synced and verified its own.

        Raises `DeviceRefused` and deletes nothing where the handle now stands for something else.
        """
        ...

    def close(self) -> None:
        """End the session and release the interface."""
        ...


@runtime_checkable
class FileInspector(Protocol):
    """What a camera's driver may offer in addition: looks at files before they are fetched."""

    def describe(self, file: CardFile) -> CardFile | None:
        """Ask the camera anew what the file's handle stands for; None if it is gone."""
        ...

    def read(self, file: CardFile, offset: int, size: int) -> bytes:
        """Part of a file, fewer bytes at its end."""
        ...


@dataclass(frozen=True, slots=True)
class GaugeReading:
    """Amplitude of one gauge at the excitation frequency, by a least-squares sine fit (IEEE 1057).

    `value` is in the gauge's own unit (mm, or m/s² for an accelerometer), zero to peak; `phase_rad` relative to the
    start of the record; `change_per_cycle` the relative change of amplitude from cycle to cycle.
    """

    value: float
    sd: float
    phase_rad: float
    change_per_cycle: float


@dataclass(frozen=True, slots=True)
class SineReading:
    """The strongest sine that a gauge sees, its frequency not known beforehand.

    Attributes
    ----------
    frequency_hz, sd_frequency_hz
        Its frequency and standard deviation.
    value, sd
        Zero to peak in the gauge's own unit, and its standard deviation.
    is_significant
        False where noise alone may look like this: nothing moves that the gauge could see.
    """

    frequency_hz: float
    sd_frequency_hz: float
    value: float
    sd: float
    is_significant: bool


@runtime_checkable
class SineFinder(Protocol):
    """The ability of a gauge to find an excitation that was not stated; a gauge may lack it."""

    def find_sine(self, *, duration_s: float) -> SineReading:
        """Frequency and amplitude over the latest `duration_s` seconds; waits for that much data if need be."""
        ...


@runtime_checkable
class Gauge(Protocol):
    """A displacement or acceleration sensor that streams."""

    name: str
    unit: str
    role: str
    """``table`` or ``response``: what it is mounted on."""

    def connect(self) -> str:
        """Open the stream and return what the device says of itself."""
        ...

    def read(self, frequency_hz: float, *, duration_s: float) -> GaugeReading:
        """Amplitude over the latest `duration_s` seconds; waits for that much data if need be."""
        ...

    def close(self) -> None:
        """Give the wire back."""
        ...
