"""Twins settled by the other targets: the points of a structure in one mode share their phase, or its opposite.

The phases of the targets whose motion is settled are the prior of those that are not: a mixture of a bell about each of
them and of any other phase. It counts only where most of the settled targets do share one phase.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.geometry.motion import ObjectMotion
from labdaemon.geometry.settings import INTERSECTION
from labdaemon.half_turn import major_phase_rad, within_half_turn


def compare_phases(options: tuple[ObjectMotion, ObjectMotion], settled: Sequence[ObjectMotion]) -> float:
    """Twice the logarithm of the odds of the first of two motions against the second, by the phases of others.

    Returns
    -------
    float
        0 where too few others are settled, or where they do not share one phase.
    """
    if len(settled) < INTERSECTION.min_phase_neighbours:
        return 0.0
    phases = np.array([major_phase_rad(motion.a_mm, motion.b_mm) for motion in settled])
    spread = INTERSECTION.phase_spread_rad
    common = np.abs(within_half_turn(phases[:, None] - phases)) < 3 * spread
    if float(np.max(common.mean(axis=1))) < INTERSECTION.common_phase_share:
        return 0.0
    densities = []
    for motion in options:
        away = within_half_turn(phases - major_phase_rad(motion.a_mm, motion.b_mm))
        bells = np.exp(-((away / spread) ** 2) / 2) / (np.sqrt(2 * np.pi) * spread)
        share = INTERSECTION.other_phase_share
        densities.append((1 - share) * float(bells.mean()) + share / np.pi)
    return float(2 * np.log(densities[0] / densities[1]))
