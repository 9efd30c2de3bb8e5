"""The rendered cases: one set-up each, all after that of McCarthy 2016 (D80, 24 mm, f/32, ISO 100, 1 m away)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

TEXTURE, TEXTURE_LENGTH_MM = 0.004, 0.3
"""Relative sd of the paper texture and its correlation length."""

BASE: Mapping[str, Any] = {
    "cameras": 1,
    "size": "d80",
    "targets": 42,
    "diameters_mm": (5.0, 8.0, 12.0),
    "amplitude_mm": (0.1, 12.0),
    "survey_sd_mm": 0.05,
    "texture": TEXTURE,
    "texture_length_mm": TEXTURE_LENGTH_MM,
    "nef": True,
}
"""Whole cycles, straight motion, sizes and amplitudes mixed: what the figures of merit are taken from."""


SIGN_CYCLES = 5.5
"""Cycles in the exposure from which signs are read."""


@dataclass(frozen=True, slots=True)
class AccuracyCase:
    """A folder to render and measure.

    Attributes
    ----------
    key, title
        For the machine and for the reader.
    options
        For the folder maker, on top of `BASE`.
    paper
        Whether the method of McCarthy 2016 is run on it as well.
    pooled
        Whether it counts for the pooled figures.
    phased
        Whether a and b carry the phase: their standard deviations then say nothing of the major axis' length alone.
    """

    key: str
    title: str
    options: Mapping[str, Any] = field(default_factory=dict)
    paper: bool = False
    pooled: bool = False
    phased: bool = False

    def folder_options(self, seed: int) -> dict[str, Any]:
        """All options for the folder maker."""
        return {**BASE, **self.options, "seed": seed}


def cases(quick: bool) -> list[AccuracyCase]:
    """The whole programme, or in a hurry one frame of what matters most.

    Parameters
    ----------
    quick
        One capture a case, and only the cases that have a goal of their own.
    """
    captures = 1 if quick else 4
    few = 1 if quick else 2
    quarter = math.pi / 2.0
    orbit = {"orbit": 0.5, "diameters_mm": (8.0,), "amplitude_mm": (0.3, 3.0), "captures": few}
    phase = {"diameters_mm": (8.0,), "amplitude_mm": (0.75, 0.85), "exposure_s": 1.1, "captures": few}
    signs = {"diameters_mm": (8.0,), "amplitude_mm": (0.2, 3.0), "exposure_s": SIGN_CYCLES / 5.0, "in_phase": True}
    part = {"diameters_mm": (8.0,), "amplitude_mm": (0.3, 3.0), "exposure_s": 1.074, "captures": few}
    programme = [
        AccuracyCase("pooled", "5, 8 and 12 mm pooled", {"captures": captures}, paper=True, pooled=True),
        AccuracyCase("orbit", "orbits, minor axis half the major", orbit),
        AccuracyCase(
            "phase", "phase, 0.8 mm, 5.5 cycles, 2 captures", {**phase, "phase_rad": (0.0, quarter)}, phased=True
        ),
        AccuracyCase("part-known", "5.37 cycles, window known", {**part, "tell": "all"}),
        AccuracyCase("part-unknown", "5.37 cycles, phase unknown", {**part, "tell": "window"}),
        AccuracyCase("signs", "signs, 5.5 cycles, phase unknown", {**signs, "tell": "window", "captures": captures}),
        AccuracyCase("gaussian", "Gaussian optics", {"captures": captures, "gaussian_optics": True}),
    ]
    if quick:
        return programme
    more = {"captures": few}
    return [
        *programme,
        AccuracyCase("still", "labels that stay behind", {**more, "still_paper": True}),
        AccuracyCase("dim", "a quarter of the light", {**more, "white_dn": 725.0, "sharp_white_dn": 725.0}),
        AccuracyCase("clipped", "paper clipped in green", {**more, "white_dn": 4800.0}),
        AccuracyCase("noisy", "28 e- read noise", {**more, "read_noise_e": 28.0}),
        AccuracyCase("slope", "light falling by half", {**more, "gradient": (0.5, 0.3)}),
        AccuracyCase("smooth", "paper without texture", {**more, "texture": 0.0}),
        AccuracyCase("defocus", "out of focus by 1.5 px", {**more, "defocus_px": 1.5}),
        AccuracyCase("shaken", "frame shifted by 0.7 px", {**more, "camera_shift_px": 0.7}),
    ]
