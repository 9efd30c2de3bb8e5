"""Runs one step: what each kind of phase asks of table, shutters and time."""

from __future__ import annotations

from contextlib import aclosing
from dataclasses import dataclass

from labdaemon.campaign.steps import Shot, Step
from labdaemon.capture.acquisition import acquire
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.external import ExternalRelease, ExternalReleases, store_release
from labdaemon.capture.pairing import ReleasePairing
from labdaemon.capture.paths import sharp_folder
from labdaemon.capture.request import CaptureObserver, CaptureRequest
from labdaemon.capture.settle import Excitation
from labdaemon.durable import write_durably
from labdaemon.errors import DeviceError, UsageError
from labdaemon.journal import records
from labdaemon.journal.records import CaptureRecord, CaptureState

DONE: tuple[CaptureState, ...] = ("stored", "measured", "unmeasured")


@dataclass(frozen=True, slots=True)
class StepRunner:
    """Runs steps of one campaign, and single captures outside any.

    Attributes
    ----------
    observer
        Follows every capture.
    window_s
        Frames of an outside release arrive within this time, seconds.
    """

    context: AcquisitionContext
    campaign: str
    observer: CaptureObserver
    window_s: float = 5.0

    async def run(self, step: Step) -> None:
        """Do what the step asks, leaving out shots that were taken before an interruption.

        Raises
        ------
        DeviceError, DataError, InterlockError
            A capture failed, or outside releases did not come.
        """
        match step.kind:
            case "pause":
                await self.context.table.rest()
                await self.context.clock.sleep(step.hold_s)
            case "external":
                await self._run_external(step)
            case "sharp":
                await self._run_sharp(step)
            case _:
                await self._run_excited(step)

    async def capture(self, request: CaptureRequest) -> CaptureRecord:
        """Take one capture; see `acquire`."""
        try:
            return await acquire(self.context, request, self.observer)
        finally:
            self.observer.capture_ended()

    async def store_release(self, request: CaptureRequest, release: ExternalRelease) -> None:
        """Store an outside release as a capture; see `labdaemon.capture.external.store_release`."""
        await store_release(self.context, request, release, self.observer)

    async def _run_excited(self, step: Step) -> None:
        excitation = excitation_of(step)
        await self.context.table.shake(excitation)
        if step.hold_s:
            await self.context.clock.sleep(step.hold_s)
        for place, shot in self._remaining_shots(step):
            await self.capture(self._request(step, place, shot, excitation))

    async def _run_sharp(self, step: Step) -> None:
        if step.at_rest:
            await self.context.table.rest()
        else:
            note = sharp_folder(self.context.data, self.campaign, step.sharp_set) / "set.toml"
            await self.context.recorder.on_disk(write_durably, note, "at_rest = false\n")
        if self.context.rig.trigger is None:
            await self._run_external(step)
            return
        for place, shot in self._remaining_shots(step):
            await self.capture(self._request(step, place, shot))

    async def _run_external(self, step: Step) -> None:
        """Keep what others fire, until as many as planned have come or the time is over."""
        end_s = self.context.clock.monotonic() + step.hold_s if step.hold_s else None
        arrivals = ReleasePairing(tuple(self.context.rig.cameras), self.window_s)
        planned = self._remaining_shots(step)
        taken = 0
        async with aclosing(ExternalReleases(self.context, self.campaign, arrivals).until(end_s)) as releases:
            async for release in releases:
                place, shot = planned[taken] if taken < len(planned) else (len(step.shots) + taken, Shot(1.0))
                await self.store_release(self._request(step, place, shot), release)
                taken += 1
                if planned and taken == len(planned):
                    return
        if taken < len(planned):
            raise DeviceError(
                f"{len(planned) - taken} of {len(planned)} outside releases did not come within {step.hold_s:g} s",
                device="trigger",
            )

    def _remaining_shots(self, step: Step) -> list[tuple[int, Shot]]:
        """Shots of the step that no completed capture has, each with its place."""
        journal = self.context.recorder.journal
        taken = {capture.shot for capture in records.captures(journal, self.campaign, *DONE, step=step.index)}
        return [(place, shot) for place, shot in enumerate(step.shots) if place not in taken]

    def _request(self, step: Step, place: int, shot: Shot, excitation: Excitation | None = None) -> CaptureRequest:
        """The capture to be, under a name that no earlier attempt had."""
        attempt = 1 + records.count_shots(self.context.recorder.journal, self.campaign, step.index, place)
        name = f"{step.label}-{place + 1:02d}" + (f"-r{attempt}" if attempt > 1 else "")
        return CaptureRequest(
            campaign=self.campaign,
            name=name,
            step=step.index,
            shot=place,
            label=step.label,
            is_sharp=step.kind == "sharp",
            sharp=step.sharp_set or None,
            group=step.label if step.grouped else None,
            frequency_hz=step.frequency_hz,
            amplitude_mm=step.amplitude_mm,
            exposure_s=shot.exposure_s,
            cameras=tuple(self.context.rig.cameras),
            excitation=excitation,
            trigger_phase_rad=None if step.kind == "external" else shot.phase_rad,
            stated_phase_rad=shot.phase_rad if step.kind == "external" else None,
            light=shot.light,
        )


def excitation_of(step: Step) -> Excitation:
    """What a step sets the table to."""
    if step.frequency_hz is None or step.amplitude_mm is None:
        raise UsageError(f"step {step.label} is to shake the table, but has no frequency or amplitude")
    rule = step.settle
    return Excitation(
        step.frequency_hz, step.amplitude_mm, rule.max_change_per_cycle, rule.timeout_s, rule.damping_ratio
    )
