"""Walks campaigns unattended: one at a time, step by step, through faults, pauses, interlocks and restarts.

There is one way out of every interruption, a fault, a pause, an interlock or kill -9 alike: bring the table to rest,
let `labdaemon.capture.recover` settle what was in flight, and walk on from what the journal says.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

from labdaemon.campaign.folder import prepare_folder
from labdaemon.campaign.guard import Guard
from labdaemon.campaign.interlocks import Limits, envelope_reason
from labdaemon.campaign.manual import Manual
from labdaemon.campaign.measuring import Measuring, Rows
from labdaemon.campaign.steps import Plan, Step
from labdaemon.campaign.walk import Walker
from labdaemon.campaign.windows import POLL_S, wait_s
from labdaemon.capture.capture import Lab
from labdaemon.capture.recover import reconnect_lost, recover
from labdaemon.capture.rig import Rest
from labdaemon.errors import ConfigError, DeviceError, InterlockError, LabdaemonError
from labdaemon.journal import records, transitions
from labdaemon.journal.records import CampaignRecord, CaptureRecord
from labdaemon.journal.storage import StorageFull
from labdaemon.stream.messages import Busy, NotFound, WrongState

log = logging.getLogger(__name__)

MAX_TRIES = 4
BACKOFF_S = 2.0
MAX_BACKOFF_S = 60.0
DISK_POLL_S = 5.0
SEE_TO_END_S = 120.0
"""A capture whose shutters have opened is seen to its end before a pause, but no longer than this."""

Wish = Literal["go", "pause", "abort"]


@dataclass(frozen=True, slots=True)
class Policy:
    """How patient the engine is.

    Attributes
    ----------
    max_tries
        Attempts at a step under ``on_fault = "retry"`` before the campaign is paused.
    backoff_s
        Wait before the second attempt; doubled for each further one, up to a minute.
    accept_changed_rig
        Go on with campaigns that were planned for another rig file.
    """

    max_tries: int = MAX_TRIES
    backoff_s: float = BACKOFF_S
    accept_changed_rig: bool = False


class _Interrupted(Exception):
    """The step was left because somebody wanted the campaign paused or aborted."""


class Engine:
    """Walks campaigns.

    Parameters
    ----------
    lab
        The rig and the journal.
    measuring
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
    """

    def __init__(
        self,
        lab: Lab,
        measuring: Measuring,
        planner: Callable[[str], Plan],
        limits: Limits,
        *,
        folder_files: Mapping[str, str],
        free_bytes: Callable[[], int],
        policy: Policy = Policy(),
        window_s: float = 5.0,
    ) -> None:
        self.lab, self.measuring, self.limits, self.policy = lab, measuring, limits, policy
        self._planner, self._folder_files, self._free_bytes = planner, folder_files, free_bytes
        self._window_s = window_s
        self.guard = Guard(
            lab,
            limits,
            self.trip,
            free_bytes=free_bytes,
            oldest_s=measuring.oldest_s,
            busy=lambda: self._fired is not None,
        )
        self.manual = Manual(lab, measuring)
        measuring.published = self._on_published
        self._news = asyncio.Event()
        self._wish: Wish = "go"
        self._wish_reason: str | None = None
        self._tripped: str | None = None
        self._hard = False
        self._fired: CaptureRecord | None = None
        self._walking: asyncio.Task[None] | None = None
        self._stops: set[asyncio.Task[None]] = set()
        self._needs_recovery = True
        self.current: CampaignRecord | None = None
        self.plan: Plan | None = None
        self.step: Step | None = None
        self.doing = "starting"
        """What it is doing, in a word or two, for status."""
        self.faults = 0
        self.last_fault: str | None = None
        self.largest_mm: float | None = None

    async def run(self) -> None:
        """Walk campaigns until cancelled. The table must be at rest."""
        guard = asyncio.create_task(self.guard.run())
        try:
            await self._work(guard)
        finally:
            guard.cancel()
            with suppress(asyncio.CancelledError):
                await guard

    def trip(self, reason: str) -> None:
        """Interlock: stop the table at once; what is under way is left, and the campaign's `on_fault` decides."""
        if self._tripped is not None or (self.lab.table.excitation is None and self._walking is None):
            return
        self._tripped, self._hard = reason, True
        log.error("interlock: %s", reason)
        self._stop_soon()
        if self._walking is not None:
            self._walking.cancel()

    def submit(self, plan: Plan, request_id: str | None = None) -> asyncio.Future[str]:
        """Queue a checked campaign; its id, once it is in the journal."""
        return asyncio.ensure_future(self._submit(plan, request_id))

    async def pause(self, campaign: str | None = None, reason: str = "asked for") -> str:
        """Bring the table to rest and wait for `resume`; the campaign's id.

        Raises
        ------
        WrongState
            The campaign is not running.
        """
        record = self._named(campaign, "running")
        await self._move(record, "paused", reason)
        self._want("pause", reason)
        return record.id

    async def resume(self, campaign: str | None = None, *, accept_changed_rig: bool = False) -> str:
        """Go on with a paused campaign; its id.

        Raises
        ------
        WrongState
            It is not paused, or was planned for another rig.
        """
        record = self._named(campaign, "paused")
        plan = self._planner(record.toml)
        if plan.digest != record.digest:
            if not accept_changed_rig:
                raise WrongState(f"{record.id}: {CHANGED_RIG}")
            await self.lab.recorder.write(transitions.accept_digest, record.id, plan.digest)
        await self._move(record, "running")
        self._wish, self._wish_reason = "go", None
        self._news.set()
        return record.id

    async def abort(self, campaign: str | None = None, reason: str = "asked for") -> str:
        """End a campaign for good, running, paused or queued; its id."""
        record = self._named(campaign, "running", "paused", "queued")
        if self.current is None or record.id != self.current.id:
            await self._move(record, "aborted", reason)
            return record.id
        self._want("abort", reason)
        return record.id

    async def capture(self, label: str, *, is_sharp: bool = False, request_id: str | None = None) -> CaptureRecord:
        """Fire once, as the rig is; for a paused campaign, or for none.

        Raises
        ------
        Busy
            A campaign is running.
        """
        if self.current is not None and self._state(self.current.id) != "paused":
            raise Busy(f"campaign {self.current.id} is running; pause it first")
        if self._needs_recovery:
            await self._settle_down()
        campaign = self.current.id if self.current is not None else None
        try:
            return await self.manual.capture(label, campaign=campaign, is_sharp=is_sharp, request_id=request_id)
        except LabdaemonError:
            self._needs_recovery = True
            raise

    async def stop(self) -> Rest:
        """Shaker to rest now, in every state; a running campaign is paused.

        Raises
        ------
        InterlockError
            Nothing confirmed.
        """
        self._hard = True
        running = self.current is not None and self._wish == "go" and self._state(self.current.id) == "running"
        if running:
            self._wish, self._wish_reason = "pause", "stopped by a person"
        if self._walking is not None:
            self._walking.cancel()
        try:
            return await self.lab.table.stop()
        finally:
            if running and self.current is not None:
                await self._move(self.current, "paused", "stopped by a person")

    async def _submit(self, plan: Plan, request_id: str | None) -> str:
        id = await self.lab.recorder.write(transitions.submit, plan.name, plan.toml, plan.digest, request_id)
        self._news.set()
        return id

    async def _work(self, guard: asyncio.Task[None]) -> None:
        while True:
            self._news.clear()
            if self._needs_recovery:
                await self._settle_down()
            record = self._next()
            if record is None:
                self.doing = "idle"
                await self._idle(guard)
            else:
                await self._take_up(record, guard)

    def _next(self) -> CampaignRecord | None:
        journal = self.lab.recorder.journal
        return next(iter(records.campaigns(journal, "running", "paused") or records.campaigns(journal, "queued")), None)

    async def _idle(self, guard: asyncio.Task[None]) -> None:
        news = asyncio.create_task(self._news.wait())
        waiting: set[asyncio.Task[Any]] = {news, guard}
        if self.lab.rig.trigger is None:
            waiting.add(asyncio.create_task(self.manual.listen(self._window_s)))
        try:
            done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                if task.exception() is not None:
                    await self._fault(task.exception(), None, action="listen again")
                    await self.lab.clock.sleep(self.policy.backoff_s)
                    self._needs_recovery = True
        finally:
            for task in waiting - {guard}:
                task.cancel()
                with suppress(asyncio.CancelledError, LabdaemonError):
                    await task

    async def _take_up(self, record: CampaignRecord, guard: asyncio.Task[None]) -> None:
        """Begin a campaign, or go on with it, until it ends."""
        self.current, self._tripped, self._hard = record, None, False
        self._wish = "pause" if record.state == "paused" else "go"
        self.largest_mm = None
        try:
            try:
                plan = self._planner(record.toml)
            except ConfigError as exc:
                await self._move(record, "failed", str(exc))
                return
            if plan.digest != record.digest and record.state != "paused":
                if not self.policy.accept_changed_rig:
                    await self._move(record, "paused", CHANGED_RIG)
                    self._wish = "pause"
                else:
                    await self.lab.recorder.write(transitions.accept_digest, record.id, plan.digest)
            self.plan = plan
            await self._when_there_is_room(lambda: self._begin(record, plan))
            if self._state(record.id) == "queued":
                told: dict[str, Any] = {
                    "name": plan.name,
                    "steps": len(plan.steps),
                    "predicted_s": plan.predicted_s,
                }
                await self._move(record, "running", **told)
            await self._walk(record, plan, guard)
        finally:
            self.current = self.plan = self.step = None

    async def _begin(self, record: CampaignRecord, plan: Plan) -> None:
        files = {**self._folder_files, "campaign.toml": record.toml}
        prepare_folder(self.lab.data, record.id, files)
        sizes = {step.label: len(step.shots) for step in plan.steps if step.grouped}
        await self.measuring.resume(record.id, sizes)

    async def _walk(self, record: CampaignRecord, plan: Plan, guard: asyncio.Task[None]) -> None:
        while True:
            if self._wish == "abort":
                await self._leave()
                await self.measuring.drain()
                await self._move(record, "aborted", self._wish_reason)
                return
            if self._wish == "pause":
                await self._leave()
                self.doing = "paused"
                await self._news_or(guard)
                continue
            ended = {
                step
                for step, kept in records.steps(self.lab.recorder.journal, record.id).items()
                if kept.state != "running"
            }
            step = next((step for step in plan.steps if step.index not in ended), None)
            if step is None:
                self.doing = "measuring"
                await self.lab.table.stop()
                await self.measuring.drain()
                if self._wish == "go" and self._tripped is None:
                    await self._complete(record, plan)
                    return
                self._on_late_trip()
                continue
            self.step = step
            await self._do(record, step, guard)

    async def _complete(self, record: CampaignRecord, plan: Plan) -> None:
        taken = records.captures(self.lab.recorder.journal, record.id, "stored", "measured", "unmeasured")
        await self._move(record, "completed", name=plan.name, steps=len(plan.steps), captures=len(taken))

    def _on_late_trip(self) -> None:
        """An interlock that tripped on a last envelope: the table rests already, so the campaign may end."""
        self._tripped = None

    async def _do(self, record: CampaignRecord, step: Step, guard: asyncio.Task[None]) -> None:
        """One step through all its attempts, to its end or to a wish."""
        attempt = 0
        while self._wish == "go":
            attempt += 1
            try:
                if self._needs_recovery:
                    await self._settle_down()
                await self._attempt(record, step, guard)
            except _Interrupted:
                return
            except StorageFull as exc:
                attempt -= 1
                await self._leave()
                await self._fault(exc, step, action="wait for room")
                await self._wait_for_room()
            except LabdaemonError as exc:
                if await self._decide(record, step, exc, attempt):
                    return
            else:
                if step.kind == "pause" and not step.hold_s:
                    await self._move(record, "paused", f"step {step.label} waits for a person")
                    self._wish = "pause"
                return

    async def _attempt(self, record: CampaignRecord, step: Step, guard: asyncio.Task[None]) -> None:
        """Walk a step once, as a task of its own that wishes and interlocks can cancel."""
        await self._wait_for_window(step)
        self.doing = step.kind
        write = self.lab.recorder.write
        told = {"label": step.label, "kind": step.kind}
        excitation = {"frequency_hz": step.frequency_hz, "amplitude_mm": step.amplitude_mm}
        await write(transitions.start_step, record.id, step.index, {**told, **excitation})
        self._hard, self._fired, self._tripped = False, None, None
        self._walking = asyncio.create_task(self._walker(record.id).walk(step))
        try:
            await asyncio.wait({self._walking, guard}, return_when=asyncio.FIRST_COMPLETED)
            if not self._walking.done():
                self._walking.cancel()
                await asyncio.wait({self._walking})
                guard.result()
            if self._walking.cancelled():
                self._needs_recovery = True
                if self._tripped is not None:
                    raise InterlockError(self._tripped)
                raise _Interrupted
            self._walking.result()
            if self._tripped is not None:
                raise InterlockError(self._tripped)
        finally:
            if not self._walking.done():
                self._walking.cancel()
                await asyncio.wait({self._walking})
            self._walking = self._fired = None
        await write(transitions.end_step, record.id, step.index, told)

    async def _decide(self, record: CampaignRecord, step: Step, exc: LabdaemonError, attempt: int) -> bool:
        """What a fault means for the step; True when the step has ended or the campaign waits."""
        on_fault = step.on_fault
        if on_fault == "retry" and (isinstance(exc, InterlockError) or attempt >= self.policy.max_tries):
            on_fault = "pause"
        try:
            await self._leave()
        except InterlockError as worse:
            await self._fault(worse, step, action="pause")
            on_fault = "pause"
        await self._fault(exc, step, action=on_fault)
        self._tripped = None
        match on_fault:
            case "retry":
                await self.lab.clock.sleep(min(self.policy.backoff_s * 2.0 ** (attempt - 1), MAX_BACKOFF_S))
                return False
            case "skip":
                told = {"label": step.label, "kind": step.kind}
                await self.lab.recorder.write(transitions.end_step, record.id, step.index, told, str(exc))
            case "pause":
                if self._wish == "go":
                    await self._move(record, "paused", str(exc))
                    self._wish = "pause"
            case "abort":
                self._wish, self._wish_reason = "abort", str(exc)
        return True

    async def _settle_down(self) -> None:
        """After an interruption: reach the cameras again, and complete or give up what was in flight."""
        self.doing = "recovering"
        trial = 0
        while True:
            trial += 1
            try:
                if trial > 1:
                    await reconnect_lost(self.lab)
                for capture in await recover(self.lab):
                    await self.measuring.add(capture)
            except StorageFull:
                await self._wait_for_room()
            except DeviceError as exc:
                await self._fault(exc, self.step, action="try again")
                await self.lab.clock.sleep(min(self.policy.backoff_s * 2.0 ** (trial - 1), MAX_BACKOFF_S))
                if trial >= self.policy.max_tries and self.current is not None:
                    raise
            else:
                self._needs_recovery = False
                return

    async def _leave(self) -> None:
        """Table to rest before anything else; whatever was in flight is recovered before the next step."""
        self._needs_recovery = True
        await self.lab.table.stop()

    def _want(self, wish: Wish, reason: str) -> None:
        self._wish, self._wish_reason = wish, reason
        self._news.set()
        if self._walking is not None and self._fired is None:
            self._walking.cancel()

    def _on_fired(self, capture: CaptureRecord) -> None:
        self._fired = capture

    def _on_capture_ended(self) -> None:
        """A capture was seen to its end; if somebody has been waiting for that, leave the step now."""
        self._fired = None
        if self._wish != "go" and self._walking is not None:
            self._walking.cancel()

    def _on_published(self, campaign: str, name: str, rows: Rows) -> None:
        """An envelope is out: keep its largest amplitude for status, and judge it."""
        sizes = [
            sum(float(row[f"a{axis}_mm"]) ** 2 for axis in "xyz") ** 0.5
            for row in rows
            if all(row.get(f"a{axis}_mm") is not None for axis in "xyz")
        ]
        if sizes:
            self.largest_mm = max(sizes)
        reason = envelope_reason(self.limits, rows)
        if reason is not None:
            self.trip(f"{name}: {reason}")

    def _walker(self, campaign: str) -> Walker:
        return Walker(
            self.lab, campaign, self.measuring.add, self._on_fired, self._on_capture_ended, window_s=self._window_s
        )

    def _stop_soon(self) -> None:
        async def stop() -> None:
            try:
                await self.lab.table.stop()
            except InterlockError as exc:
                await self._fault(exc, self.step, action="use the emergency stop")

        task = asyncio.create_task(stop())
        self._stops.add(task)
        task.add_done_callback(self._stops.discard)

    async def _wait_for_window(self, step: Step) -> None:
        while True:
            left_s = wait_s(self.lab.clock.now().astimezone(), step.not_before, step.not_after)
            if left_s <= 0.0:
                return
            self.doing = f"waiting until {step.not_before or 'midnight'}"
            await self.lab.table.stop()
            with suppress(TimeoutError):
                async with asyncio.timeout(min(left_s, POLL_S)):
                    await self._news.wait()
            self._news.clear()
            if self._wish != "go":
                raise _Interrupted

    async def _wait_for_room(self) -> None:
        self.doing = "waiting for disk space"
        while self._free_bytes() < self.limits.min_disk_bytes and self._wish == "go":
            await self.lab.clock.sleep(DISK_POLL_S)
        await self.lab.clock.sleep(DISK_POLL_S)

    async def _when_there_is_room(self, work: Callable[[], Any]) -> None:
        while True:
            try:
                await work()
            except StorageFull as exc:
                await self._fault(exc, None, action="wait for room")
                await self._wait_for_room()
            else:
                return

    async def _news_or(self, guard: asyncio.Task[None]) -> None:
        news = asyncio.create_task(self._news.wait())
        await asyncio.wait({news, guard}, return_when=asyncio.FIRST_COMPLETED)
        news.cancel()
        if guard.done():
            guard.result()
        self._news.clear()

    async def _fault(self, exc: BaseException | None, step: Step | None, *, action: str) -> None:
        self.faults += 1
        self.last_fault = str(exc)
        log.warning("fault: %s (%s)", exc, action)
        told = {
            "device": getattr(exc, "device", None),
            "error": type(exc).__name__,
            "message": str(exc),
            "step": step.index if step is not None else None,
            "action": action,
        }
        campaign = self.current.id if self.current is not None else None
        with suppress(StorageFull):  # the disk has no room for the news either; the log has them
            await self.lab.recorder.write(transitions.fault, campaign, told)

    async def _move(self, record: CampaignRecord, state: Any, reason: str | None = None, **data: Any) -> None:
        await self._when_there_is_room(
            lambda: self.lab.recorder.write(transitions.move_campaign, record.id, state, reason, **data)
        )
        if self.current is not None and self.current.id == record.id:
            self.current = replace(self.current, state=state, reason=reason)

    def _state(self, campaign: str) -> str | None:
        record = records.campaign(self.lab.recorder.journal, campaign)
        return record.state if record is not None else None

    def _named(self, campaign: str | None, *states: records.CampaignState) -> CampaignRecord:
        """The campaign that a command is about."""
        id = campaign if campaign is not None else (self.current.id if self.current is not None else None)
        if id is None:
            raise NotFound("no campaign is under way; submit one")
        record = records.campaign(self.lab.recorder.journal, id)
        if record is None:
            raise NotFound(f"no campaign {id!r}")
        if record.state not in states:
            raise WrongState(f"campaign {id} is {record.state}, not {' or '.join(states)}")
        return record


CHANGED_RIG = (
    "the rig file has changed since this campaign was planned; put it back, or resume with --accept-changed-rig"
)
