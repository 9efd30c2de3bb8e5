"""The proof that the enable line stops this table: it moves a little, the line alone drops, the motion is seen to end.

A line that was never seen to stop the table may be wired to nothing. What sees it is a gauge on the table, or a
controller that reports the amplifier's state; the trigger box's own answer proves nothing. The shaker's output must be
on all the while, or it was not the line that ended the motion.
"""

from __future__ import annotations

from labdaemon.capture.abilities import holds_enable_line, reports_amplifier
from labdaemon.capture.rig import Rig
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.clock import Clock
from labdaemon.errors import InterlockError, LimitError

AMPLITUDES_MM = (0.2, 0.5, 1.0)
"""Tried one after the other until the motion is seen, never beyond what the campaign asks for."""

END_S = 4.0
"""The motion must have ended this long after the drop."""

LOOK_AGAIN_S = 0.2  # rest is seen twice, so far apart

TRIES_AT_LARGEST = 3
"""How often the largest amplitude is tried: a busy computer reads a gauge late or not at all, and a heavy table follows
slowly."""


class LineUnproven(InterlockError):
    """The enable line was not seen to stop the table."""


def can_prove_enable_line(rig: Rig) -> bool:
    """Whether the rig has a line, and something that could see it stop the table.

    Whether a controller reports its amplifier is only known once it was asked: its driver says ``reports_amplifier``.
    """
    if rig.shaker is None or rig.trigger is None or not holds_enable_line(rig.trigger.driver):
        return False
    return rig.gauge("table") is not None or reports_amplifier(rig.shaker.driver)


async def prove_enable_line(rig: Rig, table: Table, clock: Clock, frequency_hz: float, largest_mm: float) -> None:
    """Let the table move a little, drop the line alone, and see the motion end; the table rests afterwards.

    Parameters
    ----------
    frequency_hz
        An excitation's that the table has been checked for.
    largest_mm
        Semi-amplitude that the table may have there.

    Raises
    ------
    LineUnproven
        Nothing saw it move, or it moved on.
    DeviceError
        A device failed, so nothing is known either way.
    RestUnconfirmed
        The table was not seen to come to rest afterwards.
    """
    observer = table.observer
    observer.proof = "untried"  # whatever interrupts this leaves nothing proven
    try:
        witnesses = await _move(rig, table, clock, frequency_hz, largest_mm)
        await table.drop_line()
        await _see_end(table, clock, witnesses)
    except LineUnproven:
        observer.proof = "failed"
        raise
    finally:
        await table.stop(at_once=True)
    observer.proof = "proven"


async def _move(rig: Rig, table: Table, clock: Clock, frequency_hz: float, largest_mm: float) -> set[str]:
    """Move the table until something sees it; who does."""
    amplitudes_mm = sorted({min(amplitude_mm, largest_mm) for amplitude_mm in AMPLITUDES_MM})
    for amplitude_mm in amplitudes_mm + amplitudes_mm[-1:] * (TRIES_AT_LARGEST - 1):
        try:
            await table.excite(Excitation(frequency_hz, amplitude_mm))
        except LimitError:
            continue  # less than the controller can do
        await clock.sleep(LOOK_AGAIN_S)
        evidence = await table.observer.look()
        witnesses = {"gauge"} if evidence.gauge_moves else set()
        if evidence.output_on and evidence.amplifier_on:
            witnesses.add("amplifier")
        if witnesses:
            return witnesses
    trouble = table.observer.gauge_trouble
    raise LineUnproven(
        "the enable line is not proven: neither table gauge nor controller saw the table move"
        + (f" (the gauge could not be read: {trouble})" if trouble is not None else "")
    )


async def _see_end(table: Table, clock: Clock, witnesses: set[str]) -> None:
    end_s = clock.monotonic() + END_S
    while True:
        evidence = await table.observer.look()
        moves = {"gauge": evidence.gauge_moves, "amplifier": evidence.amplifier_on}
        if table.excitation is None:
            raise InterlockError("the table was stopped while its enable line was being proven")
        if all(moves[witness] is False for witness in witnesses):
            break
        if clock.monotonic() > end_s:
            raise LineUnproven(
                "the enable line does not stop the table: it was dropped alone, and the table was seen to move on "
                f"({', '.join(sorted(witnesses))}); look where the trigger box's enable output is wired to"
            )
        await clock.sleep(LOOK_AGAIN_S)
    if not evidence.output_on:
        raise LineUnproven("the enable line is not proven: the shaker's output went off, so it was not the line alone")
