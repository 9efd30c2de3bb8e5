"""Writes what happens to campaigns into the journal, however long the disk does not take it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Protocol, TypeVar

from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.steps import Step
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import Clock
from labdaemon.errors import StorageError, StorageUnavailable
from labdaemon.events import CampaignData, FaultData
from labdaemon.journal import transitions
from labdaemon.journal.records import CampaignState

T = TypeVar("T")

log: logging.Logger = logging.getLogger(__name__)

DISK_POLL_S = 2.0  # a person who frees space sees the campaign go on at once
RECORD_S = 2.0
"""How long the answer to a stop waits for its record in the journal."""


class UnrecordedFaultObserver(Protocol):
    """Carries faults to a person by another way than the journal."""

    def fault_unrecorded(self, campaign: str | None, data: FaultData) -> None:
        """The journal does not take this fault now, as on a full disk; called on the event loop."""
        ...


class CampaignReporter:
    """Faults and campaigns' states.

    Parameters
    ----------
    recorder
        The journal.
    disk
        The disk that the journal lies on.

    Attributes
    ----------
    faults, last_fault
        How many there were since the start, and what the last one was.
    disk_trouble
        Why the disk takes nothing now; None while it does.
    """

    def __init__(self, recorder: Recorder, clock: Clock, disk: DataDisk) -> None:
        self._recorder, self._clock, self._disk = recorder, clock, disk
        self.faults: int = 0
        self.last_fault: str | None = None
        self.disk_trouble: str | None = None
        self._recording: set[asyncio.Task[None]] = set()
        self.observer: UnrecordedFaultObserver | None = None
        """Learns of faults that the journal does not take now."""

    async def fault(self, exc: BaseException, *, campaign: str | None, step: Step | None, action: str) -> None:
        """Report a fault and what is done about it."""
        self.faults += 1
        self.last_fault = str(exc)
        log.warning("fault: %s (%s)", exc, action)
        payload = FaultData(
            device=getattr(exc, "device", None),
            error=type(exc).__name__,
            message=str(exc),
            step=step.index if step is not None else None,
            action=action,
        )
        try:
            await self._recorder.write(transitions.fault, campaign, payload)
        except StorageUnavailable:  # the disk does not take the report either; the log has it
            self._unrecorded(campaign, payload)

    async def fault_soon(self, exc: BaseException, *, action: str) -> None:
        """Report a fault, and wait for the record no longer than a stop may wait for a disk."""
        recording = asyncio.create_task(self.fault(exc, campaign=None, step=None, action=action))
        self._recording.add(recording)
        recording.add_done_callback(self._recording.discard)
        await asyncio.wait({recording}, timeout=RECORD_S)

    async def move(
        self,
        campaign: str,
        state: CampaignState,
        reason: str | None = None,
        data: CampaignData = transitions.NOTHING_MORE,
    ) -> bool:
        """Put a campaign into another state; False if it was in none that leads there."""
        return await self.with_disk_retry(
            lambda: self._recorder.write(transitions.move_campaign, campaign, state, reason, data)
        )

    async def with_disk_retry(self, work: Callable[[], Awaitable[T]]) -> T:
        """Do it, and do it again after every `StorageUnavailable`, once the disk takes writes."""
        while True:
            try:
                return await work()
            except StorageUnavailable as exc:
                await self.wait_for_disk(exc)

    async def wait_for_disk(self, exc: StorageUnavailable, campaign: str | None = None) -> None:
        """Wait until the disk takes writes again; one fault is reported for each such time, at its end."""
        if self.disk_trouble is not None:  # another task has reported it
            await self._until_it_writes()
            return
        began_s = self._clock.monotonic()
        self.faults += 1
        self.last_fault = self.disk_trouble = str(exc)
        log.error("waiting for the disk: %s", exc)
        payload = FaultData(device="disk", error=type(exc).__name__, message=str(exc), step=None, action="wait")
        self._unrecorded(campaign, payload)
        try:
            while True:
                await self._until_it_writes()
                waited_s = self._clock.monotonic() - began_s
                message = f"{exc}; it took nothing for {waited_s:.0f} s"
                with suppress(StorageUnavailable):  # it was for a moment only: wait again
                    past = payload.model_copy(update={"message": message, "action": "waited"})
                    await self._recorder.write(transitions.fault, campaign, past)
                    break
        finally:
            self.disk_trouble = None
        log.warning("the disk takes writes again after %.0f s", waited_s)

    def _unrecorded(self, campaign: str | None, fault: FaultData) -> None:
        if self.observer is not None:
            self.observer.fault_unrecorded(campaign, fault)

    async def _until_it_writes(self) -> None:
        while True:
            await self._clock.sleep(DISK_POLL_S)
            try:
                await self._disk.check_thoroughly()
            except StorageError as exc:
                if self.disk_trouble is not None:
                    self.disk_trouble = str(exc)
            else:
                return
