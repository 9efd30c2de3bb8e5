"""One capture, from the table's excitation to stored frames: its whole journey is `take`, top to bottom."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from labdaemon.capture.collect import identity, store
from labdaemon.capture.devices import CardFile
from labdaemon.capture.exposure import true_steps_s
from labdaemon.capture.gather import gather_to_completion
from labdaemon.capture.own_frames import FrameContext, clock_offsets, load_clocks, prepare_cameras, wait_own
from labdaemon.capture.pairing import CameraClocks, Opening
from labdaemon.capture.paths import (
    capture_folder,
    capture_toml,
    frame_path,
    opening_phase,
    with_opening,
)
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import CALL_S, Rig
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.clock import Clock, rfc3339
from labdaemon.durable import write_durably
from labdaemon.errors import DataError, DeviceError, DeviceRefused, InterlockError
from labdaemon.journal import card_records, transitions
from labdaemon.journal.card_records import ClockOffset, OwedFile
from labdaemon.journal.records import UNKNOWN_EXPOSURE_S, CaptureRecord, FrameRecord

EXPOSURE_WITHIN = 0.09
"""A body whose own exposure differs from the planned one by more than this, relative, is refused. Bodies name their
steps in round figures (1.3 s for 1.26 s); the next step of a third of a stop is 26 % away."""


@dataclass(frozen=True, slots=True)
class CameraOverrides:
    """What the rig file sets on a body besides the exposure; None leaves it to the body's dials."""

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
    clocks
        What is known of the cameras' clocks, from the journal at first.
    exposures_s
        What each body is set to now.
    suspect_devices
        Names of devices that a fault was put down to, and that nobody has heard of since.
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


Fired = Callable[[CaptureRecord], None]
Stored = Callable[[CaptureRecord], Awaitable[None]]
Describe = Callable[[CaptureRecord], Awaitable[CaptureRecord]]


async def take(
    context: AcquisitionContext,
    order: CaptureRecord,
    excitation: Excitation | None,
    *,
    measure: Stored,
    phase_rad: float | None = None,
    request_id: str | None = None,
    begun: Callable[[], None] = lambda: None,
    fired: Fired = lambda capture: None,
    describe: Describe | None = None,
) -> CaptureRecord:
    """Take one capture.

    Parameters
    ----------
    context
        What it is taken with.
    order
        What it is to be; its name is new to the journal.
    excitation
        What the table is brought to first; None to leave it as it is.
    measure
        Takes the stored capture over and publishes its envelope in its own time. It is awaited, so a full queue
        makes the table wait.
    phase_rad
        Excitation phase at which to open, None for any.
    request_id
        Of the request that asked for it, answered in the journal once fired.
    begun
        Called when the shutters are about to be fired: from then on it is worth seeing to its end.
    fired
        Called once the shutters have opened and the journal knows.

    describe
        Finds out, once the shutters have closed, what nobody stated of the excitation.

    Returns
    -------
    CaptureRecord
        As stored.

    Raises
    ------
    DeviceError, DataError, InterlockError
        It came to nothing. Whatever it left, on cards and in the journal, is for `labdaemon.capture.recover`.
    """
    if excitation is not None:
        await context.table.shake(excitation)
    await _expose_for(context, order.exposure_s)
    seen = await prepare_cameras(context.frames)

    begun()
    await context.recorder.write(transitions.intend_capture, order)
    capture, opened_s = await _fire(context, order, phase_rad, request_id)
    fired(capture)

    opening = Opening(capture.campaign, capture.name, opened_s, capture.exposure_s)
    files = await wait_own(context.frames, opening, seen)
    await context.table.confirm()
    if excitation is not None and context.table.excitation != excitation:
        raise InterlockError("the table was stopped during the exposure")
    if describe is not None:
        capture = await describe(capture)

    capture = await keep(context, capture, files, opening)
    await measure(capture)
    return capture


async def keep(
    context: AcquisitionContext, capture: CaptureRecord, files: Mapping[str, CardFile], opening: Opening | None = None
) -> CaptureRecord:
    """Store one file a camera as this capture's frames, which the journal then vouches for.

    The cameras' clocks are learned from them where the `opening` is known on the monotonic clock.
    """
    named = {camera: identity(file) for camera, file in files.items()}
    offsets: list[ClockOffset] = []
    if opening is not None:
        context.clocks.follow(files, opening)
        offsets = clock_offsets(context.frames, opening, files)
    await context.recorder.write(transitions.expose_capture, capture.campaign, capture.name, named, offsets)
    frames = await gather_to_completion(_store(context, capture, camera, file) for camera, file in files.items())
    if capture.exposure_s == UNKNOWN_EXPOSURE_S:
        capture = await _read_exposure(context, capture, list(frames))
    return await complete(context, replace(capture, files=named), list(frames))


