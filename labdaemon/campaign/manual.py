"""Captures outside any campaign: a person's, and those of an outside system while the daemon only listens."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Coroutine
from contextlib import aclosing
from dataclasses import dataclass, replace
from typing import Any, Protocol

from labdaemon.campaign.manual_measurements import ManualMeasurements
from labdaemon.campaign.manual_request import ManualRequest, capture_name
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.step_runner import StepRunner
from labdaemon.campaign.table_motion import TableMotion, contradiction, observe_table
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.external import ExternalRelease, ExternalReleases
from labdaemon.capture.pairing import ReleasePairing
from labdaemon.capture.paths import capture_folder
from labdaemon.capture.request import CaptureRequest
from labdaemon.durable import write_durably
from labdaemon.errors import DeviceError, LabdaemonError
from labdaemon.journal import records, transitions
from labdaemon.journal.records import NO_STEP, UNKNOWN_EXPOSURE_S, CaptureRecord
from labdaemon.stream.messages import BusyError, InvalidParamsError

ANSWER_S = 10.0
"""How long a request waits for the outside system to release before it is answered without an opening."""
EXPECTED_S = 600.0
"""A release that comes later than this after its request is another one: what was asked has been forgotten."""
MOST_EXPECTED = 8  # a program that asks for more has lost count of what the outside system fires

log: logging.Logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedRelease:
    """A request whose shutters an outside system will release."""

    request: ManualRequest
    campaign: str
    name: str
    until_s: float
    fired: asyncio.Future[CaptureRecord]


@dataclass(frozen=True, slots=True)
class ManualObserver:
    """Follows one manual capture; see `labdaemon.capture.request.CaptureObserver`.

    Attributes
    ----------
    captures
        Knows the table gauge, and who measures the capture.
    request
        What was stated of it.
    fired
        Gets the opening; None where no request waits for it.
    """

    captures: ManualCaptures
    request: ManualRequest
    fired: asyncio.Future[CaptureRecord] | None

    def capture_started(self) -> None:
        """Nothing interrupts a manual capture."""

    def capture_fired(self, capture: CaptureRecord) -> None:
        if self.fired is not None and not self.fired.done():
            self.fired.set_result(capture)

    async def describe(self, capture: CaptureRecord) -> CaptureRecord:
        return await self.captures.describe(self.request, capture)

    async def capture_stored(self, capture: CaptureRecord) -> None:
        await self.captures.measurements.add(capture)

    def capture_ended(self) -> None:
        """Nothing waits for its end."""


class RecoveryRequester(Protocol):
    """Sees to it that what an interrupted capture left is settled before anything else runs."""

    def request_recovery(self) -> None:
        """A capture failed after it was fired."""
        ...


class ManualCaptures:
    """Takes captures as the rig is, under the standing manual campaign or under a paused one.

    Parameters
    ----------
    context
        The rig and the journal.
    measurements
        What becomes of them.
    reporter
        Where faults are reported.
    window_s
        Frames of one outside release arrive from all cameras within this time.
    recovery
        Is asked for recovery when a capture failed after it was fired.
    """

    def __init__(
        self,
        context: AcquisitionContext,
        measurements: ManualMeasurements,
        reporter: CampaignReporter,
        window_s: float,
        recovery: RecoveryRequester,
    ) -> None:
        self._recovery = recovery
        self._context, self._reporter, self._window_s = context, reporter, window_s
        self.measurements = measurements
        self.turn: asyncio.Lock = asyncio.Lock()
        """Held while a capture is taken, and by whoever moves the table meanwhile."""
        self._tasks: set[asyncio.Task[None]] = set()
        self._expected: deque[ExpectedRelease] = deque()
        self._arrivals = ReleasePairing(tuple(context.rig.cameras), window_s)
        self._gauge_trouble: str | None = None
        self.exposure_s: float = 1.0
        """Exposure of captures outside any plan that the daemon releases."""

    @property
    def expected(self) -> int:
        """Captures that wait for an outside system to release."""
        return len(self._expected)

    async def capture(self, request: ManualRequest, *, campaign: str | None) -> CaptureRecord:
        """Fire once, as the rig is; returns once fired, with storing and measuring still to come.

        Where an outside system releases, its next release is this capture. The answer waits a while for it, and then
        has no opening.

        Parameters
        ----------
        campaign
            The paused campaign that it goes to; None for the manual one.

        Raises
        ------
        DeviceError
            Trigger or cameras refused.
        InvalidParamsError
            The group has the name of a capture, or of planned ones.
        BusyError
            Too many captures wait for an outside system already.
        """
        group = request.group
        if group is not None and records.is_taken(
            self._context.recorder.journal, campaign or transitions.MANUAL, group
        ):
            raise InvalidParamsError(
                f"group {group!r} is the name of a capture, or of a planned group; take another one"
            )
        if self._context.rig.trigger is None:
            return await self._await_release(request, campaign)
        await self.turn.acquire()
        fired: asyncio.Future[CaptureRecord] = asyncio.get_running_loop().create_future()
        task = self._start(self._acquire(request, campaign, fired))
        task.add_done_callback(lambda task: self._acquisition_done(task, fired))
        return await asyncio.shield(fired)

    async def listen(self, campaign: str | None) -> None:
        """Keep every capture that an outside system fires, until cancelled; one that has come is kept all the same."""
        id = await self.measurements.open(campaign)
        async with aclosing(ExternalReleases(self._context, id, self._arrivals, self.turn).until(None)) as releases:
            async for release in releases:
                await asyncio.shield(self._start(self._store_release(id, release)))

    async def finish(self) -> None:
        """Wait for captures that are still being stored."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))

    async def _acquire(
        self, request: ManualRequest, campaign: str | None, fired: asyncio.Future[CaptureRecord]
    ) -> None:
        id = await self.measurements.open(campaign)
        exposure_s = request.exposure_s or self.exposure_s
        try:
            capture_request = self._request(request, id, self._free_name(id, request.label), exposure_s)
            await StepRunner(self._context, id, ManualObserver(self, request, fired)).capture(capture_request)
        except LabdaemonError as exc:
            if not fired.done():
                fired.set_exception(exc)
                return
            await self._reporter.fault(exc, campaign=id, step=None, action="recover")
            self._recovery.request_recovery()

    async def _await_release(self, request: ManualRequest, campaign: str | None) -> CaptureRecord:
        """Have the next outside release be this capture."""
        now_s = self._context.clock.monotonic()
        self._drop_late(now_s)
        again = [one for one in self._expected if request.request_id and one.request.request_id == request.request_id]
        if not again:
            if len(self._expected) >= MOST_EXPECTED:
                raise BusyError(f"{MOST_EXPECTED} captures wait for the outside system to release already")
            id = await self.measurements.open(campaign)
            name = self._free_name(id, request.label)
            fired: asyncio.Future[CaptureRecord] = asyncio.get_running_loop().create_future()
            again = [ExpectedRelease(request, id, name, now_s + EXPECTED_S, fired)]
            self._expected.append(again[0])
        expected = again[0]
        await asyncio.wait([expected.fired], timeout=ANSWER_S)
        if expected.fired.done():
            return expected.fired.result()
        return self._request(
            request, expected.campaign, expected.name, request.exposure_s or UNKNOWN_EXPOSURE_S
        ).intended()

    async def _store_release(self, campaign: str, release: ExternalRelease) -> None:
        """Store an outside release as the capture that was asked for, or as one that was not announced."""
        self._drop_late(self._context.clock.monotonic())
        expected = self._expected.popleft() if self._expected else None
        request = expected.request if expected is not None else ManualRequest("outside")
        name = expected.name if expected is not None else self._free_name(campaign, request.label)
        observer = ManualObserver(self, request, expected.fired if expected is not None else None)
        capture_request = self._request(request, campaign, name, request.exposure_s or UNKNOWN_EXPOSURE_S)
        await StepRunner(self._context, campaign, observer).store_release(capture_request, release)

    def _drop_late(self, now_s: float) -> None:
        while self._expected and self._expected[0].until_s < now_s:
            late = self._expected.popleft()
            log.warning("no outside release within %g s for %s: no longer waited for", EXPECTED_S, late.name)

    def _free_name(self, campaign: str, label: str) -> str:
        journal = self._context.recorder.journal
        number, reserved = records.manual_count(journal, campaign) + 1, {one.name for one in self._expected}
        number += len(reserved)
        while (name := capture_name(number, label)) in reserved or records.has_capture(journal, campaign, name):
            number += 1
        return name

    def _request(self, request: ManualRequest, campaign: str, name: str, exposure_s: float) -> CaptureRequest:
        """The capture to be. What was stated comes first, then what our own shaker was set to."""
        own = self._context.table.excitation
        frequency_hz, amplitude_mm = request.frequency_hz, request.amplitude_mm
        if own is not None:
            frequency_hz = own.frequency_hz if frequency_hz is None else frequency_hz
            amplitude_mm = own.amplitude_mm if amplitude_mm is None else amplitude_mm
        return CaptureRequest(
            campaign=campaign,
            name=name,
            step=NO_STEP,
            shot=0,
            label=request.label or name,
            is_sharp=request.is_sharp,
            sharp=name if request.is_sharp else self.measurements.sharp_of(campaign, request.group),
            group=request.group,
            frequency_hz=frequency_hz,
            amplitude_mm=amplitude_mm,
            exposure_s=exposure_s,
            cameras=tuple(self._context.rig.cameras),
            stated_phase_rad=request.phase_rad,
            request_id=request.request_id,
        )

    async def describe(self, request: ManualRequest, capture: CaptureRecord) -> CaptureRecord:
        """Take frequency and amplitude from the table gauge where they were not stated, and compare where they were."""
        if self._context.table.excitation is not None:
            return capture
        try:
            seen = await observe_table(self._context.rig, request.frequency_hz, capture.exposure_s)
        except DeviceError as exc:
            if self._gauge_trouble != str(exc):  # once, not for every capture of a night
                self._gauge_trouble = str(exc)
                await self._reporter.fault(exc, campaign=capture.campaign, step=None, action="kept as stated")
            return capture
        self._gauge_trouble = None
        if seen is None:
            return capture
        if capture.is_sharp:
            await self._note_motion(capture, seen)
            return capture
        differs = contradiction(seen, request.frequency_hz, request.amplitude_mm)
        if differs is not None:
            await self._reporter.fault(differs, campaign=capture.campaign, step=None, action="kept as stated")
        described = capture
        if capture.frequency_hz is None and seen.frequency_hz is not None:
            described = replace(described, frequency_hz=seen.frequency_hz)
        if capture.amplitude_mm is None and seen.frequency_hz is not None:
            described = replace(described, amplitude_mm=seen.amplitude_mm)
        if described != capture:
            await self._context.recorder.write(transitions.describe_capture, described)
        return described

    async def _note_motion(self, capture: CaptureRecord, seen: TableMotion) -> None:
        """A sharp set of a table that moves gives shape and names, but no rest position: `process` must know it too."""
        if seen.frequency_hz is None:
            return
        note = capture_folder(self._context.data, capture) / "set.toml"
        await self._context.recorder.on_disk(write_durably, note, "at_rest = false\n")
        exc = DeviceError(
            f"sees {seen.amplitude_mm or 0.0:.3g} mm at {seen.frequency_hz:.4g} Hz while the sharp set {capture.name} "
            "was taken: it gives shape and names only; take another one with the table at rest",
            device=seen.gauge,
        )
        await self._reporter.fault(exc, campaign=capture.campaign, step=None, action="kept as not at rest")

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _acquisition_done(self, task: asyncio.Task[None], fired: asyncio.Future[CaptureRecord]) -> None:
        """However it ended, the turn is given back and who waits for the opening is answered."""
        self.turn.release()
        error = None if task.cancelled() else task.exception()
        if not fired.done():
            fired.set_exception(error or LabdaemonError("the capture was given up before the shutters opened"))
        elif error is not None:
            log.error("a manual capture was not stored", exc_info=error)
