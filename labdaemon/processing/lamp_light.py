"""What the targets of a frame under coded light say together: the ambient light, and whether the code was played."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur import (
    LIGHT,
    CommonAmbient,
    ExposureWindow,
    LightFault,
    Measurement,
    estimate_common_ambient,
    find_light_fault,
    free_ambient,
    share_ambient,
)
from labdaemon.flags import Flag

UNEVEN_LIGHT = (
    "shows targets that were lit more on one half of their paths, as whole cycles under constant light never are: "
    "state the lamp's light, light_phase_rad and light_cycles in capture.toml, or correct exposure_s"
)
"""What a frame shows whose capture states whole cycles and no code."""


@dataclass(frozen=True, slots=True, eq=False)
class CodedMeasurement:
    """All targets of one camera under coded light.

    Attributes
    ----------
    measured
        The targets, flagged where the lamp did not play the stated code.
    faults
        For each frame under coded light how its light differed; None where it did not.
    ambient
        The ambient light that was measured with, where what was stated is wrong.
    """

    measured: list[Measurement]
    faults: list[LightFault | None]
    ambient: CommonAmbient | None = None


def measure_under_code(
    measure: Callable[[Sequence[ExposureWindow]], list[Measurement]], windows: Sequence[ExposureWindow]
) -> CodedMeasurement:
    """Measure with the stated light; where the images contradict that, with the ambient light that they show.

    Parameters
    ----------
    measure
        Measures all targets of a camera through these windows.
    windows
        As stated, one a frame.
    """
    coded = sum(window.is_coded for window in windows)
    found = measure(windows)
    first = CodedMeasurement(*apply_lamp_light(found, coded))
    stated_sd = max((window.light.sd_ambient for window in windows if window.light is not None), default=0.0)
    if not _asks_for_other_ambient(first, estimate_common_ambient(found), stated_sd):
        return first
    again = measure([free_ambient(window) for window in windows])
    ambient = estimate_common_ambient(again)
    if ambient is None or not ambient.contradicts(stated_sd):
        return first
    shared = share_ambient(again)
    left = find_light_faults(shared, coded, LIGHT.ambient_explains_probability)
    if ambient.is_uniform and not any(left):
        return CodedMeasurement(shared, [None] * coded, ambient)
    if any(first.faults):
        return first
    other = LightFault(is_constant=False, rms=abs(ambient.correction))
    return CodedMeasurement(flag_light_mismatch(shared), [one or other for one in left])


def _asks_for_other_ambient(first: CodedMeasurement, ambient: CommonAmbient | None, stated_sd: float) -> bool:
    """Whether another ambient light may explain the frames."""
    if any(fault is not None and fault.is_constant for fault in first.faults):
        return False
    return any(first.faults) or (ambient is not None and ambient.contradicts(stated_sd))


def describe_ambient(window: ExposureWindow, ambient: CommonAmbient) -> str:
    """What ambient light was stated, and what the images show."""
    stated = 0.0 if window.light is None else window.light.ambient
    return (
        f"shows ambient light of {stated + ambient.correction:.3f} of the lamp's, with a standard deviation of "
        f"{ambient.sd:.3f}, where {stated:.3g} was stated: the targets are measured with the former; correct ambient"
    )


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


def find_light_faults(
    measured: Sequence[Measurement], coded_frames: int, probability: float = LIGHT.light_mismatch_probability
) -> list[LightFault | None]:
    """How the light of each frame under coded light differed from its code; None where it did not.

    Parameters
    ----------
    measured
        Targets that saw the same light.
    coded_frames
        How many of their frames are under coded light.
    probability
        As for `find_light_fault`.
    """
    scored = [one.light_scores for one in measured if len(one.light_scores) == coded_frames]
    return [find_light_fault([scores[frame] for scores in scored], probability) for frame in range(coded_frames)]


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
