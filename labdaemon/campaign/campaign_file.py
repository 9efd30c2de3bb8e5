"""The campaign file: what a person writes, checked for sense by itself (the table's limits come with the plan).

.. code-block:: toml

    name = "three-modes"
    [[phase]]
    kind = "sharp"
    frames = 3
    [[phase]]
    kind = "steps"
    frequency_hz = [5.0, 8.0, 12.0]
    amplitude_mm = [2.0, 1.0, 0.5]

Amplitudes are the table's, zero to peak. Every quantity's name ends in its unit.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from labdaemon.campaign import steps
from labdaemon.campaign.steps import OnFault
from labdaemon.errors import ConfigError, UsageError
from labdaemon.tomlfile import TomlSection, parse_model, parse_toml, read_toml

MAX_STEPS = 20_000
"""A campaign of more steps than this is a typing error."""

PositiveHz = Annotated[float, Field(gt=0, le=1000, strict=True)]
Amplitude = Annotated[float, Field(ge=0, le=1000, strict=True)]
Exposure = Annotated[float, Field(gt=0, le=900, strict=True)]
Seconds = Annotated[float, Field(gt=0, le=7 * 86400, strict=True)]
Captures = Annotated[int, Field(ge=1, le=1000, strict=True)]
Repeats = Annotated[int, Field(ge=1, le=10_000, strict=True)]
Phase = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi, strict=True)]
CodeName = Annotated[str, Field(min_length=1, max_length=64)]
Levels = Annotated[tuple[Annotated[float, Field(ge=0, le=1)], ...], Field(min_length=2, max_length=64)]
Light = CodeName | Levels | Annotated[tuple[CodeName | Levels, ...], Field(min_length=1, max_length=16)]
TimeOfDay = Annotated[str, Field(pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$")]


class SettleSection(TomlSection):
    """When table and structure count as settled; see `labdaemon.campaign.steps.SettleRule`."""

    max_change_per_cycle: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.001
    timeout_s: Annotated[float, Field(gt=0, le=3600, strict=True)] = 60.0
    damping_ratio: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.01

    def value(self) -> steps.SettleRule:
        """The same as the plan carries it."""
        return steps.SettleRule(self.max_change_per_cycle, self.timeout_s, self.damping_ratio)


class Spacing(TomlSection):
    """A ladder of frequencies: ``{ start = 4, stop = 14, count = 21, spacing = "log" }``, both ends included."""

    start: PositiveHz
    stop: PositiveHz
    count: Annotated[int, Field(ge=1, le=MAX_STEPS, strict=True)]
    spacing: Literal["linear", "log"] = "linear"

    def values(self) -> tuple[float, ...]:
        """The frequencies in order, hertz."""
        if self.count == 1:
            return (self.start,)
        parts = [place / (self.count - 1) for place in range(self.count)]
        if self.spacing == "log":
            inner = [self.start * (self.stop / self.start) ** part for part in parts]
        else:
            inner = [self.start + (self.stop - self.start) * part for part in parts]
        return (self.start, *inner[1:-1], self.stop)


def _phases_differ(phases: tuple[float, ...]) -> tuple[float, ...]:
    turns = sorted(phase % (2 * math.pi) for phase in phases)
    gaps = [after - before for before, after in itertools.pairwise([*turns, turns[0] + 2 * math.pi])]
    if len(turns) > 1 and min(gaps) < 1e-3:
        raise ValueError("two of the phases are the same")
    return phases


Phases = Annotated[tuple[Phase, ...], Field(min_length=1, max_length=16), AfterValidator(_phases_differ)]
"""Excitation phases of a group of captures, no two the same."""


class PhaseSection(TomlSection):
    """What every phase may say."""

    label: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")] | None = None
    """Part of the names of its captures; by default the kind."""
    on_fault: OnFault = "retry"
    repeats: Repeats = 1
    not_before: TimeOfDay | None = None
    not_after: TimeOfDay | None = None
    """Window of the day, local time, in which its steps may start; it may span midnight."""

    @model_validator(mode="after")
    def _window_has_length(self) -> PhaseSection:
        if self.not_before is not None and self.not_before == self.not_after:
            raise ValueError("not_before and not_after are the same time, so it could never start")
        return self


class SharpPhase(PhaseSection):
    """Frames at rest, which everything after is measured against; averaged over `frames`."""

    kind: Literal["sharp"]
    frames: Annotated[int, Field(ge=1, le=100, strict=True)] = 3
    exposure_s: Exposure = 1.0
    at_rest: bool = True
    """False for a structure that never rests, taken with a fast shutter: shape and name only."""
    every_steps: Annotated[int, Field(ge=1, strict=True)] | None = None
    """Take a new set after each so many later steps."""
    every_s: Seconds | None = None
    """Take a new set whenever so much (planned) time has passed since the last one."""


class ShakingPhase(PhaseSection):
    """What the phases share that set the shaker."""

    captures: Captures = 1
    exposure_s: Exposure = 1.0
    phase_rad: Phases | None = None
    """Excitation phases at which to open, one capture at each, measured jointly."""
    settle: SettleSection = SettleSection()
    light: Light | None = None
    """Code of the lamp, by name, bits or brightnesses; a list of them is one capture for each, measured jointly."""
    light_phase_rad: Phase = 0.0
    """Excitation phase at which the code's first sector begins."""
    expected_mm: Annotated[float, Field(gt=0, le=1000, strict=True)] | None = None
    """Largest semi-amplitude that is expected on the structure, to predict with; the table's by default."""
    both_directions: bool = False
    """Take the frequencies up and then down again (a nonlinear structure answers differently)."""

    @field_validator("light")
    @classmethod
    def _codes_are_known(cls, light: Light | None) -> Light | None:
        if light is not None:
            codes(light)
        return light

    @model_validator(mode="after")
    def _light_or_phases(self) -> ShakingPhase:
        if self.light is not None and self.phase_rad is not None:
            raise ValueError("light and phase_rad are given: under a light code the opening's phase does not matter")
        if self.light is None and {"light_phase_rad", "expected_mm"} & self.model_fields_set:
            raise ValueError("light_phase_rad and expected_mm belong to a light code, and light is not given")
        return self

    @property
    def light_codes(self) -> tuple[tuple[float, ...], ...]:
        """Brightness of each code of a group; empty under constant light."""
        return codes(self.light) if self.light is not None else ()


