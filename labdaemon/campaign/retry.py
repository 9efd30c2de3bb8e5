"""One step through all its attempts: faults, and what `on_fault` decides.

There is one way out of every interruption, be it a fault, a request, an interlock or kill -9: the table to rest, then
`labdaemon.capture.recover` completes or gives up what was in flight, then the step runs again from what the journal
says.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

from labdaemon.campaign.enable_line import EnableLine
from labdaemon.campaign.interlock_monitor import PollIntervals
from labdaemon.campaign.measurement_queue import MeasurementQueue
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.run_control import RunControl, StepInterruption
from labdaemon.campaign.step_runner import StepRunner
from labdaemon.campaign.steps import Step
from labdaemon.campaign.time_of_day import POLL_S, wait_s
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.recover import reconnect_suspects, recover
from labdaemon.capture.table_stop import RestConfirmation
from labdaemon.errors import DeviceError, InterlockError, LabdaemonError, SetupError, StorageUnavailable
from labdaemon.events import StepData
from labdaemon.journal import transitions
from labdaemon.journal.records import CaptureRecord

MAX_BACKOFF_S = 60.0  # a device that comes back in the night is noticed within a minute


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How often and how long the engine tries.

    Attributes
    ----------
    max_tries
        Attempts at a step under ``on_fault = "retry"`` before the campaign is paused.
    backoff_s
        Wait before the second attempt; doubled for each further one, up to a minute.
    accept_changed_rig
        Continue campaigns that were planned for another rig file.
    window_s
        Frames of one outside release arrive from all cameras within this time.
    intervals
        How often the interlock monitor looks.
    accept_no_enable
        Move the table although no enable line was seen to stop it.
    """

    max_tries: int = 4
    backoff_s: float = 2.0
    accept_changed_rig: bool = False
    window_s: float = 5.0
    intervals: PollIntervals = field(default_factory=PollIntervals)
    accept_no_enable: bool = False

    def pause_s(self, failures: int) -> float:
        """Wait after this many failures in a row."""
        return float(min(self.backoff_s * 2.0 ** (failures - 1), MAX_BACKOFF_S))


@dataclass(frozen=True, slots=True)
class CampaignObserver:
    """Follows a campaign's captures; see `labdaemon.capture.request.CaptureObserver`.

    Attributes
    ----------
    control
        Learns when a step must not be interrupted.
    queue
        Takes stored captures over.
    """

    control: RunControl
    queue: MeasurementQueue

    def capture_started(self) -> None:
        self.control.capture_started()

    def capture_fired(self, capture: CaptureRecord) -> None:
        """The journal has it."""

    async def describe(self, capture: CaptureRecord) -> CaptureRecord:
        """The plan has stated everything."""
        return capture

    async def capture_stored(self, capture: CaptureRecord) -> None:
        await self.queue.add(capture)

    def capture_ended(self) -> None:
        self.control.capture_ended()


