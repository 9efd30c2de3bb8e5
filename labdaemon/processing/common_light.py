"""What several cameras say together of the lamp: it is one for all, and each shows a little of its brightness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from labdaemon.flags import Flag
from labdaemon.processing.frame import FrameResult
from labdaemon.processing.lamp_light import describe_light, find_light_faults, flag_light_mismatch


def check_common_light(frames: Sequence[FrameResult]) -> list[FrameResult]:
    """The frames of a capture or group, flagged where all cameras together contradict the code.

    Parameters
    ----------
    frames
        One result a camera. Where one camera alone has found that the light was another, nothing is added.
    """
    measured = [one for frame in frames for one in frame.measurements]
    coded = max((len(one.light_scores) for one in measured), default=0)
    if len(frames) < 2 or not coded or any(Flag.LIGHT_MISMATCH in one.flags for one in measured):
        return list(frames)
    notes = [
        f"all cameras together: frame {place} of {coded} under coded light {describe_light(fault)}"
        for place, fault in enumerate(find_light_faults(measured, coded), start=1)
        if fault is not None
    ]
    if not notes:
        return list(frames)
    flagged = [replace(frame, measurements=tuple(flag_light_mismatch(frame.measurements))) for frame in frames]
    return [replace(flagged[0], notes=(*flagged[0].notes, *notes)), *flagged[1:]]
