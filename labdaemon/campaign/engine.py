"""Walks campaigns unattended: one at a time, step by step, through faults, pauses, interlocks and restarts."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.folder import CampaignFiles
from labdaemon.campaign.interlock_monitor import InterlockMonitor
from labdaemon.campaign.interlocks import InterlockLimits, check_envelope
from labdaemon.campaign.lookup import has_ended, named_campaign, outline, state_of
from labdaemon.campaign.manual import ManualCaptures
from labdaemon.campaign.manual_measurements import ManualMeasurements
from labdaemon.campaign.manual_request import ManualRequest
from labdaemon.campaign.measurement_queue import MeasurementQueue, Rows
from labdaemon.campaign.outside_listener import OutsideListener
from labdaemon.campaign.reporter import RECORD_S, CampaignReporter
from labdaemon.campaign.retry import RetryingStepRunner, RetryPolicy
from labdaemon.campaign.run_control import RunControl
from labdaemon.campaign.steps import Plan, Step
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.table_stop import RestConfirmation
from labdaemon.errors import ConfigError, InterlockError, LabdaemonError, StorageError, StorageUnavailable
from labdaemon.journal import records, transitions
from labdaemon.journal.records import CampaignRecord, CampaignState, CaptureRecord
from labdaemon.journal.storage import JournalError
from labdaemon.orbit_size import LargestMotion, largest_motion
from labdaemon.stream.messages import Busy, CommandError, WrongState

log = logging.getLogger(__name__)

CHANGED_RIG = (
    "the rig file has changed since this campaign was planned; put it back, or resume with --accept-changed-rig"
)


class Engine:
    """Walks campaigns, and does what commands ask.

    Parameters
    ----------
    context
        The rig and the journal.
    queue
        Takes stored captures over.
    planner
        A campaign's text to its plan; raises `ConfigError`.
    limits
        Of the interlocks.
    folder_files
        Files that every campaign's folder starts with: ``rig.toml`` and the surveys.
    free_bytes
        Room on the data disk.
    policy
        How patient it is.

    Attributes
    ----------
    current, plan, step
        What is under way; None while idle.
    largest
        Largest motion of the latest envelope.
    """

    def __init__(
        self,
        context: AcquisitionContext,
        queue: MeasurementQueue,
        planner: Callable[[str], Plan],
        limits: InterlockLimits,
        *,
        folder_files: Mapping[str, str],
        free_bytes: Callable[[], int],
        policy: RetryPolicy | None = None,
    ) -> None:
        self.context, self.queue, self.limits = context, queue, limits
        self.policy = policy = policy or RetryPolicy()
        self._planner, self._journal = planner, context.recorder.journal
        self.control = RunControl()
        self.disk = DataDisk(context.recorder, free_bytes, limits.min_disk_bytes)
        self.reporter = CampaignReporter(context.recorder, context.clock, self.disk)
        self.files = CampaignFiles(context.recorder, context.data, queue, self.reporter, folder_files)
        self.step_runner = RetryingStepRunner(context, queue, self.control, self.reporter, policy)
        self.monitor = InterlockMonitor(
            context,
            limits,
            self.trip,
            disk=self.disk,
            oldest_s=queue.oldest_s,
            no_capture_in_flight=self.control.no_capture_in_flight.wait,
            intervals=policy.intervals,
        )
        self.enable_line = self.step_runner.enable_line
        manual = ManualMeasurements(context, queue, self.reporter, folder_files)
        self.manual = ManualCaptures(context, manual, self.reporter, policy.window_s, self._recover_soon)
        self._outside = OutsideListener(context, self.manual, self.step_runner, self.reporter, policy)
        queue.published, queue.with_disk_retry = self._on_published, self.reporter.with_disk_retry
        self._stops: set[asyncio.Task[None]] = set()
        self.current: CampaignRecord | None = None
        self.plan: Plan | None = None
        self.step: Step | None = None
        self.largest: LargestMotion | None = None

    async def run(self) -> None:
        """Walk campaigns until cancelled. The table must be at rest."""
        monitor = asyncio.create_task(self.monitor.run())
        try:
            self._start(self.queue.mend())
            while True:
                try:
                    await self._do_next(monitor)
                except StorageUnavailable as exc:  # a read or write that nothing nearer has waited with
                    await self._rest()
                    await self.reporter.wait_for_disk(exc)
        finally:
            monitor.cancel()
            with suppress(asyncio.CancelledError):
                await monitor

    async def _do_next(self, monitor: asyncio.Task[None]) -> None:
        self.control.changed.clear()
        record = self._next()
        if record is not None:
            await self._take_up(record, monitor)
            return
        if self.step_runner.needs_recovery:
            await self.step_runner.recover(None, None)
        await self._idle(monitor)

    def trip(self, error: LabdaemonError) -> None:
        """Interlock: stop the table at once; the step is left, and its `on_fault` decides what becomes of it."""
        if self.control.tripped is not None or not (self.control.is_running_step or self.context.table.excitation):
            return
        log.error("interlock: %s", error)
        self._start(self._stop_table())
        self.control.trip(error)

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._stops.add(task)
        task.add_done_callback(self._stops.discard)
        return task

    def report(self, error: LabdaemonError, action: str) -> None:
        """A fault outside any step, as of a wire that was lost: it is written as soon as it can be."""
        log.error("%s", error)
        self._start(self._fault(error, action))

    async def submit(self, plan: Plan, request_id: str | None = None) -> str:
        """Queue a checked campaign; its id, once it is in the journal.

        Raises
        ------
        WrongState
            It moves the table, and the enable line was not seen to stop it; see `labdaemon.campaign.enable_line`.
        """
        async with self.manual.turn:  # the proof moves the table, which no capture may see
            await self.enable_line.admit(plan, is_idle=self._next() is None)
        id = await self.context.recorder.write(transitions.submit, plan.name, plan.toml, plan.digest, request_id)
        self.control.changed.set()
        return id

    async def pause(self, campaign: str | None = None, reason: str = "asked for") -> str:
        """Bring the table to rest and wait for `resume`; the campaign's id.

        Raises
        ------
        NotFound, WrongState
            There is no such campaign, or it is not running.
        """
        record = named_campaign(self._journal, campaign, self.current, "running")
        self.control.request("pause", reason)
        if not await self._move(record, "paused", reason):
            raise WrongState(f"campaign {record.id} has just ended")
        return record.id

    async def resume(self, campaign: str | None = None, *, accept_changed_rig: bool = False) -> str:
        """Go on with a paused campaign; its id.

        Raises
        ------
        NotFound, WrongState
            There is no such campaign, it is not paused, or it was planned for another rig.
        """
        record = named_campaign(self._journal, campaign, self.current, "paused")
        plan = await self.context.recorder.in_background(self._planner, record.toml)
        if plan.digest != record.digest:
            if not accept_changed_rig:
                raise WrongState(f"{record.id}: {CHANGED_RIG}")
            await self.files.accept(record, plan.digest)
        if not await self._move(record, "running", **outline(plan)):
            raise WrongState(f"campaign {record.id} has just ended")
        self.control.clear()
        return record.id

    async def abort(self, campaign: str | None = None, reason: str = "asked for") -> str:
        """End a campaign for good, running, paused or queued; its id.

        Raises
        ------
        NotFound, WrongState
            There is no such campaign, or it has ended.
        """
        record = named_campaign(self._journal, campaign, self.current, "running", "paused", "queued")
        if self.current is None or record.id != self.current.id:
            await self._move(record, "aborted", reason)
        else:
            self.control.request("abort", reason)
        return record.id

    async def capture(self, request: ManualRequest) -> CaptureRecord:
        """Fire once, as the rig is; for a paused campaign, or for none.

        Raises
        ------
        Busy
            A campaign is running.
        DeviceError
            Trigger or cameras refused.
        """
        if self.current is not None and state_of(self._journal, self.current.id) != "paused":
            raise Busy(f"campaign {self.current.id} is running; pause it first")
        campaign = self.current.id if self.current is not None else None
        if self.step_runner.needs_recovery:
            await self.manual.finish()
            await self.step_runner.recover(campaign, None)
        try:
            return await self.manual.capture(request, campaign=campaign)
        except CommandError:
            raise
        except LabdaemonError:
            self.step_runner.needs_recovery = True
            raise

    async def stop(self) -> RestConfirmation:
        """Shaker to rest now, in every state; a running campaign is paused.

        Raises
        ------
        InterlockError
            Nothing confirmed.
        """
        reason = "stopped by a person"
        record = self.current
        with suppress(StorageError):  # nothing may keep the table from being stopped
            record = record or self._next()  # one that is about to be taken up counts
        is_running = record is not None and self.control.requested == "go"
        self.control.request("pause" if is_running else self.control.requested, reason, at_once=True)
        try:
            return await self.step_runner.stop_table()
        finally:
            if record is not None and is_running:
                # What was seen of the table is answered also while the disk takes no record of it.
                await asyncio.wait({self._start(self._pause_stopped(record, reason))}, timeout=RECORD_S)

    async def _pause_stopped(self, record: CampaignRecord, reason: str) -> None:
        await self._move(record, "paused", reason)
        self.control.request("pause", reason, at_once=True)

    def _next(self) -> CampaignRecord | None:
        journal = self._journal
        waiting = records.campaigns(journal, "running", "paused", limit=1)
        waiting = waiting or records.campaigns(journal, "queued", limit=1)
        return waiting[0] if waiting else None

    async def _idle(self, monitor: asyncio.Task[None]) -> None:
        """Wait for a campaign; where others fire, keep what others fire meanwhile."""
        self.step_runner.doing = "idle"
        await self._outside.during(self.control.wait(monitor), None)

    def _recover_soon(self) -> None:
        self.step_runner.needs_recovery = True
        self.control.changed.set()

    async def _take_up(self, record: CampaignRecord, monitor: asyncio.Task[None]) -> None:
        """Begin a campaign, or go on with it, until it ends."""
        self.current, self.largest = record, None
        if record.state == "paused" or self.control.requested == "go":
            self.control.clear("pause" if record.state == "paused" else "go")
        try:
            self.plan = plan = await self.context.recorder.in_background(self._planner, record.toml)
            if plan.digest != record.digest and record.state != "paused":
                if self.policy.accept_changed_rig:
                    await self.files.accept(record, plan.digest)
                else:
                    await self._move(record, "paused", CHANGED_RIG)
                    self.control.clear("pause")
            await self.files.open(record, plan)
            if state_of(self._journal, record.id) == "queued":
                await self._move(record, "running", **outline(plan))
            await self._run_steps(record, plan, monitor)
            self.control.clear()
        except (JournalError, StorageUnavailable):
            raise  # of the whole daemon: what a person wants of the campaign holds when it is taken up again
        except (ConfigError, StorageError) as exc:
            await self._move(record, "failed", str(exc))
            self.control.clear()
        finally:
            self.current = self.plan = self.step = None

    async def _run_steps(self, record: CampaignRecord, plan: Plan, monitor: asyncio.Task[None]) -> None:
        known = records.steps(self._journal, record.id)
        ended = {index for index, kept in known.items() if kept.state != "running"}
        while True:
            step = next((step for step in plan.steps if step.index not in ended), None)
            match self.control.requested:
                case "abort":
                    await self._rest()
                    await self.queue.drain()
                    await self.files.close(record)
                    await self._move(record, "aborted", self.control.reason)
                    return
                case "pause":
                    await self._pause(record, monitor)
                case "go" if step is None:
                    if await self._finish(record, plan):
                        return
                case "go" if step is not None:
                    self.step = step
                    await self.step_runner.do(record.id, step, monitor)
                    if has_ended(self._journal, record.id, step.index):
                        ended.add(step.index)
                        if step.kind == "pause" and not step.hold_s:
                            self.control.request("pause", f"{step.label} waits for a person")

    async def _pause(self, record: CampaignRecord, monitor: asyncio.Task[None]) -> None:
        await self._rest()
        if self.control.requested == "pause" and state_of(self._journal, record.id) == "running":
            # It was not resumed meanwhile.
            await self._move(record, "paused", self.control.reason)
        self.step_runner.doing, self.step_runner.began_s = "paused", None
        while self.control.requested == "pause":
            await self._outside.during(self.control.wait(monitor), record.id)
        if self.control.requested == "go":
            await self.files.renew(record)

    async def _finish(self, record: CampaignRecord, plan: Plan) -> bool:
        """All steps have ended: wait for the last envelopes; False when somebody wants something else meanwhile."""
        await self._rest()
        try:
            await self.step_runner.recover(record.id, None)
        except LabdaemonError as exc:
            await self._fault(exc, "pause")
            self.control.request("pause", str(exc))
            return False
        self.step_runner.doing = "measuring"
        await self.queue.catch_up(record.id)
        await self.queue.drain()
        self.control.tripped = None  # by a last envelope, when the table rested already
        refused = await self.files.close(record)
        if refused is not None:
            await self._fault(refused, "pause")
            self.control.request("pause" if self.control.requested == "go" else self.control.requested, str(refused))
        if self.control.requested != "go":
            return False
        taken = sum(records.captures_by_step(self._journal, record.id).values())
        return await self._move(record, "completed", name=plan.name, steps=len(plan.steps), captures=taken)

    async def _rest(self) -> None:
        """Table to rest; if nothing confirms, that is told, and nothing moves until a person has resumed."""
        try:
            await self.step_runner.abort_to_rest()
        except InterlockError as exc:
            await self._fault(exc, "use the emergency stop")

    async def _stop_table(self) -> None:
        try:
            await self.step_runner.stop_table()
        except InterlockError as exc:
            await self._fault(exc, "use the emergency stop")

    def _on_published(self, campaign: str, name: str, rows: Rows) -> None:
        """An envelope is out: keep its largest motion for status, and judge it."""
        self.largest = largest_motion(rows)
        reason = check_envelope(self.limits, rows)
        if reason is None:
            return
        error = InterlockError(f"{name}: {reason}")
        if self.control.is_running_step or self.context.table.excitation is not None:
            self.trip(error)
            return
        if self.current is not None and self.control.requested == "go":
            self.control.request("pause", str(error))  # nor does a next campaign move it before a person has looked
        self._start(self._fault(error, "pause"))

    async def _fault(self, exc: LabdaemonError, action: str) -> None:
        campaign = self.current.id if self.current is not None else None
        await self.reporter.fault(exc, campaign=campaign, step=self.step, action=action)

    async def _move(self, record: CampaignRecord, state: CampaignState, reason: str | None = None, **data: Any) -> bool:
        moved = await self.reporter.move(record.id, state, reason, **data)
        if moved and self.current is not None and self.current.id == record.id:
            self.current = replace(self.current, state=state, reason=reason)
        return moved
