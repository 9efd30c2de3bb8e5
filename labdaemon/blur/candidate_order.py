"""A measurement whose candidates were weighed anew: the most likely one leads, and what follows from that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import AlternativeMotion, Measurement
from labdaemon.blur.settings import PHASE
from labdaemon.flags import Flag


def own_motion(one: Measurement) -> AlternativeMotion:
    """The measured motion itself as a candidate."""
    return AlternativeMotion(one.centre_px, one.a_px, one.b_px, one.covariance_px2, 0.0, one.ambient)


def led_by_best(one: Measurement, candidates: Sequence[AlternativeMotion]) -> Measurement:
    """A measurement by its candidates.

    Parameters
    ----------
    one
        What was measured.
    candidates
        Its own motion and its alternatives, with any excess.

    Returns
    -------
    Measurement
        The most likely candidate's; `Flag.AMBIGUOUS` where another one is not excluded.
    """
    weighed = sorted(candidates, key=lambda candidate: candidate.excess)
    best = weighed[0]
    rest = [replace(other, excess=other.excess - best.excess) for other in weighed[1:]]
    rest = [other for other in rest if other.excess < LIGHT.rival_limit]
    flags = one.flags - {Flag.AMBIGUOUS}
    if Flag.AT_REST not in flags and any(other.excess < PHASE.rival_cost for other in rest):
        flags |= {Flag.AMBIGUOUS}
    return replace(
        one,
        centre_px=best.centre_px,
        a_px=best.a_px,
        b_px=best.b_px,
        covariance_px2=best.covariance_px2,
        flags=flags,
        alternatives=tuple(rest),
        ambient=best.ambient,
    )
