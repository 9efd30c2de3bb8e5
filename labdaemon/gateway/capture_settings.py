"""What a client states of its captures: set by ``CAPTure:…``, sent with each ``TRIGger`` until changed or ``*RST``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from labdaemon.campaign.manual_request import AMPLITUDE_MM, EXPOSURE_S, FREQUENCY_HZ, MAX_TEXT, PHASE_RAD
from labdaemon.gateway.scpi_errors import ScpiError
from labdaemon.gateway.scpi_syntax import number, quoted, read_flag, read_number, read_text

UNSET = frozenset({"NONE", "DEF", "DEFAULT"})
"""Words that take a statement back."""


@dataclass(frozen=True, slots=True)
class StatedParameter:
    """One parameter of the command `capture`.

    Attributes
    ----------
    name
        In the command.
    read
        From a client's parameter.
    write
        To the answer of the query.
    bounds
        Smallest and largest number; None where it is none.
    """

    name: str
    read: Callable[[str], Any]
    write: Callable[[Any], str]
    bounds: tuple[float, float] | None = None


def _number_in(units: dict[str, float]) -> Callable[[str], float]:
    return lambda parameter: read_number(parameter, units)


PARAMETERS = {
    "FREQuency": StatedParameter("frequency_hz", _number_in({"HZ": 1.0, "KHZ": 1e3}), number, FREQUENCY_HZ),
    "AMPLitude": StatedParameter(
        "excitation_amplitude_mm", _number_in({"MM": 1.0, "UM": 1e-3, "M": 1e3}), number, AMPLITUDE_MM
    ),
    "PHASe": StatedParameter("phase_rad", _number_in({"RAD": 1.0, "DEG": math.pi / 180.0}), number, PHASE_RAD),
    "EXPosure": StatedParameter("exposure_s", _number_in({"S": 1.0, "MS": 1e-3, "US": 1e-6}), number, EXPOSURE_S),
    "GROup": StatedParameter("group", read_text, lambda value: quoted(value or "")),
    "LABel": StatedParameter("label", read_text, lambda value: quoted(value or "")),
    "SHARp": StatedParameter("sharp", read_flag, lambda value: "1" if value else "0"),
}
"""Mnemonic under ``CAPTure`` -> parameter. The daemon checks values again; here a client learns of them at once."""


class CaptureSettings:
    """The statements of one client."""

    def __init__(self) -> None:
        self._stated: dict[str, Any] = {}

    def clear(self) -> None:
        """As after ``*RST``: nothing is stated."""
        self._stated.clear()

    def set(self, parameter: StatedParameter, written: str) -> None:
        """State one, or take it back by ``NONE``.

        Raises
        ------
        ScpiError
            It has another type, unit or range.
        """
        if written.upper() in UNSET:
            self._stated.pop(parameter.name, None)
            return
        value = parameter.read(written)
        if parameter.bounds is not None and not parameter.bounds[0] <= value <= parameter.bounds[1]:
            least, most = parameter.bounds
            raise ScpiError(-222, f"{parameter.name} is a number from {least:g} to {most:g}")
        if isinstance(value, str) and len(value) > MAX_TEXT:
            raise ScpiError(-223, f"{parameter.name} is a text of at most {MAX_TEXT} characters")
        if value == "":
            self._stated.pop(parameter.name, None)
            return
        self._stated[parameter.name] = value

    def query(self, parameter: StatedParameter) -> str:
        """What is stated."""
        return parameter.write(self._stated.get(parameter.name))

    def params(self) -> dict[str, Any]:
        """Parameters of the command `capture`."""
        return dict(self._stated)
