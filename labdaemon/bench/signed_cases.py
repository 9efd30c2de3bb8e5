"""The rendered cases of signed motions: coded light in one camera and in two, and part cycles in two captures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

SEVEN = (1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0)
"""On–off code of seven sectors; one pin of the trigger box plays it."""

CYCLES, EXPOSED_CYCLES = 4, 5
"""Whole cycles of the code, and cycles of the open shutter: it opens at any phase."""

WHITE_DN = 2900.0
"""What paper reads in green in all frames: the lamp is as bright as that needs."""

_MIDDLES = [(index + 0.5) * 2 * math.pi / 64 for index in range(64)]
COSINE = tuple((1 + math.cos(angle)) / 2 for angle in _MIDDLES)
SINE = tuple((1 + math.sin(angle)) / 2 for angle in _MIDDLES)


@dataclass(frozen=True, slots=True)
class SignedCase:
    """A folder to render and measure.

    Attributes
    ----------
    key, title
        For the machine and for the reader.
    codes
        Of the lamp, one a capture of each group; empty for constant light.
    ambient
        The room's light in parts of the lamp's.
    options
        For the folder maker.
    goal_deg
        Largest median standard deviation of the phase; NaN for none.
    """

    key: str
    title: str
    codes: tuple[tuple[float, ...], ...] = ()
    ambient: float = 0.0
    options: Mapping[str, Any] = field(default_factory=dict)
    goal_deg: float = math.nan
    diameter_mm: float = 8.0

    @property
    def light_fraction(self) -> float:
        """Mean light of an exposure, in parts of the lamp's full brightness."""
        if not self.codes:
            return 1.0
        return sum(self.codes[0]) / len(self.codes[0]) * CYCLES / EXPOSED_CYCLES + self.ambient

    @property
    def white_dn(self) -> float:
        """Paper white under the lamp at full brightness."""
        return WHITE_DN / self.light_fraction

    def folder_options(self, seed: int) -> dict[str, Any]:
        """All options for the folder maker."""
        coded: dict[str, Any] = {}
        if self.codes:
            coded = {
                "light": self.codes,
                "light_phase_rad": 0.4,
                "ambient": self.ambient,
                "lamp_rise_s": 1e-4,
                "white_dn": self.white_dn,
                "exposure_s": EXPOSED_CYCLES / 5.0,
            }
        return {"cameras": 1, "size": "d80", "diameters_mm": (self.diameter_mm,), **coded, **self.options, "seed": seed}


def signed_cases(quick: bool) -> list[SignedCase]:
    """All cases.

    Parameters
    ----------
    quick
        One capture a case and fewer targets.
    """
    size = {"targets": 24 if quick else 42, "captures": 1 if quick else 2}
    # The lens for which the goals were computed. Through f/32 the bound itself is above the goal, so that row has none.
    diffracted = {**size, "amplitude_mm": (0.799, 0.801)}
    three_px = {**diffracted, "gaussian_optics": True}
    space = {**size, "cameras": 2, "amplitude_mm": (0.8, 3.0)}
    windows = {**size, "phase_rad": (0.0, math.pi / 2), "exposure_s": 1.1, "amplitude_mm": (0.8, 3.0)}
    return [
        SignedCase("code", "code 1110100, 0.8 mm, ambient 0 %, lens 0.8 px", (SEVEN,), 0.0, three_px, 0.4),
        SignedCase("code-30", "code 1110100, 0.8 mm, ambient 30 %, lens 0.8 px", (SEVEN,), 0.3, three_px, 0.6),
        SignedCase("code-100", "code 1110100, 0.8 mm, ambient 100 %, lens 0.8 px", (SEVEN,), 1.0, three_px, 1.0),
        SignedCase("code-f32", "code 1110100, 0.8 mm, ambient 0 %, diffraction at f/32", (SEVEN,), 0.0, diffracted),
        SignedCase("pair", "cosine and sine, 0.8 mm, lens 0.8 px", (COSINE, SINE), 0.0, three_px, 0.22),
        SignedCase("space", "two cameras, 0.8 to 3 mm, ambient 10 %", (SEVEN,), 0.1, space),
        SignedCase("level", "two cameras, level motion", (SEVEN,), 0.0, {**space, "level": True}),
        SignedCase("mode", "two cameras, level, one phase", (SEVEN,), 0.0, {**space, "level": True, "in_phase": True}),
        SignedCase(
            "windows", "5.5 cycles twice, 0.8 to 3 mm", (), 0.0, {**size, **windows, "amplitude_mm": (0.8, 3.0)}
        ),
    ]
