"""The request for a capture, and the Protocol of the observer that follows it; see `labdaemon.capture.acquisition`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from labdaemon.capture.lamp import LightRequest
from labdaemon.capture.settle import Excitation
from labdaemon.journal.records import CaptureRecord


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    """A capture before its shutters open; what becomes of it is a `CaptureRecord`.

    Attributes
    ----------
    name
        New to the journal.
    step, shot
        The step, `NO_STEP` outside any, and the place among its shots.
    label
        The step's label, or what a person called a manual capture.
    sharp
        The sharp set it is measured against; None for the flat set, or when it is itself sharp.
    group
        Name under which it is measured jointly with others, None when on its own.
    frequency_hz, amplitude_mm
        Of the excitation as far as it is known, hertz and millimetres zero to peak.
    exposure_s
        Seconds; `UNKNOWN_EXPOSURE_S` where others release and do not state it.
    cameras
        Names of the cameras that owe a frame.
    excitation
        What the table is brought to first; None to leave it as it is.
    trigger_phase_rad
        Excitation phase at which the trigger device opens the shutters, None for any.
    light
        Light code that the trigger device plays while the shutters are open, None for constant light.
    stated_phase_rad
        Excitation phase of the opening as whoever asked states it; it has a reference of its own.
    request_id
        Of the request that asked for it, answered in the journal once fired.
    """

    campaign: str
    name: str
    step: int
    shot: int
    label: str
    is_sharp: bool
    sharp: str | None
    group: str | None
    frequency_hz: float | None
    amplitude_mm: float | None
    exposure_s: float
    cameras: tuple[str, ...]
    excitation: Excitation | None = None
    trigger_phase_rad: float | None = None
    light: LightRequest | None = None
    stated_phase_rad: float | None = None
    request_id: str | None = None

    def intended(self) -> CaptureRecord:
        """The capture's record before anything has happened."""
        return CaptureRecord(
            campaign=self.campaign,
            name=self.name,
            step=self.step,
            shot=self.shot,
            label=self.label,
            is_sharp=self.is_sharp,
            sharp=self.sharp,
            grouped=self.group,
            state="intended",
            frequency_hz=self.frequency_hz,
            amplitude_mm=self.amplitude_mm,
            exposure_s=self.exposure_s,
            opened_at=None,
            opening_s={},
            phase_rad=self.stated_phase_rad,
            sd_phase_rad=None,
            cameras=self.cameras,
            files={},
            reason=None,
        )


class CaptureObserver(Protocol):
    """Follows a capture; its methods are called in this order, on the event loop."""

    def capture_started(self) -> None:
        """The shutters are about to open: from now on the capture is completed, not interrupted."""
        ...

    def capture_fired(self, capture: CaptureRecord) -> None:
        """The shutters have opened, and the journal has the opening."""
        ...

    async def describe(self, capture: CaptureRecord) -> CaptureRecord:
        """Return the capture with what was not stated of its excitation; the shutters have closed."""
        ...

    async def capture_stored(self, capture: CaptureRecord) -> None:
        """Take the stored capture over, to be measured; it is awaited, so that a full queue makes the table wait."""
        ...

    def capture_ended(self) -> None:
        """The capture is stored, or has failed; this may be called twice."""
        ...
