"""Captures at one excitation, what is expected of their images, and what they are predicted to know."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from labdaemon.blur import DotImage, ExposureWindow
from labdaemon.campaign.campaign_file import StepsPhase
from labdaemon.campaign.light_plan import ImageScale
from labdaemon.campaign.steps import Step

Goal = Literal["amplitude", "phase"]


@dataclass(frozen=True, slots=True)
class Expectation:
    """What is expected of the structure and the images.

    Attributes
    ----------
    amplitudes_mm
        Semi-amplitudes over which precision is averaged.
    scale
        How large things are in the images.
    dot
        Brightness and noise of a dot's image at the campaign's own exposure; its radius comes from `scale`.
    sd_opening_s
        Standard deviation with which the opening of a shutter is measured.
    """

    amplitudes_mm: tuple[float, ...]
    scale: ImageScale
    dot: DotImage = field(default_factory=DotImage)
    sd_opening_s: float = 1e-4

    def image(self, brightness: float) -> DotImage:
        """The dot's image at so many times the brightness of the campaign's own exposure."""
        radius_px = self.scale.dot_mm / 2 * self.scale.px_per_mm
        return replace(self.dot, radius_px=radius_px, white_dn=self.dot.white_dn * brightness)


@dataclass(frozen=True, slots=True)
class GroupPrecision:
    """What one group of captures is predicted to know.

    Attributes
    ----------
    sd_amplitude_mm, sd_phase_rad
        Of one target and camera, averaged over amplitudes and phases: 1.15 times the bound, and the scatter over
        neighbouring valleys of the phase. Infinite where the images do not show it.
    seconds
        Time that the group takes, without settling.
    ambiguous
        Share of one camera's measurements that leave a twin, and are flagged.
    """

    sd_amplitude_mm: float
    sd_phase_rad: float
    seconds: float
    ambiguous: float = 0.0

    def sd(self, goal: Goal) -> float:
        """What is to be small."""
        return self.sd_amplitude_mm if goal == "amplitude" else self.sd_phase_rad

    def per_root_time(self, goal: Goal) -> float:
        """Sd × √time: what repeating the group cannot change."""
        return self.sd(goal) * math.sqrt(self.seconds)

    def repeated(self, count: int) -> GroupPrecision:
        """The same of so many groups."""
        root = math.sqrt(count)
        return GroupPrecision(
            self.sd_amplitude_mm / root, self.sd_phase_rad / root, self.seconds * count, self.ambiguous
        )


@dataclass(frozen=True, slots=True)
class CaptureDesign:
    """Captures at one excitation, as a phase of a campaign asks for them.

    Attributes
    ----------
    phase
        The phase, for this excitation alone.
    step
        What the planner makes of it: one group.
    windows
        Exposures of the group.
    precision
        Of one group.
    """

    phase: StepsPhase
    step: Step
    windows: tuple[ExposureWindow, ...]
    precision: GroupPrecision


@dataclass(frozen=True, slots=True)
class StepDesign:
    """The campaign's own captures at one excitation, and the best ones.

    Attributes
    ----------
    own, best
        Each as one group; `best` is `own` where nothing better was found.
    own_groups, best_groups
        How many of each: what the campaign asks for, and what fits into the same time.
    """

    frequency_hz: float
    amplitude_mm: float
    own: CaptureDesign
    best: CaptureDesign
    own_groups: int
    best_groups: int

    @property
    def own_precision(self) -> GroupPrecision:
        """Of all groups that the campaign asks for."""
        return self.own.precision.repeated(self.own_groups)

    @property
    def best_precision(self) -> GroupPrecision:
        """Of as many of the best groups as fit into the same time, at least one."""
        return self.best.precision.repeated(self.best_groups)
