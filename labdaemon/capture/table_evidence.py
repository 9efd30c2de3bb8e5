"""Whether the table rests, judged from what was seen of it: pure functions from evidence to a verdict.

Three things can see. The shaker's controller reads back its output, and some report the amplifier's state. A gauge on
the table sees the motion itself. The amplifier's enable line counts once it was *proven* in this rig: the table moved,
the line alone was dropped, and one of the other two saw the motion end. That a trigger box says it dropped its line
proves nothing, since it is not known where the wire goes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from labdaemon.capture.devices import GaugeReading

TableState = Literal["rest", "moving", "unconfirmed"]
Sight = Literal["rest", "moving"]

GAUGE_SDS = 3.0
"""A table gauge that reads more standard deviations than this sees motion."""

CALM_RATIO = 5.0
"""A record that scatters more than this times the gauge's noise holds another motion than the one that was fitted."""


@dataclass(frozen=True, slots=True)
class TableEvidence:
    """What was seen of the table; None where nothing was seen.

    Attributes
    ----------
    output_on
        The shaker's controller reads back that its output is on.
    amplifier_on
        The same of the amplifier, from a controller that reports it.
    gauge_moves
        The table gauge sees motion.
    line_down
        The trigger box says that the enable line is down.
    line_proven
        That line was seen to end the table's motion, see `labdaemon.capture.enable_line_proof`.
    """

    output_on: bool | None = None
    amplifier_on: bool | None = None
    gauge_moves: bool | None = None
    line_down: bool | None = None
    line_proven: bool = False


def sights(evidence: TableEvidence) -> dict[str, Sight]:
    """What each witness says: ``shaker``, ``amplifier``, ``gauge``, ``enable line``; without those that saw nothing.

    An output that is on does not contradict a proven line that is down: in the proof, too, the output was on while
    the table stood still.
    """
    seen: dict[str, Sight] = {}
    line_holds = evidence.line_proven and evidence.line_down is True
    if line_holds:
        seen["enable line"] = "rest"
    if evidence.amplifier_on is False:
        seen["amplifier"] = "rest"
    if evidence.output_on is False:
        seen["shaker"] = "rest"
    elif evidence.output_on and evidence.amplifier_on is True:
        seen["amplifier"] = "moving"
    elif evidence.output_on and evidence.amplifier_on is None and not line_holds:
        seen["shaker"] = "moving"
    if evidence.gauge_moves is not None:
        seen["gauge"] = "moving" if evidence.gauge_moves else "rest"
    return seen


def judge(evidence: TableEvidence) -> TableState:
    """``rest`` where a witness confirms it and none contradicts, ``moving`` where one contradicts."""
    seen = set(sights(evidence).values())
    if "moving" in seen:
        return "moving"
    return "rest" if seen else "unconfirmed"


def describe(evidence: TableEvidence) -> str:
    """What was seen, for a message: ``shaker: rest, gauge: moving``."""
    return ", ".join(f"{who}: {what}" for who, what in sights(evidence).items()) or "nothing that can see answers"


def gauge_sees_motion(reading: GaugeReading, noise_sd: float | None) -> bool | None:
    """What a table gauge's reading says.

    Parameters
    ----------
    reading
        At the frequency that the table had last.
    noise_sd
        The smallest standard deviation that this gauge's readings of the same length had; None where it is not known.

    Returns
    -------
    bool or None
        None when the record scatters too much, or the noise is not known, to say that nothing moves.
    """
    if reading.value > GAUGE_SDS * reading.sd:
        return True
    return False if noise_sd is not None and reading.sd <= CALM_RATIO * noise_sd else None
