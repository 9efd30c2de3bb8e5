"""The sections of a rig file (`config/*.toml`, `rig.toml` of a data-set folder), each with its units and ranges.

The daemon and `labdaemon process` read the same model, so that both refuse the same slips by name.

A section that names a driver hands the driver all of its keys; keys beyond the ones here are the driver's own and are
checked against what it says it understands.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from labdaemon.service_section import ServiceSection, Written
from labdaemon.tomlfile import TomlSection

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")]
Positive = Annotated[float, Field(gt=0, strict=True)]
Fraction = Annotated[float, Field(gt=0, le=1, strict=True)]
Count = Annotated[int, Field(ge=0, strict=True)]
Pixels = Annotated[int, Field(ge=16, le=100_000, strict=True)]
FocalLength = Annotated[float, Field(ge=50, le=1e6, strict=True)]
Seconds = Annotated[float, Field(gt=0, le=86400, strict=True)]


LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "::1"})


class ServerSection(TomlSection):
    """Where a server listens that is no ZeroMQ socket, and who may use it."""

    scheme: ClassVar[str]

    address: str
    token_file: Written | None = None
    """File whose first line makes an operator of who says it; readable by its owner only. Relative to the rig file."""

    @property
    def host(self) -> str:
        """Name or number that it listens under, in small letters."""
        return self.address.partition("://")[2].rpartition(":")[0].strip("[]").lower()

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return self.host in LOOPBACK_NAMES or re.fullmatch(r"127(\.\d{1,3}){3}", self.host) is not None

    @field_validator("address")
    @classmethod
    def _an_address(cls, address: str) -> str:
        found = re.fullmatch(rf"{cls.scheme}://(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9.-]+):(\d{{1,5}}|\*)", address)
        if found is None or (found[2] != "*" and int(found[2]) >= 1 << 16):
            raise ValueError(f"{address!r} is no address; write {cls.scheme}://127.0.0.1:PORT")
        return address

    @model_validator(mode="after")
    def _token_off_loopback(self) -> ServerSection:
        if not self.is_loopback and self.token_file is None:
            raise ValueError(
                f"{self.address} is off loopback; name a token_file, or use {self.scheme}://127.0.0.1:PORT"
            )
        return self


class GatewaySection(ServerSection):
    """The text gateway (SCPI over TCP); off where the rig file has no such section."""

    scheme: ClassVar[str] = "tcp"

    address: str = "tcp://127.0.0.1:5025"


class WebSection(ServerSection):
    """The web server; off where the rig file has no such section. Commands need the token of `token_file`."""

    scheme: ClassVar[str] = "http"

    address: str = "http://127.0.0.1:5580"
    observer_token_file: Written | None = None
    """File whose first line lets a client read, where reading needs a token: off loopback."""
    hosts: tuple[Annotated[str, Field(pattern=r"^[A-Za-z0-9.:-]+$")], ...] = ()
    """Further names under which it may be asked, without port."""


class DriverSection(TomlSection):
    """A section whose other keys belong to the driver that it names."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")

    driver: Name

    ours: ClassVar[frozenset[str]] = frozenset()
    """Keys that are none of the driver's business."""

    @property
    def settings(self) -> dict[str, Any]:
        """The section as plain values, as a driver gets it: what was written, under the names it was written."""
        return self.model_dump(exclude_unset=True, exclude=set(self.ours))

    @property
    def driver_keys(self) -> set[str]:
        """Keys that only the driver can judge."""
        return set(self.model_extra or {})


