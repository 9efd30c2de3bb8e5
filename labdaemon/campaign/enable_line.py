"""The enable line and campaigns: none moves the table unattended before the line was seen to stop it.

The proof (`labdaemon.capture.enable_line_proof`) is made when a campaign is submitted to an idle rig, so that a person
who is still there learns of a line that is wired to nothing, and otherwise as a campaign's first act. It holds until
the process ends. A rig file may accept that there is no such line; then a failed proof is reported and the campaign
runs.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Literal

from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.steps import Plan, Step
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.enable_line_proof import LineUnproven, can_prove_enable_line, prove_enable_line
from labdaemon.errors import DeviceError, InterlockError
from labdaemon.stream.messages import WrongStateError

log: logging.Logger = logging.getLogger(__name__)

EnableLineState = Literal["proven", "failed", "untried", "impossible"]

NO_LINE = (
    "no enable line of this rig can be proven to stop the table (it takes a trigger box that holds the amplifier's "
    "enable line, and a table gauge or a controller that reports the amplifier's state); wire one, or set "
    "[interlocks] accept_no_enable = true to answer for the table yourself"
)


class EnableLine:
    """What campaigns ask of the enable line.

    Parameters
    ----------
    context
        The rig and its table.
    reporter
        For a proof that failed and was accepted.
    is_accepted
        The rig file accepts a table without a proven line.
    """

    def __init__(self, context: AcquisitionContext, reporter: CampaignReporter, is_accepted: bool) -> None:
        self._context = context
        self._reporter = reporter
        self.is_accepted: bool = is_accepted
        self._turn = asyncio.Lock()

    @property
    def state(self) -> EnableLineState | None:
        """For status; None without a shaker of ours."""
        if self._context.rig.shaker is None:
            return None
        proof = self._context.table.observer.proof
        return "impossible" if proof == "untried" and not can_prove_enable_line(self._context.rig) else proof

    async def admit(self, plan: Plan, *, is_idle: bool) -> None:
        """Let a campaign in, proving the line first where no other campaign runs.

        Raises
        ------
        WrongStateError
            The line is not proven, and the rig file does not accept that.
        """
        first = next((step for step in plan.steps if _moves(step)), None)
        if self.is_accepted or first is None or self.state in (None, "proven"):
            return
        if self.state == "impossible":
            raise WrongStateError(NO_LINE)
        if not is_idle:
            return  # the campaign that runs, or waits, proves it before it moves anything
        try:
            await self._prove(first)
        except DeviceError as exc:
            log.warning("the enable line could not be tried (%s); the campaign tries it before it moves the table", exc)
        except InterlockError as exc:
            raise WrongStateError(f"{exc}; or set [interlocks] accept_no_enable = true") from exc

    async def check_before(self, step: Step) -> None:
        """What comes before a step that moves the table.

        Raises
        ------
        InterlockError
            The line is not proven, and the rig file does not accept that.
        """
        if not _moves(step) or self.state in (None, "proven"):
            return
        if self.state == "impossible":
            if not self.is_accepted:
                raise InterlockError(NO_LINE)
            return
        if self.is_accepted and self.state == "failed":
            return  # it was reported
        try:
            await self._prove(step)
        except LineUnproven as exc:
            if not self.is_accepted:
                raise
            await self._reporter.fault(exc, campaign=None, step=step, action="go on, as accept_no_enable says")

    async def _prove(self, step: Step) -> None:
        assert step.frequency_hz is not None
        assert step.amplitude_mm is not None
        async with self._turn:
            if self.state == "proven":
                return
            context = self._context
            await prove_enable_line(context.rig, context.table, context.clock, step.frequency_hz, step.amplitude_mm)
            log.info("the enable line was seen to stop the table")


def _moves(step: Step) -> bool:
    return step.frequency_hz is not None and bool(step.amplitude_mm)