def exposure_of(frame: Path) -> float | None:
    """Exposure that a frame's file states, as its body names it; None if it does not. Blocks."""
    # Imported here: reading frames loads libraries, and the table must be at rest before anything is loaded.
    from labdaemon.imaging.file_tags import read_tags

    try:
        return read_tags(frame).exposure_s
    except (DataError, OSError, ValueError):
        return None


async def _read_exposure(
    context: AcquisitionContext, capture: CaptureRecord, frames: list[FrameRecord]
) -> CaptureRecord:
    """The exposure as the frames state it; unknown it stays where they do not, or where they differ."""
    named = [await context.recorder.on_disk(exposure_of, context.data / frame.path) for frame in frames]
    known = {round(true, 6) for true in true_steps_s([one for one in named if one is not None])}
    if None in named or len(known) != 1:
        return capture
    described = replace(capture, exposure_s=known.pop())
    await context.recorder.write(transitions.describe_capture, described)
    return described


async def complete(context: AcquisitionContext, capture: CaptureRecord, frames: list[FrameRecord]) -> CaptureRecord:
    """Every frame is stored: write what measuring needs beside them, and tell."""
    if not capture.is_sharp:
        path = capture_folder(context.data, capture) / "capture.toml"
        await context.recorder.on_disk(write_durably, path, capture_toml(capture))
    told = {
        "step": capture.step if capture.step >= 0 else None,
        "label": capture.label,
        "sharp": capture.is_sharp,
        "opened_at": capture.opened_at,
        "exposure_s": capture.exposure_s or None,
        "group": capture.grouped,
        "phase_rad": opening_phase(capture),
        "frequency_hz": capture.frequency_hz,
        "excitation_amplitude_mm": capture.amplitude_mm,
        "frames": [
            {"camera": frame.camera, "path": frame.path, "size_bytes": frame.size_bytes, "sha256": frame.sha256}
            for frame in frames
        ],
    }
    await context.recorder.write(transitions.complete_capture, capture.campaign, capture.name, told)
    return replace(capture, state="stored")


async def _expose_for(context: AcquisitionContext, exposure_s: float) -> None:
    """Set every body to this exposure, once."""
    for name, camera in context.rig.cameras.items():
        if context.exposures_s.get(name) == exposure_s:
            continue
        choice = context.cameras.get(name, CameraOverrides())
        own_s = await camera.call(
            lambda driver, choice=choice: driver.configure(  # type: ignore[misc]
                exposure_s=exposure_s, f_number=choice.f_number, iso=choice.iso
            )
        )
        if abs(own_s - exposure_s) > EXPOSURE_WITHIN * exposure_s:
            raise DeviceRefused(
                f"exposes for {own_s:.4g} s where {exposure_s:.4g} s was planned; set its dial to M or S", device=name
            )
        context.exposures_s[name] = exposure_s


async def _fire(
    context: AcquisitionContext, order: CaptureRecord, phase_rad: float | None, request_id: str | None
) -> tuple[CaptureRecord, float]:
    """Release the shutters; the capture with its opening, and the opening on the host's monotonic clock."""
    if context.rig.trigger is None:
        raise DeviceError("shutters are released by an outside system; use a phase of kind external", device="trigger")
    try:
        firing = await context.rig.trigger.call(
            lambda driver: driver.fire(order.exposure_s, frequency_hz=order.frequency_hz, phase_rad=phase_rad),
            order.exposure_s + CALL_S,
        )
    except DeviceRefused:
        for camera in order.cameras:  # nothing was released, so no camera owes a file
            this = OwedFile(camera, order.campaign, order.name, "", order.exposure_s)
            await context.recorder.write(card_records.forget_owed, camera, [this])
        raise
    opened_s = context.clock.monotonic()
    capture = with_opening(order, rfc3339(firing.opened_at), firing.opening_s, firing.phase_rad, firing.sd_phase_rad)
    await context.recorder.write(
        transitions.fire_capture,
        capture.campaign,
        capture.name,
        opened_at=rfc3339(firing.opened_at),
        opening_s=capture.opening_s,
        phase_rad=capture.phase_rad,
        sd_phase_rad=capture.sd_phase_rad,
        request_id=request_id,
    )
    return capture, opened_s


async def _store(context: AcquisitionContext, capture: CaptureRecord, camera: str, file: CardFile) -> FrameRecord:
    path = frame_path(context.data, capture, camera, file)
    return await store(
        context.rig.cameras[camera],
        file,
        path,
        context.recorder,
        context.clock,
        campaign=capture.campaign,
        capture=capture.name,
    )