class LimitsSection(TomlSection):
    """The table's limits, see `labdaemon.campaign.limits.ShakerLimits`."""

    stroke_mm: Annotated[float, Field(ge=1, le=2000, strict=True)]
    velocity_mm_s: Annotated[float, Field(ge=1, le=1e5, strict=True)]
    acceleration_mm_s2: Annotated[float, Field(ge=10, le=1e7, strict=True)]
    frequency_hz: tuple[Positive, Positive] = (0.1, 200.0)
    force_n: Positive | None = None
    moving_mass_kg: Positive | None = None

    @field_validator("frequency_hz")
    @classmethod
    def _ascending(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if ends[0] >= ends[1]:
            raise ValueError("the lowest frequency comes first, then the highest")
        return ends

    @model_validator(mode="after")
    def _force_needs_mass(self) -> LimitsSection:
        if (self.force_n is None) != (self.moving_mass_kg is None):
            raise ValueError("force_n and moving_mass_kg are only checked together; give both or neither")
        return self


class ShakerSection(DriverSection):
    """The shaker's controller."""

    port: Written
    limits: LimitsSection
    calibration: Written | None = None
    """Table of drive level to millimetres over frequency (CSV), relative to the rig file."""


class TriggerSection(DriverSection):
    """What releases the shutters; driver ``camera`` when an outside system does."""

    ours: ClassVar[frozenset[str]] = frozenset({"window_s"})

    window_s: Seconds = 5.0
    """Frames that arrive from all cameras within this time are one capture (driver ``camera``)."""


class GaugeSection(DriverSection):
    """A displacement or acceleration sensor."""

    ours: ClassVar[frozenset[str]] = frozenset({"stands_for"})

    name: Name
    role: Literal["table", "response"]
    unit: Literal["mm", "m/s2"] = "mm"
    port: Written
    stands_for: Written | Annotated[tuple[Written, ...], Field(min_length=1)] | None = None
    """Targets that move with it, so that its harmonics are theirs: names or patterns as ``"L*"``; ``"all"`` for all."""


class CameraSection(DriverSection):
    """A camera body and its lens (OpenCV's model; `labdaemon calibrate camera` fills it in)."""

    ours: ClassVar[frozenset[str]] = frozenset({"exposure_steps_s", "distance_mm"})

    serial: str
    exposure_s: Annotated[float, Field(gt=0, le=900, strict=True)] | None = None
    f_number: Annotated[float, Field(ge=0.7, le=128, strict=True)] | None = None
    iso: Annotated[int, Field(ge=25, le=409600, strict=True)] | None = None
    distance_mm: Annotated[float, Field(ge=50, le=1e6, strict=True)] | None = None
    """From the lens to the structure, to predict how large things are in the images; by default they fill the frame."""
    exposure_steps_s: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Exposure times to plan with when the body is not at hand; by default the usual thirds of a stop."""
    image_size: tuple[Pixels, Pixels] | None = None
    focal_px: tuple[FocalLength, FocalLength] | None = None
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] | None = None

    @model_validator(mode="after")
    def _whole_lens(self) -> CameraSection:
        lens = {"image_size": self.image_size, "principal_point_px": self.principal_point_px}
        missing = [name for name, value in lens.items() if value is None]
        if self.focal_px is not None and missing:
            raise ValueError(f"focal_px is given, but {' and '.join(missing)} is not")
        return self


class LampSection(TomlSection):
    """The lamp that lights the structure; its brightness can follow the excitation (a light code)."""

    output: Literal["trigger"] = "trigger"
    """What plays the code: the lamp output of the device in ``[trigger]``."""
    rise_s: Annotated[float, Field(ge=0, le=0.05, strict=True)] = 0.0
    """Time from dark to full brightness and back."""
    ambient: Annotated[float, Field(ge=0, le=20, strict=True)] = 0.0
    """Light that is on whenever a shutter is open, in parts of the lamp's full brightness."""
    sd_ambient: Annotated[float, Field(ge=0, le=20, strict=True)] | None = None
    """Standard deviation of `ambient`; by default a tenth of it and 0.02."""
    levels: Annotated[int, Field(ge=2, le=256, strict=True)] = 2
    """How many levels the lamp can show: 2 where it only switches, 256 with PWM of 8 bits."""
    margin_s: Annotated[float, Field(ge=0, le=1, strict=True)] = 0.02
    """Part of an exposure in which not all shutters are open: the bodies' lags differ and vary."""
    mains_hz: Literal[50, 60] | None = None
    """Frequency of the mains that the ambient light hangs on, if it flickers (at twice that)."""


class TargetsSection(TomlSection):
    """The dots on the structure."""

    diameter_mm: (
        Annotated[float, Field(ge=0.5, le=500, strict=True)]
        | Annotated[tuple[Annotated[float, Field(ge=0.5, le=500, strict=True)], ...], Field(min_length=1)]
    )
    """One size, or a list of the sizes in use."""
    file: Written | None = None
    """Approximate places of the targets (``name,x_mm,y_mm,z_mm``), relative to the rig file."""
    patches: Written | None = None
    """Textured patches in the sharp frames (``name,camera,x_px,y_px,width_px,height_px``), relative to the rig file."""


class ControlSection(TomlSection):
    """The surveyed control targets."""

    family: Name = "apriltag-36h11"
    size_mm: Annotated[float, Field(ge=1, le=2000, strict=True)]
    file: Written = "control.csv"
    """Their surveyed centres (``name,x_mm,y_mm,z_mm,sd_mm``), relative to the rig file."""


class GuardianSection(TomlSection):
    """The process that stops the table when the daemon cannot."""

    silence_s: Annotated[float, Field(ge=1, le=60, strict=True)] = 2.0
    """With the table moving, a daemon that is silent for so long is ended and the table stopped."""
    patience_s: Seconds = 600.0
    """How long it tries to stop a table that does not confirm."""


class ProcessingSection(TomlSection):
    """How frames are measured."""

    method: Literal["fit", "paper"] = "fit"
    """The closed-form fit, or the published method to compare with."""
    workers: Annotated[int, Field(ge=0, le=256, strict=True)] = 0
    """Worker processes; 0 for one a core."""
    deadline_s: Seconds = 600.0
    """Longest that a capture may compute before its worker is replaced. Coded light takes seconds a target."""


class InterlocksSection(TomlSection):
    """What stops the table. None switches a check off."""

    accept_no_enable: bool = False
    """Campaigns may move the table although no enable line was seen to stop it: a person answers for that."""

    max_response_mm: Positive | None = None
    """Largest semi-amplitude of the structure by a response gauge or by an envelope."""
    max_response_rate_mm_s: Positive | None = None
    """Fastest growth of the response's semi-amplitude."""
    gauge_disagreement: Fraction | None = 0.2
    """Relative difference between the table's amplitude as set and as the table gauge reads it."""
    max_paper_edge: Fraction | None = 0.1
    """Share of an envelope's targets whose smear may reach the edge of its paper."""
    min_battery_percent: Annotated[int, Field(ge=0, le=100, strict=True)] = 10
    min_card_bytes: Count = 200_000_000
    min_disk_bytes: Count = 1_000_000_000
    camera_timeout_s: Seconds = 30.0
    """A camera that has not delivered its frame this long after a capture is lost."""
    worker_stall_s: Seconds = 1800.0
    """No measurement finished for so long although some are waiting."""


class RigSections(TomlSection):
    """All sections of a rig file."""

    service: ServiceSection = ServiceSection()
    shaker: ShakerSection | None = None
    trigger: TriggerSection = TriggerSection(driver="camera")
    lamp: LampSection | None = None
    gauges: Annotated[tuple[GaugeSection, ...], Field(alias="gauge")] = ()
    cameras: Annotated[dict[Name, CameraSection], Field(min_length=1)]
    targets: TargetsSection
    control: ControlSection
    processing: ProcessingSection = ProcessingSection()
    guardian: GuardianSection = GuardianSection()
    interlocks: InterlocksSection = InterlocksSection()
    gateway: GatewaySection | None = None
    web: WebSection | None = None
