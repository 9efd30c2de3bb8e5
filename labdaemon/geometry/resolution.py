"""What a target's cameras leave open, settled by the other targets: by the phase that they share, or by continuity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labdaemon.flags import Flag
from labdaemon.geometry.common_phase import compare_phases
from labdaemon.geometry.continuity import ResolvedNeighbour, resolve_by_neighbours
from labdaemon.geometry.motion import IntersectedMotion
from labdaemon.geometry.settings import INTERSECTION


def resolve_ambiguous_targets(
    joined: Mapping[str, IntersectedMotion], members: Mapping[str, str] | None = None
) -> dict[str, IntersectedMotion]:
    """Choose between a target's two solutions by its settled neighbours (`labdaemon.geometry.continuity`).

    Parameters
    ----------
    joined
        By target.
    members
        Member of each target, if known.

    Returns
    -------
    dict
        The same targets; those settled lose `Flag.AMBIGUOUS` and say so.
    """
    result = dict(joined)
    result.update(_resolve_by_common_phase(joined))
    unsettled = {name for name, entry in joined.items() if entry.alternative is not None and not entry.signed}
    trusted = {
        name: ResolvedNeighbour(entry.motion.mean_mm, entry.motion.a_mm)
        for name, entry in joined.items()
        if name not in unsettled and Flag.AMBIGUOUS not in entry.motion.flags
    }
    for name in sorted(unsettled):
        entry = joined[name]
        assert entry.alternative is not None
        near = [other for other in joined if other != name and _same_member(name, other, members)]
        near.sort(key=lambda other: float(np.linalg.norm(joined[other].motion.mean_mm - entry.motion.mean_mm)))
        if not _neighbours_represent([other in trusted for other in near]):
            continue
        neighbours = [trusted[other] for other in near if other in trusted]
        options = (entry.motion, entry.alternative)
        choice = resolve_by_neighbours(options, entry.evidence, neighbours)
        if choice is not None:
            motion = options[choice]
            result[name] = IntersectedMotion(replace(motion, flags=motion.flags - {Flag.AMBIGUOUS}), None, "continuity")
    return result


def _resolve_by_common_phase(joined: Mapping[str, IntersectedMotion]) -> dict[str, IntersectedMotion]:
    """Choose between twins by the phase that most of the settled targets share."""
    settled = [entry.motion for entry in joined.values() if entry.signed and entry.alternative is None]
    result = {}
    for name, entry in joined.items():
        if not entry.signed or entry.alternative is None:
            continue
        options = (entry.motion, entry.alternative)
        odds = 2 * entry.evidence + compare_phases(options, settled)
        if abs(odds) >= INTERSECTION.twin_cost_gap:
            motion = options[0 if odds > 0 else 1]
            motion = replace(motion, flags=motion.flags - {Flag.AMBIGUOUS})
            result[name] = IntersectedMotion(motion, None, "common phase", signed=True)
    return result


def _same_member(name: str, other: str, members: Mapping[str, str] | None) -> bool:
    """Tell whether two targets are of the same member; all are where no members are known."""
    return members is None or members.get(name) == members.get(other)


def _neighbours_represent(settled: Sequence[bool]) -> bool:
    """Tell whether a target's neighbours, nearest first, may speak for it.

    Where most of its nearest are open too (a column moving in the epipolar plane), those that are settled belong to
    something else and moved otherwise: that is why they are settled.
    """
    return sum(settled[:3]) >= 2 and 3 * sum(settled[:6]) >= 2 * len(settled[:6])
