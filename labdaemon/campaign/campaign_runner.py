"""Runs one campaign from its first step to its last envelope, through pauses and what persons ask meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from labdaemon.campaign.external_listener import ExternalListener
from labdaemon.campaign.folder import CampaignFiles
from labdaemon.campaign.lookup import has_ended, outline, state_of
from labdaemon.campaign.measurement_queue import MeasurementQueue
from labdaemon.campaign.mode_search import StepChooser
from labdaemon.campaign.open_steps import group_sizes, with_decisions
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.retry import RetryingStepRunner
from labdaemon.campaign.run_control import RunControl
from labdaemon.campaign.steps import Plan, Step
from labdaemon.capture.context import AcquisitionContext
from labdaemon.errors import ConfigError, InterlockError, LabdaemonError, StorageError, StorageUnavailable
from labdaemon.events import CampaignData
from labdaemon.journal import records, transitions
from labdaemon.journal.decision_records import decisions_of
from labdaemon.journal.records import CampaignRecord, CampaignState
from labdaemon.journal.storage import JournalError

CHANGED_RIG = (
    "the rig file has changed since this campaign was planned; put it back, or resume with --accept-changed-rig"
)


@dataclass(slots=True)
class CampaignRunner:
    """Runs campaigns, one at a time.

    Attributes
    ----------
    planner
        A campaign's text to its plan; raises `ConfigError`.
    control
        What persons and interlocks ask meanwhile.
    files
        The campaigns' folders.
    step_runner
        Runs the steps.
    chooser
        Decides steps that the plan leaves open.
    listener
        Keeps what an outside system fires while the campaign is paused.
    accept_changed_rig
        Continue campaigns that were planned for another rig file.
    current, plan, step
        The campaign that is in progress, its plan and its step; None while idle.
    """

    context: AcquisitionContext
    queue: MeasurementQueue
    planner: Callable[[str], Plan]
    control: RunControl
    reporter: CampaignReporter
    files: CampaignFiles
    step_runner: RetryingStepRunner
    chooser: StepChooser
    listener: ExternalListener
    accept_changed_rig: bool
    current: CampaignRecord | None = None
    plan: Plan | None = None
    step: Step | None = None

    async def run(self, record: CampaignRecord, monitor: asyncio.Task[None]) -> None:
        """Begin or continue a campaign, until it ends."""
        self.current = record
        if record.state == "paused" or self.control.requested == "go":
            self.control.clear("pause" if record.state == "paused" else "go")
        try:
            self.plan = plan = await self.context.recorder.in_background(self.planner, record.toml)
            if plan.digest != record.digest and record.state != "paused":
                if self.accept_changed_rig:
                    await self.files.accept(record, plan.digest)
                else:
                    await self.move(record, "paused", CHANGED_RIG)
                    self.control.clear("pause")
            self.plan = plan = self._as_decided(record.id, plan)
            await self.files.open(record, plan)
            if state_of(self.context.recorder.journal, record.id) == "queued":
                await self.move(record, "running", data=outline(plan))
            await self._run_steps(record, plan, monitor)
            self.control.clear()
        except (JournalError, StorageUnavailable):
            raise  # of the whole daemon: what a person asked of the campaign holds when it is taken up again
        except (ConfigError, StorageError) as exc:
            await self.move(record, "failed", str(exc))
            self.control.clear()
        finally:
            self.current = self.plan = self.step = None

    async def _run_steps(self, record: CampaignRecord, plan: Plan, monitor: asyncio.Task[None]) -> None:
        known = records.steps(self.context.recorder.journal, record.id)
        ended = {index for index, kept in known.items() if kept.state != "running"}
        while True:
            step = next((step for step in plan.steps if step.index not in ended), None)
            match self.control.requested:
                case "abort":
                    await self.rest()
                    await self.queue.drain()
                    await self.files.close(record)
                    await self.move(record, "aborted", self.control.reason)
                    return
                case "pause":
                    await self._pause(record, monitor)
                case "go" if step is None:
                    if await self._finish(record, plan):
                        return
                case "go" if step is not None and step.is_open:
                    self.step = step
                    decide = partial(self.chooser.decide, record.id, plan, step)
                    await self.step_runner.decide(record.id, step, decide, monitor)
                    self.plan = plan = self._as_decided(record.id, plan)
                    self.queue.expect_groups(record.id, group_sizes(plan))
                    if has_ended(self.context.recorder.journal, record.id, step.index):  # skipped after a fault
                        ended.add(step.index)
                case "go" if step is not None:
                    self.step = step
                    await self.step_runner.run(record.id, step, monitor)
                    if has_ended(self.context.recorder.journal, record.id, step.index):
                        ended.add(step.index)
                        if step.kind == "pause" and not step.hold_s:
                            self.control.request("pause", f"{step.label} waits for a person")

    def _as_decided(self, campaign: str, plan: Plan) -> Plan:
        return with_decisions(plan, decisions_of(self.context.recorder.journal, campaign))

    async def _pause(self, record: CampaignRecord, monitor: asyncio.Task[None]) -> None:
        await self.rest()
        if self.control.requested == "pause" and state_of(self.context.recorder.journal, record.id) == "running":
            # It was not resumed meanwhile.
            await self.move(record, "paused", self.control.reason)
        self.step_runner.activity, self.step_runner.began_s = "paused", None
        while self.control.requested == "pause":
            await self.listener.listen_during(self.control.wait(monitor), record.id)
        if self.control.requested == "go":
            await self.files.renew(record)

    async def _finish(self, record: CampaignRecord, plan: Plan) -> bool:
        """All steps have ended: wait for the last envelopes; False when a person asks for something else meanwhile."""
        await self.rest()
        try:
            await self.step_runner.recover(record.id, None)
        except LabdaemonError as exc:
            await self.fault(exc, "pause")
            self.control.request("pause", str(exc))
            return False
        self.step_runner.activity = "measuring"
        await self.queue.enqueue_stored(record.id)
        await self.queue.drain()
        self.control.tripped = None  # by a last envelope, when the table rested already
        refused = await self.files.close(record)
        if refused is not None:
            await self.fault(refused, "pause")
            self.control.request("pause" if self.control.requested == "go" else self.control.requested, str(refused))
        if self.control.requested != "go":
            return False
        taken = sum(records.captures_by_step(self.context.recorder.journal, record.id).values())
        summary = CampaignData(name=plan.name, steps=len(plan.steps), captures=taken)
        return await self.move(record, "completed", data=summary)

    async def rest(self) -> None:
        """Table to rest; if nothing confirms, that is a fault, and nothing moves until a person has resumed."""
        try:
            await self.step_runner.abort_to_rest()
        except InterlockError as exc:
            await self.fault(exc, "use the emergency stop")

    async def fault(self, exc: LabdaemonError, action: str) -> None:
        """Report a fault, under the campaign and the step in progress."""
        campaign = self.current.id if self.current is not None else None
        await self.reporter.fault(exc, campaign=campaign, step=self.step, action=action)

    async def move(
        self,
        record: CampaignRecord,
        state: CampaignState,
        reason: str | None = None,
        data: CampaignData = transitions.NOTHING_MORE,
    ) -> bool:
        """Put a campaign into another state; False if it was in none that leads there."""
        moved = await self.reporter.move(record.id, state, reason, data)
        if moved and self.current is not None and self.current.id == record.id:
            self.current = replace(self.current, state=state, reason=reason)
        return moved
