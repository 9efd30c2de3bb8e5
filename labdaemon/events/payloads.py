"""What events say: one frozen model for the ``data`` of each kind, with the unit of each number."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema, model_validator

from labdaemon.clock import rfc3339
from labdaemon.events.gauge_motion import GaugeMotion
from labdaemon.plain_json import plain_text

if TYPE_CHECKING:
    from labdaemon.envelope import Envelope

Timestamp = Annotated[
    datetime,
    PlainSerializer(rfc3339, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string", "format": "date-time"}),
]
"""A time in UTC that goes to JSON as every time in files and messages does."""


class EventPart(BaseModel):
    """What every model here has in common: it does not change, and it ignores members that it does not know."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="ignore")

    @model_validator(mode="before")
    @classmethod
    def _spell_out(cls, values: Any) -> Any:
        """Spell out halves of surrogate pairs: no file name may keep a fault from being recorded."""
        if not isinstance(values, dict):
            return values
        return {key: plain_text(value) if isinstance(value, str) else value for key, value in values.items()}

    def to_json_dict(self) -> dict[str, Any]:
        """What was stated of it, and nothing that was left out, as JSON's types."""
        return self.model_dump(mode="json", exclude_unset=True)


class CampaignData(EventPart):
    """``data`` of an event about a campaign.

    Attributes
    ----------
    name
        The campaign's name, as its file gives it.
    steps
        Number of its steps.
    captures
        Captures that the plan has (when it starts) or that were taken (when it is completed).
    predicted_s
        Predicted duration of the whole campaign, seconds.
    reason
        Why it was paused or aborted, or why it failed.
    """

    name: str | None = None
    steps: int | None = None
    captures: int | None = None
    predicted_s: float | None = None
    reason: str | None = None


class StepData(EventPart):
    """``data`` of an event about a step.

    Attributes
    ----------
    step
        Index of the step in its campaign, from 0.
    label, kind
        The step's label, and the kind of its phase (``sharp``, ``steps`` …).
    attempt
        Which attempt this is, from 1; only when the step starts.
    frequency_hz
        Excitation frequency, hertz; None where the table rests. Only when the step starts.
    amplitude_mm
        Amplitude of the table, zero to peak, millimetres; None where it rests. Only when the step starts.
    reason
        Why the step was skipped.
    """

    step: int
    label: str | None = None
    kind: str | None = None
    attempt: int | None = None
    frequency_hz: float | None = None
    amplitude_mm: float | None = None
    reason: str | None = None


class FrameFile(EventPart):
    """A camera's RAW file of a capture.

    Attributes
    ----------
    camera
        The camera's name in the rig file.
    path
        Path of the file, relative to the data folder.
    size_bytes, sha256
        Size, and checksum in hexadecimal.
    """

    camera: str
    path: str
    size_bytes: int | None = None
    sha256: str | None = None


class CaptureData(EventPart):
    """``data`` of ``capture.completed``.

    Attributes
    ----------
    capture, label
        Name of the capture, and the label it was taken with.
    step
        Index of the step, from 0; None for a capture outside any step.
    sharp
        Whether the frames are sharp ones, taken at rest.
    opened_at
        When the shutters opened, UTC.
    exposure_s
        Exposure time, seconds.
    group
        Name of the group it is measured with; None where it is measured alone.
    phase_rad
        Excitation phase at the opening, radians; None where it is unknown.
    frequency_hz, excitation_amplitude_mm
        Excitation frequency, hertz, and amplitude of the table, zero to peak, millimetres; None where unknown.
    frames
        One file for each camera.
    light, light_phase_rad, light_cycles, ambient, light_rise_s
        The light code that was played, as in `capture.toml`; None under constant light.
    gauges
        What each gauge saw meanwhile; empty in events of earlier versions.
    """

    capture: str
    label: str | None = None
    step: int | None = None
    sharp: bool | None = None
    opened_at: Timestamp | None = None
    exposure_s: float | None = None
    group: str | None = None
    phase_rad: float | None = None
    frequency_hz: float | None = None
    excitation_amplitude_mm: float | None = None
    frames: tuple[FrameFile, ...] = ()
    light: tuple[float, ...] | None = None
    light_phase_rad: float | None = None
    light_cycles: int | None = None
    ambient: float | None = None
    light_rise_s: float | None = None
    gauges: tuple[GaugeMotion, ...] = ()


class TargetRow(EventPart):
    """The motion of one target: a row of ``envelope.csv``.

    ``d(t) = a sin(ωt) + b cos(ωt)`` about the mean position. All lengths are in millimetres, amplitudes zero to peak;
    a number is None where it was not measured.

    Attributes
    ----------
    target
        Name of the target.
    x_mm, y_mm, z_mm
        Mean position over the exposure.
    ax_mm, ay_mm, az_mm, bx_mm, by_mm, bz_mm
        Components of a and b.
    sd_x_mm, sd_y_mm, sd_z_mm, sd_ax_mm, sd_ay_mm, sd_az_mm, sd_bx_mm, sd_by_mm, sd_bz_mm
        Standard deviations of the same.
    residual_ratio
        Residual of the second-best solution divided by that of the best one.
    flags
        Names of `labdaemon.Flag`, empty when all is well; a newer daemon may send others.
    sign
        1 or -1 where the sign of a is known; None where it is not.
    cor_x_y … cor_by_bz
        Correlations within x, y, z of the position, and within the components of a and b; None where not known.
    """

    target: str
    capture: str | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    z_mm: float | None = None
    ax_mm: float | None = None
    ay_mm: float | None = None
    az_mm: float | None = None
    bx_mm: float | None = None
    by_mm: float | None = None
    bz_mm: float | None = None
    sd_x_mm: float | None = None
    sd_y_mm: float | None = None
    sd_z_mm: float | None = None
    sd_ax_mm: float | None = None
    sd_ay_mm: float | None = None
    sd_az_mm: float | None = None
    sd_bx_mm: float | None = None
    sd_by_mm: float | None = None
    sd_bz_mm: float | None = None
    residual_ratio: float | None = None
    flags: tuple[str, ...] = ()
    sign: int | None = None
    cor_x_y: float | None = None
    cor_x_z: float | None = None
    cor_y_z: float | None = None
    cor_ax_ay: float | None = None
    cor_ax_az: float | None = None
    cor_ax_bx: float | None = None
    cor_ax_by: float | None = None
    cor_ax_bz: float | None = None
    cor_ay_az: float | None = None
    cor_ay_bx: float | None = None
    cor_ay_by: float | None = None
    cor_ay_bz: float | None = None
    cor_az_bx: float | None = None
    cor_az_by: float | None = None
    cor_az_bz: float | None = None
    cor_bx_by: float | None = None
    cor_bx_bz: float | None = None
    cor_by_bz: float | None = None