class RetryingStepRunner:
    """Runs steps, again where need be.

    Parameters
    ----------
    context
        The rig and the journal.
    control
        Where requests and interlocks arrive.
    """

    def __init__(
        self,
        context: AcquisitionContext,
        queue: MeasurementQueue,
        control: RunControl,
        reporter: CampaignReporter,
        policy: RetryPolicy,
    ) -> None:
        self._context, self._queue, self._control = context, queue, control
        self._reporter, self._policy = reporter, policy
        self.enable_line: EnableLine = EnableLine(context, reporter, policy.accept_no_enable)
        self.needs_recovery: bool = True
        """A capture may be in flight that no runner follows: at the start, and after every interruption."""
        self.activity: str = "starting"
        """In a word or two, for status."""
        self.began_s: float | None = None
        """Monotonic time at which the present attempt at a step began; None while no step runs."""

    async def run(self, campaign: str, step: Step, monitor: asyncio.Task[None]) -> None:
        """A step to its end, or until a person asks for something else (see `RunControl.requested`)."""
        await self._attempt(campaign, step, lambda: self._run_once(campaign, step, monitor))

    async def decide(
        self, campaign: str, step: Step, decide: Callable[[], Coroutine[Any, Any, None]], monitor: asyncio.Task[None]
    ) -> None:
        """The excitation of an open step, with the table as the step before left it; interrupted as steps are."""

        async def once() -> None:
            self.activity, self.began_s = "choosing the next step", self._context.clock.monotonic()
            await self._control.run_step(decide(), monitor)

        await self._attempt(campaign, step, once)

    async def _attempt(self, campaign: str, step: Step, work: Callable[[], Awaitable[None]]) -> None:
        failures = 0
        while self._control.requested == "go":
            try:
                if self.needs_recovery:
                    await self.recover(campaign, step)
                await work()
            except StepInterruption:
                self.needs_recovery = True
                return
            except StorageUnavailable as exc:
                await self._wait_for_disk(campaign, step, exc)
            except LabdaemonError as exc:
                failures += 1
                if not await self._handle_fault(campaign, step, exc, failures):
                    return
            else:
                return

    async def recover(self, campaign: str | None, step: Step | None) -> None:
        """Complete or give up whatever was in flight, reaching for lost devices again.

        Raises
        ------
        DeviceError
            A device stays lost, and a campaign waits for it.
        """
        self.activity = "recovering"
        failures = 0
        while True:
            try:
                await self._context.recorder.wait_idle()
                await reconnect_suspects(self._context)
                await recover(self._context)
            except StorageUnavailable as exc:
                await self._reporter.wait_for_disk(exc, campaign)
            except LabdaemonError as exc:
                failures += 1
                self._mark_suspect(exc)
                if campaign is not None and failures >= self._policy.max_tries:
                    raise
                await self._reporter.fault(exc, campaign=campaign, step=step, action="try again")
                await self._context.clock.sleep(self._policy.pause_s(failures))
            else:
                self.needs_recovery = False
                return

    def request_recovery(self) -> None:
        """A capture that no step follows was interrupted: whoever runs next recovers first."""
        self.needs_recovery = True
        self._control.changed.set()

    async def _wait_for_disk(self, campaign: str, step: Step, exc: StorageUnavailable) -> None:
        """The table rests for as long as the disk takes nothing."""
        self.activity = "waiting for the disk"
        try:
            await self.abort_to_rest()
        except InterlockError as worse:
            await self._reporter.fault(worse, campaign=campaign, step=step, action="use the emergency stop")
            self._control.request("pause", str(worse))
        self._control.tripped = None
        await self._reporter.wait_for_disk(exc, campaign)

    async def abort_to_rest(self) -> None:
        """Table to rest before anything else; what was in flight is settled before the next step."""
        self.needs_recovery = True
        await self.stop_table()

    async def stop_table(self) -> RestConfirmation:
        """Table to rest; a stop that did not confirm is reported as a fault, although another one did."""
        rest = await self._context.table.stop()
        if rest.troubles:
            exc = DeviceError(f"brought to rest by {rest.by} stop only: {'; '.join(rest.troubles)}")
            await self._reporter.fault_soon(exc, action="look at the shaker")
        return rest

    async def _run_once(self, campaign: str, step: Step, monitor: asyncio.Task[None]) -> None:
        await self._wait_for_window(step, monitor)
        self.activity, self.began_s = step.kind, self._context.clock.monotonic()
        write = self._context.recorder.write
        payload = StepData(step=step.index, label=step.label, kind=step.kind)
        excitation = {"frequency_hz": step.frequency_hz, "amplitude_mm": step.amplitude_mm}
        await write(transitions.start_step, campaign, payload.model_copy(update=excitation))
        control = self._control
        observer = CampaignObserver(control, self._queue)
        runner = StepRunner(self._context, campaign, observer, window_s=self._policy.window_s)
        await control.run_step(self._catch_up_and_run(runner, step), monitor)
        await write(transitions.end_step, campaign, payload)

    async def _catch_up_and_run(self, runner: StepRunner, step: Step) -> None:
        await self._queue.enqueue_stored(runner.campaign)
        await self.enable_line.check_before(step)
        await runner.run(step)

    async def _handle_fault(self, campaign: str, step: Step, exc: LabdaemonError, failures: int) -> bool:
        """What a fault means for the step; False when it is over for now."""
        action = step.on_fault
        if action == "retry" and (isinstance(exc, InterlockError) or failures >= self._policy.max_tries):
            action = "pause"
        if isinstance(exc, SetupError):
            action = "pause"  # to go on would shake through the night for nothing
        self._mark_suspect(exc)
        try:
            await self.abort_to_rest()
        except InterlockError as worse:
            await self._reporter.fault(worse, campaign=campaign, step=step, action="pause")
            action = "pause"
        await self._reporter.fault(exc, campaign=campaign, step=step, action=action)
        self._control.tripped = None
        match action:
            case "retry":
                await self._context.clock.sleep(self._policy.pause_s(failures))
                return True
            case "skip":
                payload = StepData(step=step.index, label=step.label, kind=step.kind)
                await self._reporter.with_disk_retry(
                    lambda: self._context.recorder.write(transitions.end_step, campaign, payload, str(exc))
                )
            case _ if self._control.requested == "go":
                self._control.request(action, str(exc))
        return False

    def _mark_suspect(self, exc: LabdaemonError) -> None:
        """A device that failed is connected to anew before it is used again."""
        if isinstance(exc, DeviceError) and exc.device is not None:
            self._context.suspect_devices.add(exc.device)

    async def _wait_for_window(self, step: Step, monitor: asyncio.Task[None]) -> None:
        while (left_s := wait_s(self._context.clock.now().astimezone(), step.not_before, step.not_after)) > 0.0:
            self.activity = f"waiting until {step.not_before or '00:00'}"
            if self._context.table.excitation is not None:
                await self._context.table.stop()
            await self._control.wait(monitor, min(left_s, POLL_S))
            if self._control.requested != "go":
                raise StepInterruption
