"""Runs campaigns unattended: one at a time, step by step, through faults, pauses, interlocks and restarts."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from typing import Any

from labdaemon.campaign.campaign_runner import CHANGED_RIG, CampaignRunner
from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.enable_line import EnableLine
from labdaemon.campaign.external_listener import ExternalListener
from labdaemon.campaign.folder import CampaignFiles
from labdaemon.campaign.interlock_monitor import InterlockMonitor
from labdaemon.campaign.interlocks import InterlockLimits, check_envelope
from labdaemon.campaign.lookup import named_campaign, outline, state_of
from labdaemon.campaign.manual import ManualCaptures
from labdaemon.campaign.manual_measurements import ManualMeasurements
from labdaemon.campaign.manual_request import ManualRequest
from labdaemon.campaign.measurement_queue import MeasurementQueue, Rows
from labdaemon.campaign.mode_search import StepChooser
from labdaemon.campaign.reporter import RECORD_S, CampaignReporter
from labdaemon.campaign.retry import RetryingStepRunner, RetryPolicy
from labdaemon.campaign.run_control import RunControl
from labdaemon.campaign.steps import Plan, Step
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.table_stop import RestConfirmation
from labdaemon.errors import InterlockError, LabdaemonError, StorageError, StorageUnavailable
from labdaemon.journal import queue_order, records, transitions
from labdaemon.journal.records import CampaignRecord, CaptureRecord
from labdaemon.orbit_size import LargestMotion, largest_motion
from labdaemon.stream.messages import BusyError, CommandError, WrongStateError

log: logging.Logger = logging.getLogger(__name__)


class Engine:
    """Runs campaigns, and does what commands ask.

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
    runner
        Runs the campaign that is in progress.
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
        self.context: AcquisitionContext = context
        self.queue: MeasurementQueue = queue
        self.limits: InterlockLimits = limits
        policy = policy or RetryPolicy()
        self.policy: RetryPolicy = policy
        self._journal = context.recorder.journal
        self.control: RunControl = RunControl()
        self.disk: DataDisk = DataDisk(context.recorder, free_bytes, limits.min_disk_bytes)
        self.reporter: CampaignReporter = CampaignReporter(context.recorder, context.clock, self.disk)
        self.files: CampaignFiles = CampaignFiles(context.recorder, context.data, queue, self.reporter, folder_files)
        self.step_runner: RetryingStepRunner = RetryingStepRunner(context, queue, self.control, self.reporter, policy)
        self.monitor: InterlockMonitor = InterlockMonitor(
            context, limits, self, self.disk, queue, self.control, intervals=policy.intervals
        )
        self.enable_line: EnableLine = self.step_runner.enable_line
        manual = ManualMeasurements(context, queue, self.reporter, folder_files)
        self.manual: ManualCaptures = ManualCaptures(context, manual, self.reporter, policy.window_s, self.step_runner)
        self._listener = ExternalListener(context, self.manual, self.step_runner, self.reporter, policy)
        self.runner: CampaignRunner = CampaignRunner(
            context,
            queue,
            planner,
            self.control,
            self.reporter,
            self.files,
            self.step_runner,
            StepChooser(context.recorder, queue),
            self._listener,
            policy.accept_changed_rig,
        )
        queue.observer = self
        self._stops: set[asyncio.Task[None]] = set()
        self.largest: LargestMotion | None = None

    @property
    def current(self) -> CampaignRecord | None:
        """The campaign in progress; None while idle."""
        return self.runner.current

    @property
    def plan(self) -> Plan | None:
        """The plan of the campaign in progress."""
        return self.runner.plan

    @property
    def step(self) -> Step | None:
        """The step in progress, or the one that ended last."""
        return self.runner.step

    async def run(self) -> None:
        """Run campaigns until cancelled. The table must be at rest."""
        monitor = asyncio.create_task(self.monitor.run())
        try:
            self._start(self.queue.rebuild_incomplete())
            while True:
                try:
                    await self._do_next(monitor)
                except StorageUnavailable as exc:  # a read or write that nothing nearer has waited with
                    await self.runner.rest()
                    await self.reporter.wait_for_disk(exc)
        finally:
            monitor.cancel()
            with suppress(asyncio.CancelledError):  # that is what was asked of it
                await monitor

    async def _do_next(self, monitor: asyncio.Task[None]) -> None:
        self.control.changed.clear()
        record = self._next()
        if record is not None:
            self.largest = None
            await self.runner.run(record, monitor)
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
        self._start(self.runner.fault(error, action))

    async def submit(self, plan: Plan, request_id: str | None = None) -> str:
        """Queue a checked campaign; its id, once it is in the journal.

        Raises
        ------
        WrongStateError
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
        NotFoundError, WrongStateError
            There is no such campaign, or it is not running.
        """
        record = named_campaign(self._journal, campaign, self.current, "running")
        self.control.request("pause", reason)
        if not await self.runner.move(record, "paused", reason):
            raise WrongStateError(f"campaign {record.id} has just ended")
        return record.id

    async def resume(self, campaign: str | None = None, *, accept_changed_rig: bool = False) -> str:
        """Continue a paused campaign; its id.

        Raises
        ------
        NotFoundError, WrongStateError
            There is no such campaign, it is not paused, or it was planned for another rig.
        """
        record = named_campaign(self._journal, campaign, self.current, "paused")
        plan = await self.context.recorder.in_background(self.runner.planner, record.toml)
        if plan.digest != record.digest:
            if not accept_changed_rig:
                raise WrongStateError(f"{record.id}: {CHANGED_RIG}")
            await self.files.accept(record, plan.digest)
        if not await self.runner.move(record, "running", data=outline(plan)):
            raise WrongStateError(f"campaign {record.id} has just ended")
        self.control.clear()
        return record.id

    async def abort(self, campaign: str | None = None, reason: str = "asked for") -> str:
        """End a campaign for good, running, paused or queued; its id.

        Raises
        ------
        NotFoundError, WrongStateError
            There is no such campaign, or it has ended.
        """
        record = named_campaign(self._journal, campaign, self.current, "running", "paused", "queued")
        if self.current is None or record.id != self.current.id:
            await self.runner.move(record, "aborted", reason)
        else:
            self.control.request("abort", reason)
        return record.id

    async def capture(self, request: ManualRequest) -> CaptureRecord:
        """Fire once, as the rig is; for a paused campaign, or for none.

        Raises
        ------
        BusyError
            A campaign is running.
        DeviceError
            Trigger or cameras refused.
        """
        if self.current is not None and state_of(self._journal, self.current.id) != "paused":
            raise BusyError(f"campaign {self.current.id} is running; pause it first")
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
        await self.runner.move(record, "paused", reason)
        self.control.request("pause", reason, at_once=True)

    def _next(self) -> CampaignRecord | None:
        journal = self._journal
        waiting = records.campaigns(journal, "running", "paused", limit=1)
        if waiting:
            return waiting[0]
        queue = queue_order.queued(journal)
        return records.campaign(journal, queue[0]) if queue else None

    async def _idle(self, monitor: asyncio.Task[None]) -> None:
        """Wait for a campaign; where others fire, keep what others fire meanwhile."""
        self.step_runner.activity = "idle"
        await self._listener.listen_during(self.control.wait(monitor), None)

    async def _stop_table(self) -> None:
        try:
            await self.step_runner.stop_table()
        except InterlockError as exc:
            await self.runner.fault(exc, "use the emergency stop")

    async def wait_for_disk(self, exc: StorageUnavailable) -> None:
        """A result cannot be written now: report it once, and wait until the disk takes writes."""
        await self.reporter.wait_for_disk(exc)

    def result_published(self, campaign: str, name: str, rows: Rows) -> None:
        """An envelope is out: keep its largest motion for status, and judge it."""
        self.largest = largest_motion(rows)
        violation = check_envelope(self.limits, rows)
        if violation is None:
            return
        error = InterlockError(f"{name}: {violation}")
        if self.control.is_running_step or self.context.table.excitation is not None:
            self.trip(error)
            return
        if self.current is not None and self.control.requested == "go":
            self.control.request("pause", str(error))  # nor does a next campaign move it before a person has looked
        self._start(self.runner.fault(error, "pause"))
