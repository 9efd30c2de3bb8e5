"""Walking one step: what each kind of phase asks of table, shutters and time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from labdaemon.campaign.steps import Shot, Step
from labdaemon.capture.capture import AcquisitionContext, Describe, Fired, keep, take
from labdaemon.capture.collect import store, wait_frame
from labdaemon.capture.devices import CardFile, Firing
from labdaemon.capture.own_frames import wait_released
from labdaemon.capture.pairing import Arrivals
from labdaemon.capture.paths import set_aside_path, sharp_folder, with_opening
from labdaemon.capture.settle import Excitation
from labdaemon.clock import rfc3339
from labdaemon.durable import write_durably
from labdaemon.errors import DeviceError, UsageError
from labdaemon.journal import records, transitions
from labdaemon.journal.records import CaptureRecord, CaptureState

WAIT_SLICE_S = 1.0
"""Longest single wait for an outside release."""

DONE: tuple[CaptureState, ...] = ("stored", "measured", "unmeasured")


@dataclass(slots=True)
class StepRunner:
    """Walks steps of one campaign.

    Attributes
    ----------
    measure
        Takes stored captures over; see `labdaemon.capture.capture.take`.
    capture_started
        Called when shutters are about to open: from then on a capture is seen to its end.
    capture_ended
        Called when a capture is stored, or has failed.
    window_s
        Frames of an outside release arrive within this time.
    arrivals
        Frames whose companions are still to come, kept from one wait to the next; None to begin without any.
    turn
        Held from an outside release to the end of its capture, so that no other one is fired into it.
    """

    context: AcquisitionContext
    campaign: str
    measure: Callable[[CaptureRecord], Awaitable[None]]
    capture_started: Callable[[], None]
    capture_ended: Callable[[], None]
    window_s: float = 5.0
    arrivals: Arrivals | None = None
    turn: asyncio.Lock | None = None

    async def run(self, step: Step) -> None:
        """Do what the step asks, leaving out shots that were taken before an interruption."""
        match step.kind:
            case "pause":
                await self.context.table.rest()
                await self.context.clock.sleep(step.hold_s)
            case "external":
                await self._external(step)
            case "sharp":
                await self._sharp(step)
            case _:
                await self._run_excited(step)

    async def _run_excited(self, step: Step) -> None:
        excitation = excitation_of(step)
        await self.context.table.shake(excitation)
        if step.hold_s:
            await self.context.clock.sleep(step.hold_s)
        for place, shot in self._remaining_shots(step):
            await self._take(step, place, shot, excitation)

    async def _sharp(self, step: Step) -> None:
        if step.at_rest:
            await self.context.table.rest()
        else:
            note = sharp_folder(self.context.data, self.campaign, step.sharp_set) / "set.toml"
            await self.context.recorder.on_disk(write_durably, note, "at_rest = false\n")
        if self.context.rig.trigger is None:
            await self._external(step)
            return
        for place, shot in self._remaining_shots(step):
            await self._take(step, place, shot, None)

    async def _take(self, step: Step, place: int, shot: Shot, excitation: Excitation | None) -> None:
        order = self.order(step, place, shot)
        try:
            await take(
                self.context,
                order,
                excitation,
                measure=self.measure,
                phase_rad=shot.phase_rad,
                begun=self.capture_started,
            )
        finally:
            self.capture_ended()

    async def _external(self, step: Step) -> None:
        """Keep what others fire, until as many as planned have come or the time is over."""
        end_s = self.context.clock.monotonic() + step.hold_s if step.hold_s else None
        missing = self._remaining_shots(step)
        taken = 0
        async for firing, files in self.releases(end_s):
            place, shot = missing[taken] if taken < len(missing) else (len(step.shots) + taken, Shot(1.0))
            await self.keep_outside(self.order(step, place, shot), firing, files)
            taken += 1
            if missing and taken == len(missing):
                return
        if taken < len(missing):
            raise DeviceError(
                f"{len(missing) - taken} of {len(missing)} outside releases did not come within {step.hold_s:g} s",
                device="trigger",
            )

    async def keep_outside(
        self,
        order: CaptureRecord,
        firing: Firing | None,
        files: dict[str, CardFile],
        *,
        request_id: str | None = None,
        fired: Fired = lambda capture: None,
        describe: Describe | None = None,
    ) -> None:
        """Store the files of an outside release as a capture; see `labdaemon.capture.capture.take`."""
        write = self.context.recorder.write
        self.capture_started()
        await write(transitions.intend_capture, order)
        opened_at = firing.opened_at if firing is not None else self._opened_at(order)
        opening_s = firing.opening_s if firing is not None else {}
        phase_rad = firing.phase_rad if firing is not None else None
        capture = with_opening(
            order, rfc3339(opened_at), opening_s, phase_rad, firing.sd_phase_rad if firing is not None else 0.0
        )
        await write(
            transitions.fire_capture,
            capture.campaign,
            capture.name,
            opened_at=rfc3339(opened_at),
            opening_s=opening_s,
            phase_rad=capture.phase_rad,
            sd_phase_rad=capture.sd_phase_rad,
            request_id=request_id,
        )
        fired(capture)
        try:
            if describe is not None:
                capture = await describe(capture)
            await self._stored(await keep(self.context, capture, files))
        finally:
            self.capture_ended()

    def _opened_at(self, order: CaptureRecord) -> datetime:
        """About when the shutters opened, where only the files' arrival is seen: the first comes at their end."""
        since_s = self.context.clock.monotonic() - self.arrivals.first_s if self.arrivals is not None else 0.0
        return self.context.clock.now() - timedelta(seconds=since_s + order.exposure_s)

    async def releases(self, end_s: float | None) -> AsyncGenerator[tuple[Firing | None, dict[str, CardFile]]]:
        """Outside releases as they come: what the trigger saw of them (None without one), and a file a camera."""
        clock, rig = self.context.clock, self.context.rig
        arrivals = self.arrivals = self.arrivals or Arrivals(tuple(rig.cameras), self.window_s)
        turn = self.turn or asyncio.Lock()
        # Releases that came while nothing listened: recovery has dealt with their files.
        while rig.trigger is not None and await rig.trigger.call(lambda driver: driver.wait(0.0), 10.0) is not None:
            continue
        while end_s is None or clock.monotonic() < end_s:
            if rig.trigger is not None:
                firing = await rig.trigger.call(lambda driver: driver.wait(WAIT_SLICE_S), WAIT_SLICE_S + 10.0)
                if firing is not None:
                    async with turn:
                        longest_s = max(self.context.exposures_s.values(), default=0.0)
                        yield firing, await wait_released(self.context.frames, firing.opened_at, longest_s)
                continue
            found = await asyncio.gather(
                *(wait_frame(camera, self.context.recorder, clock, WAIT_SLICE_S) for camera in rig.cameras.values())
            )
            for name, file in zip(rig.cameras, found, strict=True):
                if file is not None and (files := arrivals.add(name, file, clock.monotonic())) is not None:
                    yield None, files
            for name, file in arrivals.late(clock.monotonic()):
                await self._set_aside(name, file)

    async def _set_aside(self, name: str, file: CardFile) -> None:
        """A frame whose companions never came."""
        path = set_aside_path(self.context.data, self.campaign, "", name, file.name)
        camera = self.context.rig.cameras[name]
        await store(
            camera,
            file,
            path,
            self.context.recorder,
            self.context.clock,
            campaign=self.campaign,
            capture="",
            state="set_aside",
        )
        message = f"{file.name} came alone, without the other cameras' frames, and was set aside"
        told = {"device": name, "error": "DeviceError", "message": message, "action": "set aside"}
        await self.context.recorder.write(transitions.fault, self.campaign, told)

    async def _stored(self, capture: CaptureRecord) -> None:
        """The capture is safe: the step may be left now, even while the measuring queue is full."""
        self.capture_ended()
        await self.measure(capture)

    def _remaining_shots(self, step: Step) -> list[tuple[int, Shot]]:
        """Shots of the step that no completed capture has."""
        taken = {
            capture.shot
            for capture in records.captures(self.context.recorder.journal, self.campaign, *DONE, step=step.index)
        }
        return [(place, shot) for place, shot in enumerate(step.shots) if place not in taken]

    def order(self, step: Step, place: int, shot: Shot) -> CaptureRecord:
        """The capture to be, under a name that no earlier attempt had."""
        attempt = 1 + records.count_shots(self.context.recorder.journal, self.campaign, step.index, place)
        name = f"{step.label}-{place + 1:02d}" + (f"-r{attempt}" if attempt > 1 else "")
        return CaptureRecord(
            campaign=self.campaign,
            name=name,
            step=step.index,
            shot=place,
            label=step.label,
            is_sharp=step.kind == "sharp",
            sharp=step.sharp_set or None,
            grouped=step.label if step.grouped else None,
            state="intended",
            frequency_hz=step.frequency_hz,
            amplitude_mm=step.amplitude_mm,
            exposure_s=shot.exposure_s,
            opened_at=None,
            opening_s={},
            phase_rad=None,
            sd_phase_rad=None,
            cameras=tuple(self.context.rig.cameras),
            files={},
            reason=None,
        )


def excitation_of(step: Step) -> Excitation:
    """What a step sets the table to."""
    if step.frequency_hz is None or step.amplitude_mm is None:
        raise UsageError(f"step {step.label} is to shake the table, but has no frequency or amplitude")
    rule = step.settle
    return Excitation(
        step.frequency_hz, step.amplitude_mm, rule.max_change_per_cycle, rule.timeout_s, rule.damping_ratio
    )