class EnvelopeData(EventPart):
    """``data`` of ``envelope``: the motion of all targets in a capture or group.

    Attributes
    ----------
    capture
        Name of the capture, or of the group.
    targets
        One row for each target, measured or not.
    step, label
        Index of the step, from 0 (None outside any step), and label of the capture.
    frequency_hz, excitation_amplitude_mm
        Excitation frequency, hertz, and amplitude of the table, zero to peak, millimetres; None where unknown.
    opened_at
        When the shutters of the group's last capture opened, UTC.
    exposure_s
        Exposure time, seconds.
    """

    capture: str
    targets: tuple[TargetRow, ...] = ()
    step: int | None = None
    label: str | None = None
    frequency_hz: float | None = None
    excitation_amplitude_mm: float | None = None
    opened_at: Timestamp | None = None
    exposure_s: float | None = None

    def envelope(self) -> Envelope:
        """The same as a `labdaemon.Envelope`, with arrays and amplitudes."""
        from labdaemon.envelope import Envelope  # numpy takes longer to load than a short command

        return Envelope.from_event(self.model_dump(mode="json"))


class FaultData(EventPart):
    """``data`` of ``fault``.

    Attributes
    ----------
    device
        What failed: a device of the rig, ``disk``, ``worker``; None where it is none of these.
    error
        Name of the error's class (`labdaemon.errors`).
    message
        What happened, one sentence.
    action
        What the daemon does about it, as ``retry`` or ``pause``.
    step
        Index of the step, from 0; None outside any.
    capture
        The capture that could not be measured, if it is about one.
    """

    # A driver of a lab's own may name its device by a number; its fault must be recorded all the same.
    model_config: ClassVar[ConfigDict] = ConfigDict(coerce_numbers_to_str=True)

    device: str | None = None
    error: str | None = None
    message: str | None = None
    action: str | None = None
    step: int | None = None
    capture: str | None = None


class StatusData(EventPart):
    """``data`` of ``status``: what the daemon does now. What is not known is None.

    Attributes
    ----------
    state
        ``starting``, ``idle``, ``running`` or ``paused``.
    doing
        What it does, as ``settling`` or ``measuring``.
    campaign, name, reason
        Id and name of the campaign, and why it is paused.
    step, steps, label, kind
        Index of the step from 0, number of steps, and the step's label and kind.
    frequency_hz, amplitude_mm
        Excitation of the step: hertz, and millimetres zero to peak.
    captures, captures_total, captures_manual, captures_expected
        Captures taken, planned, taken outside steps, and expected from outside releases.
    left_s
        Predicted time to the campaign's end, seconds.
    largest_mm, largest_target
        Largest amplitude of the last envelope, millimetres zero to peak, and its target.
    doubtful, doubtful_mm
        Number of targets whose motion a flag puts in doubt, and the largest amplitude of these, millimetres.
    waiting_for
        What is missing, and why, by name.
    faults, last_fault
        Number of faults since the daemon started, and the last one's message.
    queue, measuring
        Campaigns that wait for their turn, and captures that wait to be measured.
    table
        ``rest``, ``moving`` or ``unconfirmed``; None without a shaker.
    enable_line, accept_no_enable
        State of the enable line, and whether the rig accepts that it cannot be proven; None without a shaker.
    rig, data, host, pid
        Which daemon this is: rig file, data folder, computer and process.
    guardian
        Its process, and the longest gap between heartbeats, seconds; None without one.
    """

    state: str | None = None
    doing: str | None = None
    campaign: str | None = None
    name: str | None = None
    reason: str | None = None
    step: int | None = None
    steps: int | None = None
    label: str | None = None
    kind: str | None = None
    frequency_hz: float | None = None
    amplitude_mm: float | None = None
    captures: int | None = None
    captures_total: int | None = None
    captures_manual: int | None = None
    captures_expected: int | None = None
    left_s: float | None = None
    largest_mm: float | None = None
    largest_target: str | None = None
    doubtful: int | None = None
    doubtful_mm: float | None = None
    waiting_for: Mapping[str, str] = Field(default_factory=dict)
    faults: int | None = None
    last_fault: str | None = None
    queue: int | None = None
    measuring: int | None = None
    table: str | None = None
    enable_line: str | None = None
    accept_no_enable: bool | None = None
    rig: str | None = None
    data: str | None = None
    host: str | None = None
    pid: int | None = None
    guardian: Mapping[str, float | None] | None = None
