"""What a plan is made of: the values that the engine works through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from labdaemon.capture.lamp import LightRequest

PhaseKind = Literal["sharp", "steps", "dwell", "sweep", "resonance", "external", "pause"]
OnFault = Literal["retry", "skip", "pause", "abort"]


@dataclass(frozen=True, slots=True)
class Shot:
    """One planned capture of a step.

    Attributes
    ----------
    exposure_s
        The camera's own step that was chosen.
    cycles
        Excitation cycles in it, None at rest or when the frequency is unknown.
    phase_rad
        Excitation phase at which to open, None for any.
    light
        Light code to be played meanwhile, None for constant light.
    """

    exposure_s: float
    cycles: float | None = None
    phase_rad: float | None = None
    light: LightRequest | None = None


@dataclass(frozen=True, slots=True)
class LightPrecision:
    """What captures under coded light will know of the largest motion that is expected (`labdaemon.blur.predict_sd`).

    Attributes
    ----------
    amplitude_px, amplitude_mm
        The motion's semi-amplitude.
    sd_amplitude_px, sd_amplitude_mm
        Standard deviation of it, median over the motion's phases.
    sd_phase_rad, worst_sd_phase_rad
        Standard deviation of the phase, median and largest over the motion's phases.
    twin_sd
        Distance to the nearest other motion that could be taken for it, standard deviations.
    """

    amplitude_px: float
    amplitude_mm: float
    sd_amplitude_px: float
    sd_amplitude_mm: float
    sd_phase_rad: float
    worst_sd_phase_rad: float
    twin_sd: float


@dataclass(frozen=True, slots=True)
class SettleRule:
    """When table and structure count as settled."""

    max_change_per_cycle: float = 0.001
    timeout_s: float = 60.0
    damping_ratio: float = 0.01
    """Assumed for the wait ln(1000)/(ζ·2πf) when there is no response gauge."""


@dataclass(frozen=True, slots=True)
class Step:
    """One excitation setting (or a rest, a wait, a pause) and the captures taken in it.

    `index` counts over the whole campaign from 0; `phase` is the place of the ``[[phase]]`` it came from. `label` is
    unique in the campaign, sorts by index and can name a folder.
    """

    index: int
    phase: int
    kind: PhaseKind
    label: str
    frequency_hz: float | None
    amplitude_mm: float | None
    shots: tuple[Shot, ...]
    grouped: bool
    """Shots at several phases are measured jointly and reported once."""
    settle: SettleRule
    on_fault: OnFault
    predicted_s: float
    predicted_bytes: int
    hold_s: float = 0.0
    """Time held before the shots of a dwell, longest wait for an outside system, or length of a pause (0: until
    resumed)."""
    not_before: str | None = None
    not_after: str | None = None
    """Time window of the day as HH:MM (local time) in which the step may start, it may span midnight; None for any."""
    sharp_set: str = ""
    """The sharp set that a sharp step takes, or that other steps' captures are measured against; empty for the flat
    one."""
    at_rest: bool = True
    """False for a sharp set of a structure that never rests."""
    precision: LightPrecision | None = None
    """Of captures under coded light."""
    search: int | None = None
    """Number of the search for modes that it belongs to, from 0 in each campaign; None for other steps."""

    @property
    def is_open(self) -> bool:
        """Whether its excitation is decided when its turn comes."""
        return self.search is not None and self.frequency_hz is None


@dataclass(frozen=True, slots=True)
class SearchPlan:
    """A search for modes: a series of steps whose first ones are planned and the others decided on the way.

    A sweep that a dwell at peaks follows is one as well: all of its steps are planned, and its modes are decided when
    it has ended.

    Attributes
    ----------
    number
        From 0 in each campaign.
    band_hz
        Where natural frequencies are searched.
    sd_frequency, sd_damping
        Relative standard deviations wanted.
    most_steps
        Steps at most.
    amplitude_mm, largest_mm
        Largest amplitude of the table, and of any target as far as the model can predict it; None for no limit.
    settle
        Rule of its steps.
    source
        Number of the search whose modes are visited one after the other; None for one that finds them itself.
    hold_s
        Time to hold each mode that is visited.
    sweep
        Place of the ``[[phase]]`` of kind sweep whose steps are looked at; None for other searches.
    make_step
        An open step with the frequency (Hz), the amplitude (mm) and the hold (s) that were decided, checked against
        the rig as every step; raises `LimitError`.
    """

    number: int
    band_hz: tuple[float, float]
    sd_frequency: float
    sd_damping: float
    most_steps: int
    amplitude_mm: float
    largest_mm: float | None
    settle: SettleRule
    make_step: Callable[[Step, float, float, float], Step]
    source: int | None = None
    hold_s: float = 0.0
    sweep: int | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """A campaign, checked against the rig, step by step."""

    name: str
    steps: tuple[Step, ...]
    toml: str
    """The campaign's text as submitted."""
    digest: str
    """SHA-256 of text and of the parts of the rig it was planned for: resuming under another is refused."""
    notes: tuple[str, ...] = ()
    """What a person should know before it runs."""
    searches: tuple[SearchPlan, ...] = ()
    """Searches for modes, by their number."""

    @property
    def predicted_s(self) -> float:
        """Expected duration."""
        return sum(step.predicted_s for step in self.steps)

    @property
    def predicted_bytes(self) -> int:
        """Expected disk use."""
        return sum(step.predicted_bytes for step in self.steps)