class StepsPhase(ShakingPhase):
    """Excitations one after the other, each settled and then captured."""

    kind: Literal["steps"]
    frequency_hz: PositiveHz | Annotated[tuple[PositiveHz, ...], Field(min_length=1, max_length=MAX_STEPS)] | Spacing
    amplitude_mm: Amplitude | Annotated[tuple[Amplitude, ...], Field(min_length=1, max_length=MAX_STEPS)]

    @model_validator(mode="after")
    def _one_amplitude_each(self) -> StepsPhase:
        count = len(frequencies(self.frequency_hz))
        if isinstance(self.amplitude_mm, tuple) and len(self.amplitude_mm) != count:
            raise ValueError(
                f"{len(self.amplitude_mm)} values of amplitude_mm for {count} of frequency_hz: one or {count}"
            )
        return self


_LEVELS = ("amplitude_mm", "velocity_mm_s", "acceleration_mm_s2")


class SweepPhase(ShakingPhase):
    """A stepped sine sweep: from frequency to frequency without coming to rest in between.

    The table's amplitude is given, or falls with frequency so that its velocity or acceleration stays the same.
    """

    kind: Literal["sweep"]
    frequency_hz: Spacing
    amplitude_mm: Amplitude | None = None
    velocity_mm_s: Annotated[float, Field(gt=0, le=1e5, strict=True)] | None = None
    acceleration_mm_s2: Annotated[float, Field(gt=0, le=1e6, strict=True)] | None = None

    @model_validator(mode="after")
    def _one_level(self) -> SweepPhase:
        if sum(getattr(self, name) is not None for name in _LEVELS) != 1:
            raise ValueError(f"give exactly one of {', '.join(_LEVELS)}")
        return self

    @property
    def level_key(self) -> str:
        """Which of the three was given."""
        return next(name for name in _LEVELS if getattr(self, name) is not None)

    def amplitude_at(self, frequency_hz: float) -> float:
        """The table's semi-amplitude at this frequency, millimetres: A, v/(2πf) or a/(2πf)²."""
        omega = 2 * math.pi * frequency_hz
        if self.velocity_mm_s is not None:
            return self.velocity_mm_s / omega
        if self.acceleration_mm_s2 is not None:
            return self.acceleration_mm_s2 / omega**2
        return self.amplitude_mm or 0.0


class ResonancePhase(ShakingPhase):
    """A closed-loop sweep: finds the modes of a band, each step where it gives most information, until they are known.

    A first sweep over the band comes first; each further frequency is decided from all envelopes so far.
    """

    kind: Literal["resonance"]
    band_hz: tuple[PositiveHz, PositiveHz]
    amplitude_mm: Annotated[float, Field(gt=0, le=1000, strict=True)]
    """Largest amplitude of the table, that of the first sweep."""
    largest_mm: Annotated[float, Field(gt=0, le=1000, strict=True)] | None = None
    """Largest semi-amplitude wanted of any target: the table's is lowered where the model predicts more."""
    sd_frequency: Annotated[float, Field(ge=1e-7, le=0.1, strict=True)] = 2e-5
    sd_damping: Annotated[float, Field(ge=1e-4, le=0.5, strict=True)] = 0.008
    """Relative standard deviations wanted of each natural frequency and damping ratio."""
    most_steps: Annotated[int, Field(ge=8, le=1000, strict=True)] = 100

    @field_validator("band_hz")
    @classmethod
    def _band_has_width(cls, band_hz: tuple[float, float]) -> tuple[float, float]:
        if not band_hz[1] > 1.05 * band_hz[0]:
            raise ValueError("the band's upper end must lie at least 5 % above its lower end")
        return band_hz

    @model_validator(mode="after")
    def _one_capture_a_step(self) -> ResonancePhase:
        if self.captures != 1 or self.both_directions:
            raise ValueError("captures and both_directions do not belong here: the search chooses what to repeat")
        return self


