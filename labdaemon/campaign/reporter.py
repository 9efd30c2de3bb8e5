"""Writes what happens to campaigns into the journal, however long the disk has no room for it."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, TypeVar

from labdaemon.campaign.steps import Step
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import Clock
from labdaemon.errors import StorageFull
from labdaemon.journal import transitions
from labdaemon.journal.records import CampaignState

T = TypeVar("T")

log = logging.getLogger(__name__)

DISK_POLL_S = 5.0


class Reporter:
    """Faults and campaigns' states.

    Parameters
    ----------
    recorder
        The journal.
    free_bytes
        Room on the data disk.
    min_free_bytes
        Room that there must be before work goes on.
    """

    def __init__(self, recorder: Recorder, clock: Clock, free_bytes: Callable[[], int], min_free_bytes: int) -> None:
        self._recorder, self._clock = recorder, clock
        self._free_bytes, self._min_free_bytes = free_bytes, min_free_bytes
        self.faults = 0
        self.last_fault: str | None = None

    async def fault(self, exc: BaseException, *, campaign: str | None, step: Step | None, action: str) -> None:
        """Tell of a fault and of what is done about it."""
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
        with suppress(StorageFull):  # the disk has no room for the news either; the log has them
            await self._recorder.write(transitions.fault, campaign, told)

    async def move(self, campaign: str, state: CampaignState, reason: str | None = None, **data: Any) -> bool:
        """Put a campaign into another state; False if it was in none that leads there."""
        return await self.when_there_is_room(
            lambda: self._recorder.write(transitions.move_campaign, campaign, state, reason, **data)
        )

    async def when_there_is_room(self, work: Callable[[], Awaitable[T]]) -> T:
        """Do it, and do it again after every `StorageFull`, once there is room."""
        while True:
            try:
                return await work()
            except StorageFull as exc:
                await self.fault(exc, campaign=None, step=None, action="wait for room")
                await self.wait_for_room()

    async def wait_for_room(self) -> None:
        """Wait until the disk has room again, and a little longer."""
        while self._free_bytes() < self._min_free_bytes:
            await self._clock.sleep(DISK_POLL_S)
        await self._clock.sleep(DISK_POLL_S)
