"""The queue between stored captures and published envelopes, measured while the engine captures on.

At most `depth` captures wait or are measured at a time: beyond that the engine, and with it the table, waits. Nothing
is dropped, so a crash at any point leaves in the journal exactly the captures that are still to be measured.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from labdaemon.capture.discard import discard_stored
from labdaemon.capture.paths import campaign_folder
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import Clock, parse_rfc3339
from labdaemon.errors import LabdaemonError, SetupError, StorageError, StorageUnavailable
from labdaemon.events import EnvelopeData, FaultData, TargetRow
from labdaemon.journal import records, transitions
from labdaemon.journal.gauge_records import gauges_in, gauges_of
from labdaemon.journal.gauge_table import FILE_NAME, GaugeFiles
from labdaemon.journal.records import NO_STEP, CaptureRecord

Rows = list[dict[str, Any]]

log: logging.Logger = logging.getLogger(__name__)

RESULTS = "results"
TRIES = 2  # a worker that was killed for its memory may have been the victim of another process
DISK_POLL_S = 5.0  # where no engine reports it


@dataclass(frozen=True, slots=True)
class CaptureRows:
    """Rows of `envelope.csv` and of `measurements.csv`."""

    envelope: Rows
    measurements: Rows


class CaptureMeasurer(Protocol):
    """Turns stored frames into an envelope, off the event loop."""

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> CaptureRows:
        """Measure captures of a data-set folder jointly, under `name`.

        Raises
        ------
        LabdaemonError
            It cannot be measured; trying again helps only if it says so.
        """
        ...

    async def check_frames(self, folder: Path, frames: Sequence[tuple[str, Path]]) -> None:
        """Look at the first frames, camera and file of each, of a campaign.

        Raises
        ------
        SetupError
            One has another size than the rig file says.
        """
        ...

    def write_results(self, folder: Path, results: Iterable[CaptureRows]) -> None:
        """Write the folder's result files anew from everything measured so far, which may be more than fits memory.

        This and the following block, and are called off the event loop.
        """
        ...

    def append_results(self, folder: Path, result: CaptureRows) -> bool:
        """Add to the folder's result files, synced; False where they must be written anew."""
        ...

    def lacks(self, folder: Path, names: set[str], kept: str | None) -> bool:
        """Whether the result files have another stamp than the one kept, and lack one of these results."""
        ...

    def stamp(self, folder: Path) -> str:
        """What the result files' state is known by later."""
        ...


class ResultObserver(Protocol):
    """Follows the results of a `MeasurementQueue`."""

    def result_published(self, campaign: str, name: str, rows: Rows) -> None:
        """The envelope of this capture or group is in the journal; called on the event loop."""
        ...

    async def wait_for_disk(self, exc: StorageUnavailable) -> None:
        """Wait, as long as need be, until the disk takes writes again."""
        ...