class DwellPhase(ShakingPhase):
    """One excitation held for a time, then captured; with `repeats`, watched over hours."""

    kind: Literal["dwell"]
    frequency_hz: PositiveHz | None = None
    at: Literal["peaks"] | None = None
    """At each natural frequency that the `resonance` or `sweep` phase before it found, instead of `frequency_hz`."""
    most_peaks: Annotated[int, Field(ge=1, le=100, strict=True)] = 8
    amplitude_mm: Amplitude
    hold_s: Seconds

    @model_validator(mode="after")
    def _one_place(self) -> DwellPhase:
        if (self.frequency_hz is None) == (self.at is None):
            raise ValueError('give either frequency_hz or at = "peaks"')
        if self.at is None and "most_peaks" in self.model_fields_set:
            raise ValueError('most_peaks belongs to at = "peaks"')
        if self.at is not None and self.captures > 1 and (self.light is not None or self.phase_rad is not None):
            raise ValueError('at = "peaks" takes one group of captures at each; use repeats for more')
        return self


class ExternalPhase(PhaseSection):
    """Captures that an outside system fires; ends when all came or `wait_s` is over."""

    kind: Literal["external"]
    captures: Captures = 1
    exposure_s: Exposure = 1.0
    wait_s: Seconds = 3600.0
    frequency_hz: PositiveHz | None = None
    amplitude_mm: Amplitude | None = None
    """What the outside system does, if it is known."""
    phase_rad: Phases | None = None
    """Excitation phases at which it opens, one release at each in this order, measured jointly."""


class PausePhase(PhaseSection):
    """Rest for a time, or until a person says `resume` when no `duration_s` is given."""

    kind: Literal["pause"]
    duration_s: Seconds | None = None


AnyPhase = Annotated[
    SharpPhase | StepsPhase | SweepPhase | ResonancePhase | DwellPhase | ExternalPhase | PausePhase,
    Field(discriminator="kind"),
]


class CampaignSection(TomlSection):
    """The whole file."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}$")]
    notes: Annotated[str, Field(max_length=10_000)] = ""
    repeats: Repeats = 1
    """How often the whole list of phases runs."""
    phase: Annotated[tuple[AnyPhase, ...], Field(min_length=1, max_length=1000)]

    def leads_to_peaks(self, place: int) -> bool:
        """Whether a dwell at peaks takes its modes from this phase: no other sweep or search comes before the dwell."""
        for phase in self.phase[place + 1 :]:
            if isinstance(phase, ResonancePhase | SweepPhase):
                return False
            if isinstance(phase, DwellPhase) and phase.at is not None:
                return True
        return False


@dataclass(frozen=True, slots=True)
class Campaign:
    """A campaign file as read.

    Attributes
    ----------
    section
        Its content.
    toml
        Its text, kept with the campaign.
    source
        Where it came from, for messages; None when it came over the wire.
    """

    section: CampaignSection
    toml: str
    source: Path | None = None

    @property
    def name(self) -> str:
        """The campaign's name."""
        return self.section.name


def load_campaign(source: str | Path) -> Campaign:
    """Read a campaign from a file (a `Path`) or from its text (a `str`).

    Raises
    ------
    ConfigError
        Names the file and the key's path, as ``phase[1].amplitude_mm``.
    """
    if isinstance(source, Path):
        text, data = read_toml(source)
        where: Path | None = source
    else:
        text, data, where = source, parse_toml(source, source="campaign"), None
    shown = where or "campaign"
    phases: Any = data.get("phase")
    if isinstance(phases, dict):
        raise ConfigError("is one table; write [[phase]] with double brackets", source=shown, key="phase")
    return Campaign(parse_model(CampaignSection, data, source=shown), text, where)


def frequencies(given: float | tuple[float, ...] | Spacing) -> tuple[float, ...]:
    """The frequencies of a phase in the order in which they run upwards, hertz."""
    if isinstance(given, Spacing):
        return given.values()
    return given if isinstance(given, tuple) else (given,)


def codes(light: Light) -> tuple[tuple[float, ...], ...]:
    """Brightness of each code that a phase names, one for each capture of a group.

    Raises
    ------
    ValueError
        One is no code.
    """
    # Loaded where a campaign has light: the daemon's start must not wait for what measuring needs.
    from labdaemon.blur import named_code

    is_list = isinstance(light, tuple) and not all(isinstance(value, float) for value in light)
    given = light if is_list else (light,)
    try:
        return tuple(named_code(one) for one in given)  # type: ignore[arg-type]
    except UsageError as exc:
        raise ValueError(str(exc)) from None
