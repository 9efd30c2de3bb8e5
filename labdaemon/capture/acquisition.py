"""One capture, from the table's excitation to stored frames: `acquire` is the whole sequence."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from labdaemon.capture.collect import identity, store
from labdaemon.capture.context import AcquisitionContext, CameraOverrides
from labdaemon.capture.devices import CardFile
from labdaemon.capture.exposure import true_steps_s
from labdaemon.capture.gather import gather_to_completion
from labdaemon.capture.gauge_motion import RecordWindow, fit_gauges, read_gauges
from labdaemon.capture.lighting import record_light, release
from labdaemon.capture.own_frames import clock_offsets, prepare_cameras, wait_frames
from labdaemon.capture.pairing import Opening
from labdaemon.capture.paths import (
    capture_folder,
    capture_toml,
    frame_path,
    opening_phase,
    with_opening,
)
from labdaemon.capture.request import CaptureObserver, CaptureRequest
from labdaemon.clock import parse_rfc3339, rfc3339
from labdaemon.durable import write_durably
from labdaemon.errors import DataError, DeviceError, DeviceRefused, InterlockError
from labdaemon.events import CaptureData, FrameFile, GaugeMotion
from labdaemon.journal import card_records, transitions
from labdaemon.journal.card_records import ClockOffset, OwedFile
from labdaemon.journal.gauge_records import gauges_of
from labdaemon.journal.light_record import light_of
from labdaemon.journal.records import UNKNOWN_EXPOSURE_S, CaptureRecord, FrameRecord

EXPOSURE_WITHIN = 0.09
"""A body whose own exposure differs from the planned one by more than this, relative, is refused. Bodies name their
steps in round figures (1.3 s for 1.26 s); the next step of a third of a stop is 26 % away."""


async def acquire(context: AcquisitionContext, request: CaptureRequest, observer: CaptureObserver) -> CaptureRecord:
    """Take one capture.

    Parameters
    ----------
    context
        What it is taken with.
    request
        What it is to be.
    observer
        Learns of each stage, and takes the stored capture over.

    Returns
    -------
    CaptureRecord
        As stored.

    Raises
    ------
    DeviceError, DataError, InterlockError
        The capture failed. What it left, on cards and in the journal, is for `labdaemon.capture.recover`.
    """
    if request.excitation is not None:
        await context.table.shake(request.excitation)
    await _expose_for(context, request.exposure_s)
    seen = await prepare_cameras(context.frames)

    observer.capture_started()
    await context.recorder.write(transitions.intend_capture, request.intended())
    capture, opened_s, timed_s = await _fire(context, request)
    observer.capture_fired(capture)

    opening = Opening(capture.campaign, capture.name, opened_s, capture.exposure_s)
    window = RecordWindow.of_exposure(timed_s, capture.exposure_s, capture.frequency_hz)
    recording = asyncio.create_task(read_gauges(context.rig, context.clock, window))
    try:
        files = await wait_frames(context.frames, opening, seen)
        await context.table.confirm()
        if request.excitation is not None and context.table.excitation != request.excitation:
            raise InterlockError("the table was stopped during the exposure")
        await record_light(context, request)
        capture = await observer.describe(capture)
        gauges = await context.recorder.in_background(fit_gauges, await recording, capture)
    finally:
        recording.cancel()

    capture = await store_frames(context, capture, files, opening, gauges=gauges)
    await observer.capture_stored(capture)
    return capture


async def store_frames(
    context: AcquisitionContext,
    capture: CaptureRecord,
    files: Mapping[str, CardFile],
    opening: Opening | None = None,
    *,
    gauges: Sequence[GaugeMotion] = (),
) -> CaptureRecord:
    """Store one file a camera as this capture's frames, which the journal then vouches for.

    The cameras' clocks are learned from them where the `opening` is known on the monotonic clock. What the `gauges` saw
    is kept with them.
    """
    named = {camera: identity(file) for camera, file in files.items()}
    offsets: list[ClockOffset] = []
    if opening is not None:
        context.clocks.update(files, opening)
        offsets = clock_offsets(context.frames, opening, files)
    await context.recorder.write(transitions.expose_capture, capture.campaign, capture.name, named, offsets, gauges)
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
    except (DataError, OSError, ValueError):  # the file says nothing of it: the exposure stays unknown
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
    """Every frame is stored: write what measuring needs next to them, and publish."""
    light = light_of(context.recorder.journal, capture.campaign, capture.name)
    gauges = gauges_of(context.recorder.journal, capture.campaign, capture.name)
    if not capture.is_sharp:
        path = capture_folder(context.data, capture) / "capture.toml"
        await context.recorder.on_disk(write_durably, path, capture_toml(capture, light, gauges))
    payload = CaptureData(
        capture=capture.name,
        step=capture.step if capture.step >= 0 else None,
        label=capture.label,
        sharp=capture.is_sharp,
        opened_at=parse_rfc3339(capture.opened_at) if capture.opened_at else None,
        exposure_s=capture.exposure_s or None,
        group=capture.grouped,
        phase_rad=opening_phase(capture),
        frequency_hz=capture.frequency_hz,
        excitation_amplitude_mm=capture.amplitude_mm,
        frames=tuple(
            FrameFile(camera=frame.camera, path=frame.path, size_bytes=frame.size_bytes, sha256=frame.sha256)
            for frame in frames
        ),
        gauges=gauges,
        **(light.capture_keys if light is not None else {}),
    )
    await context.recorder.write(transitions.complete_capture, capture.campaign, payload)
    return replace(capture, state="stored")


async def _expose_for(context: AcquisitionContext, exposure_s: float) -> None:
    """Set every body to this exposure, once."""
    for name, camera in context.rig.cameras.items():
        if context.exposures_s.get(name) == exposure_s:
            continue
        overrides = context.cameras.get(name, CameraOverrides())
        own_s = await camera.call(
            lambda driver, overrides=overrides: driver.configure(  # type: ignore[misc]
                exposure_s=exposure_s, f_number=overrides.f_number, iso=overrides.iso
            )
        )
        if abs(own_s - exposure_s) > EXPOSURE_WITHIN * exposure_s:
            raise DeviceRefused(
                f"exposes for {own_s:.4g} s where {exposure_s:.4g} s was planned; set its dial to M or S", device=name
            )
        context.exposures_s[name] = exposure_s


async def _fire(context: AcquisitionContext, request: CaptureRequest) -> tuple[CaptureRecord, float, float]:
    """Release the shutters.

    Returns
    -------
    CaptureRecord
        With its opening.
    float
        When the release was reported, on the host's monotonic clock.
    float
        When the trigger device saw the shutters open, on the same clock.
    """
    if context.rig.trigger is None:
        raise DeviceError("shutters are released by an outside system; use a phase of kind external", device="trigger")
    asked_s = context.clock.monotonic()
    try:
        firing = await release(context, context.rig.trigger, request)
    except DeviceRefused:
        for camera in request.cameras:  # nothing was released, so no camera owes a file
            this = OwedFile(camera, request.campaign, request.name, "", request.exposure_s)
            await context.recorder.write(card_records.forget_owed, camera, [this])
        raise
    opened_s = context.clock.monotonic()
    # The wall clock may have been set meanwhile: the opening lies between the request and its answer in any case.
    timed_s = opened_s - (context.clock.now() - firing.opened_at).total_seconds()
    timed_s = min(max(timed_s, asked_s), opened_s)
    opened_at = rfc3339(firing.opened_at)
    capture = with_opening(request.intended(), opened_at, firing.opening_s, firing.phase_rad, firing.sd_phase_rad)
    await context.recorder.write(
        transitions.fire_capture,
        capture.campaign,
        capture.name,
        opened_at=opened_at,
        opening_s=capture.opening_s,
        phase_rad=capture.phase_rad,
        sd_phase_rad=capture.sd_phase_rad,
        request_id=request.request_id,
    )
    return capture, opened_s, timed_s


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