class MeasurementQueue:
    """Measures stored captures in the background and publishes their envelopes.

    Parameters
    ----------
    recorder
        The journal.
    measurer
        Does the work.
    depth
        Captures (or groups) that are queued or measured at a time.
    """

    def __init__(
        self,
        recorder: Recorder,
        measurer: CaptureMeasurer,
        clock: Clock,
        data: Path,
        *,
        depth: int = 4,
    ) -> None:
        self._recorder, self._measurer, self._clock, self._data = recorder, measurer, clock, data
        self._slots = asyncio.Semaphore(depth)
        self.observer: ResultObserver | None = None
        """Learns of each result, and reports a disk that refuses one."""
        self._tasks: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._since: dict[tuple[str, str], float] = {}
        self._group_sizes: dict[str, Mapping[str, int]] = {}
        self._writing = asyncio.Lock()
        self._broken: BaseException | None = None
        self._start: asyncio.Task[None] | None = None
        self._checked: set[str] = set()
        """Campaigns whose first frames were looked at."""
        self._reported: set[tuple[str, str]] = set()
        """Campaign and message of what manual captures could not be measured for."""
        self._gauge_files = GaugeFiles()

    @property
    def waiting(self) -> int:
        """Captures or groups that are queued or measured."""
        return len(self._tasks)

    def oldest_s(self) -> float:
        """How long the oldest of them has waited, seconds."""
        return max((self._clock.monotonic() - since for since in self._since.values()), default=0.0)

    async def add(self, capture: CaptureRecord) -> None:
        """Measure a stored capture, or its group once all members are stored; waits while the queue is full.

        Raises what broke an earlier measurement in a way that is not foreseen.

        Raises
        ------
        SetupError
            The campaign's first frames are not what the rig file says: none of its captures could be measured.
        """
        self._raise_if_broken()
        await self.add_gauges(capture)
        if capture.step != NO_STEP:
            await self._check_first(capture)
        if capture.is_sharp or (capture.grouped is not None and capture.step == NO_STEP):
            return  # the size of a manual group is not known: whoever takes its captures says when it is complete
        members = self._members(capture)
        if members is not None:
            await self.add_group(members)

    async def add_gauges(self, capture: CaptureRecord) -> None:
        """Add what gauges saw during a capture to the folder's file; the journal has it in any case."""
        if capture.is_sharp:
            return
        journal, results = self._recorder.journal, campaign_folder(self._data, capture.campaign) / RESULTS
        motions = gauges_of(journal, capture.campaign, capture.name)
        try:
            await self._recorder.on_disk(
                self._gauge_files.add, results, capture.name, motions, lambda: gauges_in(journal, capture.campaign)
            )
        except StorageError as exc:  # as for other results: the file is written anew when the campaign ends
            log.warning("gauges of %s are in the journal only: %s", capture.name, exc)

    async def add_group(self, members: Sequence[CaptureRecord], *, again: bool = False) -> None:
        """Measure captures jointly under their group's name, or one under its own; waits while the queue is full.

        `again` replaces an earlier result of this name: a manual group has a member more.
        """
        self._raise_if_broken()
        key = (members[-1].campaign, members[-1].grouped or members[-1].name)
        while again and key in self._tasks:
            await asyncio.wait([self._tasks[key]])
            await asyncio.sleep(0)
        if key in self._tasks:
            return
        await self._slots.acquire()
        self._since[key] = self._clock.monotonic()
        task = asyncio.create_task(self._measure(key, members, again=again))
        self._tasks[key] = task
        task.add_done_callback(lambda task: self._done(key, task))

    async def resume(self, campaign: str, group_sizes: Mapping[str, int]) -> None:
        """Take a campaign up: write its result files anew from the journal.

        `group_sizes` says how many captures each group has.
        """
        self._group_sizes[campaign] = group_sizes
        # A worker starts while the first frames are taken: the campaign waits for the look at them.
        self._start = asyncio.create_task(self._measurer.check_frames(campaign_folder(self._data, campaign), []))
        await self.rewrite(campaign)

    def expect_groups(self, campaign: str, group_sizes: Mapping[str, int]) -> None:
        """Learn how many captures each group has, where a search has decided on further steps."""
        self._group_sizes[campaign] = group_sizes

    async def rewrite(self, campaign: str) -> None:
        """Write a campaign's result files anew from the journal.

        Raises
        ------
        StorageError
            The folder refuses them; the journal has the rows.
        """
        async with self._writing:
            await self._rewrite(campaign)

    async def close(self, campaign: str) -> None:
        """A campaign has ended: its files are written anew once more, whatever has become of them, and stamped.

        Raises
        ------
        StorageError
            The folder refuses them; the journal has the rows.
        """
        await self.rewrite(campaign)
        stamp = await self._recorder.on_disk(self._measurer.stamp, campaign_folder(self._data, campaign))
        await self._recorder.write(transitions.keep_stamp, campaign, stamp)

    async def rebuild_incomplete(self) -> None:
        """Write the files of ended campaigns anew that lack a result: a power cut or another program took it."""
        journal = self._recorder.journal
        for record in records.campaigns(journal, "completed", "aborted", "failed"):
            names, folder = records.result_names(journal, record.id), campaign_folder(self._data, record.id)
            kept = records.stamp_of(journal, record.id)
            try:
                lacks = await self._recorder.on_disk(self._measurer.lacks, folder, names, kept)
                if names and lacks:
                    log.warning("results of %s on disk lack rows: written anew from the journal", record.id)
                    await self.close(record.id)
                elif folder.is_dir() and not (folder / RESULTS / FILE_NAME).exists():
                    await self._recorder.on_disk(self._write_gauges, record.id)
            except StorageError as exc:
                log.warning("results of %s cannot be mended: %s", record.id, exc)

    async def enqueue_stored(self, campaign: str) -> None:
        """Measure what is stored and not queued: a crash or a request may have come between."""
        for capture in records.captures(self._recorder.journal, campaign, "stored"):
            await self.add(capture)

    async def drain(self, leave: int = 0) -> None:
        """Wait until the queue is empty, or until no more than `leave` captures or groups are in it."""
        while len(self._tasks) > leave:
            await asyncio.wait(list(self._tasks.values()), return_when=asyncio.FIRST_COMPLETED)
            await asyncio.sleep(0)
        self._raise_if_broken()

    async def cancel(self) -> None:
        """Give up what is queued; the journal still has it as stored."""
        tasks = [*self._tasks.values(), *([self._start] if self._start is not None else [])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _check_first(self, capture: CaptureRecord) -> None:
        """Look at a campaign's first frames before anything else of it is captured; give them up if they are wrong."""
        if capture.campaign in self._checked:
            return
        stored = records.frames(self._recorder.journal, capture.campaign, capture.name)
        frames = [(frame.camera, self._data / frame.path) for frame in stored if frame.state == "stored"]
        try:
            await self._measurer.check_frames(campaign_folder(self._data, capture.campaign), frames)
        except SetupError as exc:
            await discard_stored(self._recorder, self._data, capture, str(exc))
            raise
        self._checked.add(capture.campaign)

    def _members(self, capture: CaptureRecord) -> list[CaptureRecord] | None:
        if capture.grouped is None:
            return [capture]
        taken = records.captures(self._recorder.journal, capture.campaign, "stored", "measured", step=capture.step)
        members = sorted((other for other in taken if other.grouped == capture.grouped), key=lambda other: other.shot)
        return members if len(members) >= self._group_sizes[capture.campaign][capture.grouped] else None

    def _raise_if_broken(self) -> None:
        if self._broken is not None:
            raise self._broken

    def _done(self, key: tuple[str, str], task: asyncio.Task[None]) -> None:
        if not task.cancelled() and task.exception() is not None:
            self._broken = task.exception()
        self._tasks.pop(key, None)
        self._since.pop(key, None)
        self._slots.release()

    async def _measure(self, key: tuple[str, str], members: Sequence[CaptureRecord], *, again: bool) -> None:
        campaign, name = key
        folder = campaign_folder(self._data, campaign)
        names = [member.name for member in members]
        last = members[-1]
        for attempt in range(1, TRIES + 1):
            try:
                measured = await self._measurer.measure(folder, last.sharp, names, name)
            except LabdaemonError as exc:
                if exc.retryable and attempt < TRIES:
                    continue
                await self._give_up(campaign, name, names, exc, is_manual=last.step == NO_STEP)
                return
            else:
                break
        event = EnvelopeData(
            capture=name,
            step=last.step if last.step != NO_STEP else None,
            label=last.label,
            frequency_hz=last.frequency_hz,
            excitation_amplitude_mm=last.amplitude_mm,
            opened_at=parse_rfc3339(last.opened_at) if last.opened_at else None,
            exposure_s=last.exposure_s or None,
            targets=tuple(TargetRow.model_validate(row) for row in measured.envelope),
        )
        await self._until_written(
            lambda: self._recorder.write(
                transitions.record_result,
                campaign,
                names,
                envelope=measured.envelope,
                measurements=measured.measurements,
                event=event,
                replace=again,
            )
        )
        await self._append(campaign, folder, measured, again=again)
        if self.observer is not None:
            self.observer.result_published(campaign, name, measured.envelope)

    async def _give_up(
        self, campaign: str, name: str, names: list[str], exc: LabdaemonError, *, is_manual: bool
    ) -> None:
        """Report it; of manual captures, which may come all night, the same words once."""
        is_known = is_manual and (campaign, str(exc)) in self._reported
        if is_manual:
            self._reported.add((campaign, str(exc)))
        payload = FaultData(device="worker", capture=name, error=type(exc).__name__, message=str(exc), action="kept")
        await self._until_written(
            lambda: self._recorder.write(transitions.give_up_measuring, campaign, names, payload, is_known=is_known)
        )

    async def _append(self, campaign: str, folder: Path, measured: CaptureRows, *, again: bool) -> None:
        """Add a result to the files, or write them anew where it replaces an earlier one.

        A folder that refuses it does not keep it from being published.
        """
        try:
            async with self._writing:
                if again or not await self._recorder.on_disk(self._measurer.append_results, folder, measured):
                    await self._rewrite(campaign)
        except StorageError as exc:
            # The files are written anew when the campaign ends, and it does not end as completed without them.
            log.warning("rows of %s are in the journal only: %s", campaign, exc)

    def _write_gauges(self, campaign: str) -> None:
        results = campaign_folder(self._data, campaign) / RESULTS
        self._gauge_files.write(results, gauges_in(self._recorder.journal, campaign))

    async def _rewrite(self, campaign: str) -> None:
        kept = records.results(self._recorder.journal, campaign)
        done = (CaptureRows(result.envelope, result.measurements) for result in kept)
        folder = campaign_folder(self._data, campaign)
        await self._recorder.on_disk(self._measurer.write_results, folder, done)
        await self._recorder.on_disk(self._write_gauges, campaign)

    async def _until_written(self, work: Callable[[], Awaitable[object]]) -> object:
        while True:
            try:
                return await work()
            except StorageUnavailable as exc:
                if self.observer is not None:
                    await self.observer.wait_for_disk(exc)
                else:
                    await self._clock.sleep(DISK_POLL_S)
