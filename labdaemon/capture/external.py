"""Captures that an outside system releases: noticed by the trigger device, or by the files alone, and stored."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from datetime import datetime, timedelta

from labdaemon.capture.acquisition import store_frames
from labdaemon.capture.collect import store, wait_frame
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.devices import CardFile, Firing
from labdaemon.capture.gauge_motion import RecordWindow, fit_gauges, read_gauges
from labdaemon.capture.own_frames import wait_external_frames
from labdaemon.capture.pairing import ReleasePairing
from labdaemon.capture.paths import set_aside_path, with_opening
from labdaemon.capture.request import CaptureObserver, CaptureRequest
from labdaemon.clock import rfc3339
from labdaemon.events import FaultData
from labdaemon.journal import transitions
from labdaemon.journal.records import CaptureRecord

WAIT_SLICE_S = 1.0
"""Longest single wait for an outside release."""


@dataclass(frozen=True, slots=True)
class ExternalRelease:
    """One release by an outside system.

    Attributes
    ----------
    files
        Each camera's file.
    firing
        What the trigger device saw of it; None without such a device.
    first_s
        Monotonic time at which the first file arrived, where that is all that is known.
    """

    files: dict[str, CardFile]
    firing: Firing | None
    first_s: float


class ExternalReleases:
    """Waits for releases of an outside system.

    Parameters
    ----------
    context
        The rig and the journal.
    campaign
        Where files go that make no capture.
    arrivals
        Frames whose companions are still to come; kept by its owner from one wait to the next.
    turn
        Held from a release to the end of its capture, so that no other one is fired into it.
    """

    def __init__(
        self, context: AcquisitionContext, campaign: str, arrivals: ReleasePairing, turn: asyncio.Lock | None = None
    ) -> None:
        self._context, self._campaign, self._arrivals = context, campaign, arrivals
        self._turn = turn or asyncio.Lock()

    async def until(self, end_s: float | None) -> AsyncGenerator[ExternalRelease]:
        """Releases as they come, until this monotonic time; without end where it is None."""
        clock, rig, arrivals = self._context.clock, self._context.rig, self._arrivals
        # Releases that came while nothing listened: recovery has dealt with their files.
        while rig.trigger is not None and await rig.trigger.call(lambda driver: driver.wait(0.0), 10.0) is not None:
            continue
        while end_s is None or clock.monotonic() < end_s:
            if rig.trigger is not None:
                firing = await rig.trigger.call(lambda driver: driver.wait(WAIT_SLICE_S), WAIT_SLICE_S + 10.0)
                if firing is not None:
                    async with self._turn:
                        longest_s = max(self._context.exposures_s.values(), default=0.0)
                        files = await wait_external_frames(self._context.frames, firing.opened_at, longest_s)
                        yield ExternalRelease(files, firing, arrivals.first_s)
                continue
            found = await asyncio.gather(
                *(wait_frame(camera, self._context.recorder, clock, WAIT_SLICE_S) for camera in rig.cameras.values())
            )
            for name, file in zip(rig.cameras, found, strict=True):
                if file is not None and (whole := arrivals.add(name, file, clock.monotonic())) is not None:
                    yield ExternalRelease(whole, None, arrivals.first_s)
            for name, file in arrivals.late(clock.monotonic()):
                await self._set_aside(name, file)

    async def _set_aside(self, name: str, file: CardFile) -> None:
        """A frame whose companions never came."""
        await store(
            self._context.rig.cameras[name],
            file,
            set_aside_path(self._context.data, self._campaign, "", name, file.name),
            self._context.recorder,
            self._context.clock,
            campaign=self._campaign,
            capture="",
            state="set_aside",
        )
        message = f"{file.name} came alone, without the other cameras' frames, and was set aside"
        payload = FaultData(device=name, error="DeviceError", message=message, action="set aside")
        await self._context.recorder.write(transitions.fault, self._campaign, payload)


async def store_release(
    context: AcquisitionContext, request: CaptureRequest, release: ExternalRelease, observer: CaptureObserver
) -> None:
    """Store the files of an outside release as a capture; the counterpart of `acquire`.

    Raises
    ------
    DeviceError, DataError
        The capture failed. What it left, on cards and in the journal, is for `labdaemon.capture.recover`.
    """
    observer.capture_started()
    intended = request.intended()
    await context.recorder.write(transitions.intend_capture, intended)
    firing = release.firing
    opened_at = rfc3339(firing.opened_at if firing is not None else _opened_at(context, request, release))
    opening_s = firing.opening_s if firing is not None else {}
    phase_rad, sd_rad = (firing.phase_rad, firing.sd_phase_rad) if firing is not None else (None, 0.0)
    capture = with_opening(intended, opened_at, opening_s, phase_rad, sd_rad)
    await context.recorder.write(
        transitions.fire_capture,
        capture.campaign,
        capture.name,
        opened_at=opened_at,
        opening_s=opening_s,
        phase_rad=capture.phase_rad,
        sd_phase_rad=capture.sd_phase_rad,
        request_id=request.request_id,
    )
    observer.capture_fired(capture)
    try:
        reports = await read_gauges(context.rig, context.clock, _record_window(context, capture, firing, release))
        capture = await observer.describe(capture)
        gauges = await context.recorder.in_background(fit_gauges, reports, capture)
        capture = await store_frames(context, capture, release.files, gauges=gauges)
        observer.capture_ended()  # it is safe: the step may be left now, even while the measurement queue is full
        await observer.capture_stored(capture)
    finally:
        observer.capture_ended()


def _record_window(
    context: AcquisitionContext, capture: CaptureRecord, firing: Firing | None, release: ExternalRelease
) -> RecordWindow:
    """When to look at the gauges: about the exposure, which files alone show too badly for a phase."""
    if firing is None:
        opened_s = release.first_s - capture.exposure_s
    else:
        opened_s = context.clock.monotonic() - (context.clock.now() - firing.opened_at).total_seconds()
    return RecordWindow.of_exposure(opened_s, capture.exposure_s, capture.frequency_hz, is_timed=firing is not None)


def _opened_at(context: AcquisitionContext, request: CaptureRequest, release: ExternalRelease) -> datetime:
    """About when the shutters opened, where only the files' arrival is seen: the first comes at their end."""
    since_s = context.clock.monotonic() - release.first_s
    return context.clock.now() - timedelta(seconds=since_s + request.exposure_s)
