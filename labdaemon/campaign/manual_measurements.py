"""Measures captures that belong to no campaign: their folder, their sharp set, their groups, their envelope."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine, Mapping, Sequence
from dataclasses import replace
from typing import Any

from labdaemon.campaign.folder import renew_folder
from labdaemon.campaign.measurement_queue import MeasurementQueue
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.paths import capture_folder, capture_toml
from labdaemon.durable import write_durably
from labdaemon.errors import LabdaemonError, UsageError
from labdaemon.journal import records, transitions
from labdaemon.journal.gauge_records import gauges_of
from labdaemon.journal.light_record import light_of
from labdaemon.journal.records import NO_STEP, CaptureRecord

GROUP_QUIET_S = 20.0
"""A manual group is complete when no member has come for so long, or a capture of another group has."""

log: logging.Logger = logging.getLogger(__name__)


class ManualMeasurements:
    """Has manual captures measured as a campaign's are, so that `labdaemon process` reproduces them.

    Parameters
    ----------
    context
        The rig and the journal.
    queue
        Where stored captures are measured.
    reporter
        Where faults are reported.
    folder_files
        Files that the folder starts with: ``rig.toml`` and the surveys.
    """

    def __init__(
        self,
        context: AcquisitionContext,
        queue: MeasurementQueue,
        reporter: CampaignReporter,
        folder_files: Mapping[str, str],
    ) -> None:
        self._context, self._queue, self._reporter = context, queue, reporter
        self._files = folder_files
        self._opened: set[str] = set()
        self._reported: set[str] = set()
        """Campaigns of which it was said that they lack a sharp set."""
        self._quiet: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self, campaign: str | None) -> str:
        """The campaign that captures go to, with a folder that can be processed; None for the manual one.

        Raises
        ------
        DataError
            The disk does not take it.
        """
        if campaign is not None:
            return campaign
        recorder = self._context.recorder
        id = await recorder.write(transitions.open_manual)
        if id not in self._opened:
            moved = await recorder.on_disk(renew_folder, self._context.data, id, self._files)
            await self._queue.resume(id, {})
            self._opened.add(id)
            if moved:
                log.warning(
                    "%s: the rig file or survey has changed; earlier captures were measured with %s, and `labdaemon "
                    "process` will measure them with the new ones",
                    id,
                    ", ".join(moved),
                )
        return id

    async def measure_pending(self, campaign: str | None) -> None:
        """Measure what an earlier run left stored, once a start or a pause; does nothing where there is none."""
        id = campaign or transitions.MANUAL
        journal = self._context.recorder.journal
        pending = [one for one in records.captures(journal, id, "stored", step=NO_STEP) if not one.is_sharp]
        if not pending:
            return
        await self.open(campaign)
        self._spawn(self._measure_all(pending))

    async def add(self, capture: CaptureRecord) -> None:
        """A capture is safe on disk: have it measured, or say once what is missing."""
        await self._queue.add_gauges(capture)
        for campaign, group in list(self._quiet):
            if campaign == capture.campaign and group != capture.grouped:
                self._close(campaign, group)
        if capture.is_sharp:
            self._spawn(self._measure_earlier(capture))
        elif capture.grouped is not None:
            self._wait_for_more(capture.campaign, capture.grouped)
        else:
            await self._measure([capture])

    def sharp_of(self, campaign: str, group: str | None) -> str | None:
        """The sharp set that a new capture is measured against: its group's, else the newest; None for the flat one."""
        journal = self._context.recorder.journal
        members = records.group_members(journal, campaign, group) if group is not None else []
        newest = records.latest_sharp(journal, campaign)
        return members[0].sharp if members else newest.sharp if newest is not None else None

    async def finish(self) -> None:
        """Wait for what is being handed to the measuring queue; groups that wait for members stay as they are."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))

    async def close(self) -> None:
        """Forget what waits; the journal still has it as stored."""
        tasks = [*self._quiet.values(), *self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _measure(self, members: Sequence[CaptureRecord], *, again: bool = False) -> None:
        campaign = members[-1].campaign
        if records.latest_sharp(self._context.recorder.journal, campaign) is None:
            await self._report_no_sharp(campaign)
            return
        await self._queue.add_group(members, again=again)

    async def _report_no_sharp(self, campaign: str) -> None:
        """Once, not for every capture of a night: they are kept, and measured as soon as there is a sharp set."""
        if campaign in self._reported:
            return
        self._reported.add(campaign)
        then = " and release the shutters once" if self._context.rig.trigger is None else ""
        exc = UsageError(
            f"captures of {campaign} have no sharp set to be measured against: with the structure at rest run "
            f"`labdaemon capture --sharp`{then}; those that are stored are measured then"
        )
        await self._reporter.fault(exc, campaign=campaign, step=None, action="kept until there is a sharp set")

    async def _measure_earlier(self, sharp: CaptureRecord) -> None:
        """Measure captures that came before there was any sharp set against the first one."""
        self._reported.discard(sharp.campaign)
        recorder = self._context.recorder
        pending = [
            replace(one, sharp=sharp.sharp)
            for one in records.captures(recorder.journal, sharp.campaign, "stored", step=NO_STEP)
            if not one.is_sharp and one.sharp is None
        ]
        for one in pending:
            await recorder.write(transitions.describe_capture, one)
            light = light_of(recorder.journal, one.campaign, one.name)
            gauges = gauges_of(recorder.journal, one.campaign, one.name)
            text = capture_toml(one, light, gauges)
            await recorder.on_disk(write_durably, capture_folder(self._context.data, one) / "capture.toml", text)
        await self._measure_all(pending)

    async def _measure_all(self, pending: Sequence[CaptureRecord]) -> None:
        if pending and records.latest_sharp(self._context.recorder.journal, pending[0].campaign) is None:
            await self._report_no_sharp(pending[0].campaign)
            return
        for one in pending:
            if one.grouped is None:
                await self._measure([one])
        for campaign, group in {(one.campaign, one.grouped) for one in pending if one.grouped is not None}:
            self._wait_for_more(campaign, group)

    def _wait_for_more(self, campaign: str, group: str) -> None:
        """Begin the quiet time of a group anew."""
        key = (campaign, group)
        if key in self._quiet:
            self._quiet[key].cancel()
        self._quiet[key] = task = asyncio.create_task(self._context.clock.sleep(GROUP_QUIET_S))

        def when_quiet(done: asyncio.Task[None]) -> None:
            if self._quiet.get(key) is done and not done.cancelled():
                self._close(campaign, group)

        task.add_done_callback(when_quiet)

    def _close(self, campaign: str, group: str) -> None:
        self._quiet.pop((campaign, group)).cancel()
        self._spawn(self._measure_group(campaign, group))

    async def _measure_group(self, campaign: str, group: str) -> None:
        members = records.group_members(self._context.recorder.journal, campaign, group)
        if members:
            await self._measure(members, again=True)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            # The journal still has the captures as stored: the next start, or the next pause, takes them up again.
            known = isinstance(error, LabdaemonError)
            log.error("manual captures were not measured: %s", error, exc_info=None if known else error)
