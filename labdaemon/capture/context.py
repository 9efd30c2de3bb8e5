"""What captures are taken with: the rig, its table, the journal, the data folder, and what is known of the devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from labdaemon.capture.lamp import Lamp
from labdaemon.capture.own_frames import FrameContext, load_clocks
from labdaemon.capture.pairing import CameraClocks
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import Rig
from labdaemon.capture.table import Table
from labdaemon.clock import Clock


@dataclass(frozen=True, slots=True)
class CameraOverrides:
    """What the rig file sets on a body in addition to the exposure; None leaves it to the body's dials."""

    f_number: float | None = None
    iso: int | None = None


@dataclass(slots=True)
class AcquisitionContext:
    """Everything a capture is taken with.

    Attributes
    ----------
    data
        The data folder.
    cameras
        Settings by camera name.
    camera_timeout_s
        A frame that has not come this long after twice its exposure is late.
    lamp
        The lamp on the trigger device's output; None where the light is constant.
    clocks
        What is known of the cameras' clocks, from the journal at first.
    exposures_s
        What each body is set to now.
    suspect_devices
        Names of devices that have failed, and that have not answered since.
    partial_files_removed
        Whether the data folder was cleared of what an earlier run left half written.
    """

    rig: Rig
    table: Table
    recorder: Recorder
    clock: Clock
    data: Path
    cameras: Mapping[str, CameraOverrides] = field(default_factory=dict)
    camera_timeout_s: float = 30.0
    lamp: Lamp | None = None
    clocks: CameraClocks = field(default_factory=CameraClocks)
    exposures_s: dict[str, float] = field(default_factory=dict)
    suspect_devices: set[str] = field(default_factory=set)
    partial_files_removed: bool = False
    frames: FrameContext = field(init=False)

    def __post_init__(self) -> None:
        self.frames = FrameContext(
            self.rig, self.recorder, self.clock, self.data, self.clocks, lambda: self.camera_timeout_s
        )
        load_clocks(self.frames)
