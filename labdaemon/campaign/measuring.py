"""Stored captures on their way to published envelopes, behind the engine's back but never far behind.

At most `depth` captures wait or are measured at a time: beyond that the engine, and with it the table, waits. Nothing
is dropped, so a crash at any point leaves in the journal exactly the captures that are still to be measured.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from labdaemon.capture.places import campaign_folder
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import Clock
from labdaemon.errors import LabdaemonError, StorageFull
from labdaemon.journal import records, transitions
from labdaemon.journal.records import CaptureRecord

Rows = list[dict[str, Any]]

TRIES = 2
DISK_POLL_S = 5.0


@dataclass(frozen=True, slots=True)
class Measured:
    """Rows of `envelope.csv` and of `measurements.csv`."""

    envelope: Rows
    measurements: Rows


class Measurer(Protocol):
    """Turns stored frames into an envelope, off the event loop."""

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> Measured:
        """Measure captures of a data-set folder jointly, under `name`.

        Raises
        ------
        LabdaemonError
            It cannot be measured; trying again helps only if it says so.
        """
        ...

    async def write_results(self, folder: Path, results: Iterable[Measured]) -> None:
        """Write the folder's result files anew from everything measured so far, which may be more than fits memory."""
        ...

    async def append_results(self, folder: Path, result: Measured) -> None:
        """Add to the folder's result files."""
        ...


class Measuring:
    """The queue between capturing and publishing.

    Parameters
    ----------
    recorder
        The journal.
    measurer
        Does the work.
    depth
        Captures (or groups) in hand at a time.
    """

    def __init__(
        self,
        recorder: Recorder,
        measurer: Measurer,
        clock: Clock,
        data: Path,
        *,
        depth: int = 4,
    ) -> None:
        self._recorder, self._measurer, self._clock, self._data = recorder, measurer, clock, data
        self._slots = asyncio.Semaphore(depth)
        self.published: Callable[[str, str, Rows], None] = lambda campaign, name, rows: None
        """Called with campaign, name and envelope rows of each result, on the event loop."""
        self._tasks: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._since: dict[tuple[str, str], float] = {}
        self._group_sizes: dict[str, Mapping[str, int]] = {}
        self._writing = asyncio.Lock()
        self._broken: BaseException | None = None
        self.finished = 0
        """Results and failures so far: what a watchdog looks at."""

    @property
    def waiting(self) -> int:
        """Captures or groups in hand."""
        return len(self._tasks)

    def oldest_s(self) -> float:
        """How long the oldest of them has been in hand."""
        return max((self._clock.monotonic() - since for since in self._since.values()), default=0.0)

    async def add(self, capture: CaptureRecord) -> None:
        """Measure a stored capture, or its group once all members are stored; waits while the queue is full.

        Raises what broke an earlier measurement in a way that nobody has foreseen.
        """
        self._raise_if_broken()
        if capture.is_sharp:
            return
        members = self._members(capture)
        if members is None:
            return
        key = (capture.campaign, capture.grouped or capture.name)
        if key in self._tasks:
            return
        await self._slots.acquire()
        self._since[key] = self._clock.monotonic()
        task = asyncio.create_task(self._measure(key, members))
        self._tasks[key] = task
        task.add_done_callback(lambda task: self._done(key, task))

    async def resume(self, campaign: str, group_sizes: Mapping[str, int]) -> None:
        """Take a campaign up: write its result files anew from the journal.

        `group_sizes` tells how many captures each group has.
        """
        self._group_sizes[campaign] = group_sizes
        kept = records.results(self._recorder.journal, campaign)
        done = (Measured(result.envelope, result.measurements) for result in kept)
        await self._measurer.write_results(campaign_folder(self._data, campaign), done)

    async def catch_up(self, campaign: str) -> None:
        """Measure whatever is stored and not in hand: a crash or a wish may have come between."""
        for capture in records.captures(self._recorder.journal, campaign, "stored"):
            await self.add(capture)

    async def drain(self) -> None:
        """Wait until nothing is in hand."""
        while self._tasks:
            await asyncio.wait(list(self._tasks.values()))
            await asyncio.sleep(0)
        self._raise_if_broken()

    async def cancel(self) -> None:
        """Give up what is in hand; the journal still has it as stored."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

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

    async def _measure(self, key: tuple[str, str], members: list[CaptureRecord]) -> None:
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
                await self._give_up(campaign, name, names, exc)
                return
            else:
                break
        event = {
            "capture": name,
            "step": last.step if last.step >= 0 else None,
            "frequency_hz": last.frequency_hz,
            "excitation_amplitude_mm": last.amplitude_mm,
            "opened_at": last.opened_at,
            "exposure_s": last.exposure_s,
            "targets": measured.envelope,
        }
        await self._when_there_is_room(
            lambda: self._recorder.write(
                transitions.record_result,
                campaign,
                name,
                names,
                envelope=measured.envelope,
                measurements=measured.measurements,
                event=event,
            )
        )
        async with self._writing:
            await self._when_there_is_room(lambda: self._measurer.append_results(folder, measured))
        self.finished += 1
        self.published(campaign, name, measured.envelope)

    async def _give_up(self, campaign: str, name: str, names: list[str], exc: LabdaemonError) -> None:
        told = {"device": "worker", "capture": name, "error": type(exc).__name__, "message": str(exc), "action": "kept"}
        await self._when_there_is_room(
            lambda: self._recorder.write(transitions.give_up_measuring, campaign, names, told)
        )
        self.finished += 1

    async def _when_there_is_room(self, write: Callable[[], Any]) -> None:
        while True:
            try:
                await write()
            except StorageFull:
                await self._clock.sleep(DISK_POLL_S)
            else:
                return
