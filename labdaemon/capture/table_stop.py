"""Brings the table to rest, which counts only when something that can see the table confirms it.

First the ramp, for as long as the shaker's wire answers; where it does not, the shaker's hard stop and the drop of the
enable line go out together, on wires opened anew, again and again, until the verdict of
`labdaemon.capture.table_evidence` is rest or the patience is over. The table monitor then repeats it, see
`labdaemon.capture.table_monitor`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from dataclasses import dataclass, field
from typing import Any, Literal

from labdaemon.capture.abilities import can_switch_off, reopens_wire
from labdaemon.capture.rig import HARD_STOP_S, SOFT_STOP_S, DeviceHandle, Rig
from labdaemon.capture.table_evidence import TableEvidence, describe, judge
from labdaemon.capture.table_observer import TableObserver
from labdaemon.clock import Clock
from labdaemon.errors import LabdaemonError, RestUnconfirmed, TransportError

PATIENCE_S = 5.0
"""How long one stop tries before it says that rest is not confirmed."""

RETRY_S = 1.0
"""Between the beginnings of two rounds."""

SECOND_LOOKS = 2
"""Looks at a table whose shaker confirmed its stop before another stop is sent: amplifier and table ring a while."""

CONNECT_S = 20.0
"""A port that a replug moved takes its time."""

StopMethod = Literal["soft", "hard", "enable", "seen", "none"]


@dataclass(frozen=True, slots=True)
class RestConfirmation:
    """How the table was brought to rest.

    Attributes
    ----------
    by
        ``soft`` and ``hard`` are the shaker's own confirmed stops, ``enable`` the trigger box's line to the
        amplifier, ``seen`` that no stop was confirmed and the table rests all the same, ``none`` that there is no
        shaker of ours.
    troubles
        What each way that was tried before answered.
    seen
        What confirms it.
    """

    by: StopMethod
    troubles: tuple[str, ...] = ()
    seen: TableEvidence = field(default_factory=TableEvidence)


def rest_unconfirmed(evidence: TableEvidence, troubles: list[str]) -> RestUnconfirmed:
    """The error that says so.

    Parameters
    ----------
    evidence
        What was seen.
    troubles
        What each way to stop it answered.
    """
    table = judge(evidence)
    what = "THE TABLE MOVES ON" if table == "moving" else "THE TABLE WAS NOT SEEN TO COME TO REST"
    reasons = "; ".join(dict.fromkeys([describe(evidence), *troubles]))
    return RestUnconfirmed(
        f"{what} ({reasons}): use the emergency stop; stopping is tried again each second", table=table
    )


async def bring_to_rest(
    rig: Rig,
    observer: TableObserver,
    clock: Clock,
    *,
    at_once: bool = False,
    patience_s: float = PATIENCE_S,
) -> RestConfirmation:
    """Stop the table and wait until it is seen to rest.

    Parameters
    ----------
    observer
        Learns what is seen meanwhile.
    at_once
        Leave out the ramp.
    patience_s
        Longest time to try; one round is made in any case.

    Raises
    ------
    RestUnconfirmed
        Nothing that can see confirms, or something contradicts. The message names the emergency stop.
    """
    if rig.shaker is None:
        return RestConfirmation("none")
    shaker = rig.shaker
    end_s = clock.monotonic() + patience_s
    troubles: list[str] = []
    by: StopMethod | None = None
    looks = SECOND_LOOKS
    observer.forget()
    if not at_once and await _succeeds(shaker.urgent(lambda driver: driver.stop(), SOFT_STOP_S), troubles):
        by = "soft"
    while True:
        began_s = clock.monotonic()
        if by is None or looks <= 0 or not can_switch_off(shaker.driver):
            by = await _stop_hard(rig, observer, troubles) or by
        looks -= 1
        evidence = await observer.look()
        if judge(evidence) == "rest":
            return RestConfirmation(by or "seen", tuple(dict.fromkeys(troubles)), evidence)
        if clock.monotonic() >= end_s:
            raise rest_unconfirmed(evidence, troubles)
        await clock.sleep(max(began_s + RETRY_S - clock.monotonic(), 0.05))


async def _stop_hard(rig: Rig, observer: TableObserver, troubles: list[str]) -> StopMethod | None:
    """Output off and enable line down, together; which of them was confirmed by its device."""
    assert rig.shaker is not None
    drop = observer.has_line and rig.trigger is not None
    hard = asyncio.ensure_future(_succeeds(_stop_now(rig.shaker, "stop_now"), troubles))
    is_down = drop and rig.trigger is not None and await _succeeds(_stop_now(rig.trigger, "drop_enable"), troubles)
    is_off = await hard
    if is_down:
        observer.line_down = True
    return "hard" if is_off else "enable" if is_down else None


async def _stop_now(device: DeviceHandle[Any], how: Literal["stop_now", "drop_enable"]) -> None:
    """A stop by one device; connected to first where its driver does not open a broken wire by itself."""
    try:
        await device.urgent(lambda driver: getattr(driver, how)(), HARD_STOP_S)
    except TransportError:
        if reopens_wire(device.driver):
            raise
        await device.urgent(lambda driver: driver.connect(), CONNECT_S)
        await device.urgent(lambda driver: getattr(driver, how)(), HARD_STOP_S)


async def _succeeds(stop: Awaitable[None], troubles: list[str]) -> bool:
    try:
        await stop
    except LabdaemonError as exc:
        troubles.append(str(exc))
        return False
    return True
