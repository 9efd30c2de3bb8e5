"""Captures outside any campaign: a person's, and those of an outside system while the daemon only listens."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import replace

from labdaemon.campaign.measuring import Measuring
from labdaemon.campaign.steps import Settle, Shot, Step
from labdaemon.campaign.walk import Walker
from labdaemon.capture.capture import Lab, take
from labdaemon.capture.places import sharp_folder
from labdaemon.errors import LabdaemonError
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import NO_STEP, CaptureRecord

log = logging.getLogger(__name__)


class Manual:
    """Takes captures as the rig is, under the standing manual campaign or under a paused one."""

    def __init__(self, lab: Lab, measuring: Measuring) -> None:
        self._lab, self._measuring = lab, measuring
        self._turn = asyncio.Lock()
        self._finishing: set[asyncio.Task[None]] = set()
        self.exposure_s = 1.0
        """Exposure of captures that nobody planned."""

    async def capture(
        self, label: str, *, campaign: str | None, is_sharp: bool = False, request_id: str | None = None
    ) -> CaptureRecord:
        """Fire once, as the rig is; returns once fired, with storing and measuring still to come.

        Parameters
        ----------
        campaign
            The paused campaign that it goes to; None for the manual one.
        is_sharp
            A sharp frame at rest, for captures to come, rather than a blurred one.

        Raises
        ------
        DeviceError
            Trigger or cameras refused.
        """
        await self._turn.acquire()
        fired: asyncio.Future[CaptureRecord] = asyncio.get_running_loop().create_future()
        task = asyncio.create_task(self._take(label, campaign, is_sharp, request_id, fired))
        self._finishing.add(task)
        task.add_done_callback(lambda task: self._done(task, fired))
        return await asyncio.shield(fired)

    async def listen(self, window_s: float) -> None:
        """Keep every capture that an outside system fires, until cancelled."""
        id = await self._lab.recorder.write(transitions.open_manual)
        walker = Walker(self._lab, id, self._measuring.add, lambda: None, lambda: None, window_s=window_s)
        async for firing, files in walker.releases(None):
            await walker.keep_outside(self._order("outside", id, False), firing, files)

    async def finish(self) -> None:
        """Wait for captures that are still being stored."""
        while self._finishing:
            await asyncio.wait(set(self._finishing))

    def _done(self, task: asyncio.Task[None], fired: asyncio.Future[CaptureRecord]) -> None:
        """However it ended, the turn is given back and who waits for the opening is answered."""
        self._finishing.discard(task)
        self._turn.release()
        error = None if task.cancelled() else task.exception()
        if not fired.done():
            fired.set_exception(error or LabdaemonError("the capture was given up before the shutters opened"))
        elif error is not None:
            log.error("a manual capture was not stored", exc_info=error)

    async def _take(
        self,
        label: str,
        campaign: str | None,
        is_sharp: bool,
        request_id: str | None,
        fired: asyncio.Future[CaptureRecord],
    ) -> None:
        id = campaign if campaign is not None else await self._lab.recorder.write(transitions.open_manual)
        try:
            await take(
                self._lab,
                self._order(label, id, is_sharp),
                None,
                measure=self._measuring.add,
                request_id=request_id,
                fired=fired.set_result,
            )
        except LabdaemonError as exc:
            if not fired.done():
                fired.set_exception(exc)
                return
            told = {"device": getattr(exc, "device", None), "error": type(exc).__name__, "message": str(exc)}
            await self._lab.recorder.write(transitions.fault, campaign, {**told, "action": "recover"})

    def _order(self, label: str, campaign: str, is_sharp: bool) -> CaptureRecord:
        journal = self._lab.recorder.journal
        earlier = records.captures(journal, campaign, step=NO_STEP)
        sets = sorted({capture.name for capture in earlier if capture.is_sharp and capture.state == "stored"})
        excitation = self._lab.table.excitation
        name = f"manual-{len(earlier) + 1:04d}"
        step = Step(
            NO_STEP, 0, "sharp" if is_sharp else "external", name, None, None, (Shot(self.exposure_s),), False,
            Settle(), "skip", 0.0, 0,
        )  # fmt: skip
        flat = sharp_folder(self._lab.data, campaign, None)
        walker = Walker(self._lab, campaign, self._measuring.add, lambda: None, lambda: None)
        order = walker.order(step, 0, step.shots[0])
        sharp = name if is_sharp else (sets[-1] if sets else None)
        if not is_sharp and not sets and flat.is_dir():
            sharp = _latest_set(journal, campaign)
        return replace(
            order,
            name=name,
            label=label or name,
            sharp=sharp,
            frequency_hz=excitation.frequency_hz if excitation else None,
            amplitude_mm=excitation.amplitude_mm if excitation else None,
        )


def _latest_set(journal: Journal, campaign: str) -> str | None:
    """The sharp set that a paused campaign took last; None for the flat one."""
    taken = [capture for capture in records.captures(journal, campaign, "stored") if capture.is_sharp]
    return max(taken, key=lambda capture: capture.step).sharp if taken else None
