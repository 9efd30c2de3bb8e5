"""What is known of an exposure: by its capture file, or by the time that the camera wrote into the frame's file."""

from __future__ import annotations

import math
from pathlib import Path

from labdaemon.blur import ExposureWindow
from labdaemon.imaging import exposure_of
from labdaemon.processing.folder import CaptureFile

SHUTTER_SD = 0.02
"""Relative standard deviation of a shutter's nominal time. Trial: bodies whose time was measured."""
NOMINAL_S = (
    0.3,
    0.4,
    0.5,
    0.6,
    0.8,
    1.0,
    1.3,
    1.6,
    2.0,
    2.5,
    3.0,
    4.0,
    5.0,
    6.0,
    8.0,
    10.0,
    13.0,
    15.0,
    20.0,
    25.0,
    30.0,
)
"""Times that cameras write for their steps of a third of a stop; the shutter is open for a power of 2^(1/3)."""


def exposure_window(about: CaptureFile, camera: str, frame: Path) -> ExposureWindow | None:
    """What is known of an exposure: by its capture file, else with the time that the camera wrote into the frame.

    Parameters
    ----------
    about
        The capture file's content.
    camera, frame
        The camera and its file.
    """
    stated = about.window(camera)
    if stated is not None or about.frequency_hz is None:
        return stated
    nominal_s = exposure_of(frame)
    if nominal_s is None or not nominal_s > 0:
        return None
    exposure_s = true_exposure_s(nominal_s)
    return ExposureWindow(
        about.frequency_hz, exposure_s, about.phase_rad, about.sd_phase_rad, sd_exposure_s=SHUTTER_SD * exposure_s
    )


def true_exposure_s(nominal_s: float) -> float:
    """How long the shutter is open for a time as cameras write it: 1/3 s, 0.3 s and 10/30 s are 2^(−5/3) s."""
    named = [*NOMINAL_S, 1 / 1.3, 1 / 1.6, 1 / 2.5, *(1 / n for n in (2, 3, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30))]
    if any(math.isclose(nominal_s, one, rel_tol=2e-3) for one in named):
        return float(2 ** (round(3 * math.log2(nominal_s)) / 3))
    return nominal_s
