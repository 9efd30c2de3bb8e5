"""What a person says of the exposures of `labdaemon measure`: the keys of `capture.toml` as options."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
from pydantic import ValidationError

from labdaemon.blur import ExposureWindow
from labdaemon.errors import UsageError
from labdaemon.processing import CaptureFile

_OPTIONS = {
    "frequency_hz": "--frequency",
    "exposure_s": "--exposure",
    "phase_rad": "--phase",
    "light_phase_rad": "--light-phase",
    "light_cycles": "--light-cycles",
    "ambient": "--ambient",
}
"""Option of each key of `capture.toml`."""
_OF_CODE = ("light_phase_rad", "light_cycles", "ambient")

Command = TypeVar("Command", bound=Callable[..., Any])


def exposure_options(command: Command) -> Command:
    """Add the options to a command, under the names of the keys of `capture.toml`."""
    positive, least = click.FloatRange(min=0, min_open=True), click.FloatRange(min=0)
    options = [
        click.option("--frequency", "frequency_hz", type=positive, help="Of the excitation, hertz."),
        click.option("--exposure", "exposure_s", type=positive, help="True exposure time, seconds."),
        click.option(
            "--phase",
            "phase_rad",
            type=float,
            multiple=True,
            help="Excitation phase at the opening, radians; one for each BLURRED frame measures them jointly.",
        ),
        click.option(
            "--light",
            "light",
            multiple=True,
            help="Code of the lamp, as 1110100 or cos; one for each BLURRED frame measures them jointly.",
        ),
        click.option(
            "--light-phase", "light_phase_rad", type=float, help="Excitation phase at which the code begins, radians."
        ),
        click.option("--light-cycles", type=click.IntRange(min=1), help="Whole cycles of the code in the exposure."),
        click.option("--ambient", type=least, help="Light that is always on, in parts of the lamp's."),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def exposure_windows(
    blurred: Sequence[Path], phase_rad: Sequence[float], light: Sequence[str], **stated: float | None
) -> tuple[list[ExposureWindow | None], bool]:
    """What is known of each blurred frame's exposure, and whether the frames are one group.

    Parameters
    ----------
    blurred
        The frames.
    phase_rad, light
        None, one for all frames, or one for each frame of a group.
    **stated
        Further keys of `capture.toml`; None for those not given.

    Raises
    ------
    UsageError
        Options that contradict each other, or are missing.
    """
    for option, given in (("--phase", phase_rad), ("--light", light)):
        if len(given) > 1 and len(given) != len(blurred):
            raise UsageError(f"{len(given)} {option} for {len(blurred)} blurred frames: give one, or one for each")
    windows = [
        _window(
            {
                **{key: value for key, value in stated.items() if value is not None},
                **_of_frame("phase_rad", phase_rad, index),
                **_of_frame("light", light, index),
            }
        )
        for index in range(len(blurred))
    ]
    return windows, max(len(phase_rad), len(light)) > 1


def _of_frame(key: str, given: Sequence[float] | Sequence[str], index: int) -> dict[str, float | str]:
    return {key: given[index if len(given) > 1 else 0]} if given else {}


def _window(stated: dict[str, Any]) -> ExposureWindow | None:
    if "light" not in stated:
        idle = next((_OPTIONS[key] for key in _OF_CODE if key in stated), None)
        if idle is not None:
            raise UsageError(f"{idle} is given, but no code: give --light, or leave it out")
        missing = [key for key in ("frequency_hz", "exposure_s") if key not in stated]
        if stated and missing:
            option = _OPTIONS[missing[0]]
            raise UsageError(f"{option} is missing: an exposure is known by frequency and exposure time together")
    try:
        return CaptureFile.model_validate(stated).window("")
    except ValidationError as exc:
        message = exc.errors()[0]["msg"].removeprefix("Value error, ")
        named = re.sub("|".join(_OPTIONS), lambda key: _OPTIONS[key[0]], message)
        raise UsageError(re.sub(r"^light\b", "--light", named)) from None
