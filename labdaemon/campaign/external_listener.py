"""What runs while the engine waits, idle or paused: captures that an outside system fires are kept and measured."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from labdaemon.campaign.manual import ManualCaptures
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.retry import RetryingStepRunner, RetryPolicy
from labdaemon.capture.context import AcquisitionContext
from labdaemon.errors import LabdaemonError


class ExternalListener:
    """Listens for outside releases while something else is waited for.

    It listens where the daemon has no trigger or no shaker of its own: then captures are fired by others.
    """

    def __init__(
        self,
        context: AcquisitionContext,
        manual: ManualCaptures,
        step_runner: RetryingStepRunner,
        reporter: CampaignReporter,
        policy: RetryPolicy,
    ) -> None:
        self._context, self._manual, self._step_runner = context, manual, step_runner
        self._reporter, self._policy = reporter, policy

    async def listen_during(self, wait: Coroutine[Any, Any, None], campaign: str | None) -> None:
        """Listen until the wait is over, and until what came meanwhile is stored.

        Parameters
        ----------
        wait
            What ends it.
        campaign
            The paused campaign that captures go to; None for the manual one.
        """
        listening = asyncio.create_task(self._listen(campaign))
        try:
            await wait
        finally:
            listening.cancel()
            with suppress(asyncio.CancelledError):  # that is what was asked of it
                await listening
        await self._manual.finish()

    async def _listen(self, campaign: str | None) -> None:
        failures = 0
        while True:
            try:
                await self._manual.measurements.measure_pending(campaign)
                if self._context.rig.trigger is not None and self._context.rig.shaker is not None:
                    return
                await self._manual.listen(campaign)
            except LabdaemonError as exc:
                failures += 1
                await self._reporter.fault(exc, campaign=campaign, step=None, action="listen again")
                await self._context.clock.sleep(self._policy.pause_s(failures))
                await self._manual.finish()
                await self._step_runner.recover(None, None)
