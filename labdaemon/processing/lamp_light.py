"""What the targets of a frame under coded light say together: the ambient light, and whether the code was played."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur import LightFault, Measurement, find_light_fault, share_ambient
from labdaemon.flags import Flag


def apply_lamp_light(
    measured: Sequence[Measurement], coded_frames: int
) -> tuple[list[Measurement], list[LightFault | None]]:
    """All targets with the ambient light that they share, and flagged where the lamp did not play the stated code.

    Parameters
    ----------
    measured
        Of one camera, in one frame or in the frames of a group together.
    coded_frames
        How many of these frames are under coded light.

    Returns
    -------
    measured, faults
        The targets, and for each frame under coded light how its light differed; None where it did not.
    """
    shared = share_ambient(measured)
    faults = find_light_faults(shared, coded_frames)
    return (flag_light_mismatch(shared) if any(faults) else shared), faults


def find_light_faults(measured: Sequence[Measurement], coded_frames: int) -> list[LightFault | None]:
    """How the light of each frame under coded light differed from its code; None where it did not."""
    scored = [one.light_scores for one in measured if len(one.light_scores) == coded_frames]
    return [find_light_fault([scores[frame] for scores in scored]) for frame in range(coded_frames)]


def flag_light_mismatch(measured: Sequence[Measurement]) -> list[Measurement]:
    """The targets, those with numbers flagged."""
    return [
        replace(one, flags=one.flags | {Flag.LIGHT_MISMATCH}) if np.isfinite(one.a_px).all() else one
        for one in measured
    ]


def describe_light(fault: LightFault) -> str:
    """What the light was instead of the code, and what to look at."""
    if fault.is_constant:
        return (
            "shows constant light, not the code that was stated: the lamp does not follow it; check that it is wired "
            "to the lamp output, has power, and is the only light"
        )
    return (
        f"shows another light than the code that was stated, by {100 * fault.rms:.0f} % of the lamp's brightness in "
        "the mean: check the code, the lamp's supply and dimmer, and other light that flickers"
    )
