"""The parameters of `capture`: what a person or another program states of a capture outside any campaign."""

from __future__ import annotations

from typing import Any

from labdaemon.campaign.manual_request import (
    AMPLITUDE_MM,
    EXPOSURE_S,
    FREQUENCY_HZ,
    MAX_TEXT,
    PHASE_RAD,
    ManualRequest,
    is_group_name,
)
from labdaemon.service.command_parameters import CommandParameters
from labdaemon.stream.messages import InvalidParamsError


def capture_request(params: dict[str, Any]) -> ManualRequest:
    """Read and check them.

    Raises
    ------
    InvalidParamsError
        Names the one that is unknown, of the wrong type, out of range, or makes no sense with the others.
    """
    given = CommandParameters(
        params,
        "label",
        "sharp",
        "request_id",
        "frequency_hz",
        "excitation_amplitude_mm",
        "phase_rad",
        "group",
        "exposure_s",
    )
    group, is_sharp = given.optional_text("group", longest=MAX_TEXT), given.flag("sharp")
    if group is not None and not is_group_name(group):
        raise InvalidParamsError(f"group {group[:40]!r} cannot name a result; use letters, digits, spaces, - and _")
    if group is not None and is_sharp:
        raise InvalidParamsError("group is of blurred captures; a sharp one has none")
    return ManualRequest(
        label=given.text("label", default="", longest=MAX_TEXT),
        is_sharp=is_sharp,
        request_id=given.optional_text("request_id", longest=MAX_TEXT),
        frequency_hz=given.number("frequency_hz", least=FREQUENCY_HZ[0], most=FREQUENCY_HZ[1]),
        amplitude_mm=given.number("excitation_amplitude_mm", least=AMPLITUDE_MM[0], most=AMPLITUDE_MM[1]),
        phase_rad=given.number("phase_rad", least=PHASE_RAD[0], most=PHASE_RAD[1]),
        group=group,
        exposure_s=given.number("exposure_s", least=EXPOSURE_S[0], most=EXPOSURE_S[1]),
    )
