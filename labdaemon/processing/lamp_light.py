"""What the targets of a frame under coded light say together: the ambient light, and whether the code was played."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur import Measurement, is_light_mismatch, share_ambient
from labdaemon.flags import Flag


def apply_lamp_light(measured: Sequence[Measurement], coded_frames: int) -> list[Measurement]:
    """All targets with the ambient light that they share, and flagged where the lamp did not play the stated code.

    Parameters
    ----------
    measured
        Of one camera, in one frame or in the frames of a group together.
    coded_frames
        How many of these frames are under coded light.
    """
    return flag_light_mismatch(share_ambient(measured), coded_frames)


def flag_light_mismatch(measured: Sequence[Measurement], coded_frames: int) -> list[Measurement]:
    """The targets, flagged where all of them together say that the lamp did not play the code that was stated."""
    scored = [one.light_scores for one in measured if len(one.light_scores) == coded_frames]
    if not any(is_light_mismatch([scores[frame] for scores in scored]) for frame in range(coded_frames)):
        return list(measured)
    return [
        replace(one, flags=one.flags | {Flag.LIGHT_MISMATCH}) if np.isfinite(one.a_px).all() else one
        for one in measured
    ]
