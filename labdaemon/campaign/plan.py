"""A campaign file becomes a plan: every step with its exposures, checked against the rig before anything moves."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from labdaemon.campaign.campaign_file import (
    MAX_STEPS,
    AnyPhase,
    Campaign,
    DwellPhase,
    ExternalPhase,
    PausePhase,
    ShakingPhase,
    SharpPhase,
    StepsPhase,
    SweepPhase,
    frequencies,
)
from labdaemon.campaign.light_plan import ImageScale, LitExcitation, plan_light
from labdaemon.campaign.limits import ShakerLimits, check_amplitude, check_frequency
from labdaemon.campaign.steps import Plan, SettleRule, Shot, Step
from labdaemon.capture.exposure import choose_exposure, common_steps_s
from labdaemon.capture.lamp import Lamp
from labdaemon.capture.settle import settling_time_s
from labdaemon.errors import ConfigError, LimitError


@dataclass(frozen=True, slots=True)
class PlanRig:
    """What planning needs to know of the rig.

    Attributes
    ----------
    limits
        The table's limits; None when the rig has no shaker of ours.
    exposure_steps_s
        True exposure times each camera offers, by camera name.
    frame_bytes
        Size of one frame of each camera, by camera name.
    free_bytes
        Room for the campaign on disk; None if it is not to be checked.
    refusal
        Asks the shaker's driver why it would not set this frequency (Hz) and amplitude (mm), None if it would: its
        calibration ends somewhere, and its generator has a smallest and a largest level.
    can_fire
        False when an outside system fires the shutters.
    set_s, shot_s
        Time to set the shaker, and to fire and to fetch the files, without the exposure itself.
    digest
        Of the parts of the rig file that results depend on.
    lamp
        The lamp for coded light; None when the rig has none. One with all levels where nothing is known of it.
    scale
        How large things are in the images.
    """

    limits: ShakerLimits | None
    exposure_steps_s: Mapping[str, Sequence[float]]
    frame_bytes: Mapping[str, int] = field(default_factory=dict)
    free_bytes: int | None = None
    refusal: Callable[[float, float], str | None] = lambda frequency_hz, amplitude_mm: None
    can_fire: bool = True
    set_s: float = 2.0
    shot_s: float = 3.0
    digest: str = ""
    lamp: Lamp | None = field(default_factory=lambda: Lamp(levels=256))
    scale: ImageScale = field(default_factory=ImageScale)


def make_plan(campaign: Campaign, rig: PlanRig) -> Plan:
    """Expand a campaign and check every step.

    Parameters
    ----------
    campaign
        From `load_campaign`.
    rig
        What the rig can do.

    Returns
    -------
    Plan
        Steps in the order in which they run. Sharp sets that a schedule retakes are among them, and one before the
        first capture of a campaign that asks for none.

    Raises
    ------
    LimitError
        A step is beyond the table's stroke, velocity, acceleration, force or frequencies, no camera step lies near an
        exposure, or the disk is too small. The key says which number of the file: ``phase[2].amplitude_mm[1]``.
    ConfigError
        A phase sets the shaker or fires the shutters, and the rig has no shaker or trigger.
    """
    planner = _Planner(campaign, rig)
    steps = _with_sharp_sets(planner.drafts())
    if len(steps) > MAX_STEPS:
        raise planner.limit("phase", f"makes more than {MAX_STEPS} steps; split the campaign")
    digest = hashlib.sha256(json.dumps([campaign.toml, rig.digest]).encode()).hexdigest()
    plan = Plan(campaign.name, tuple(steps), campaign.toml, digest, tuple(planner.notes))
    if rig.free_bytes is not None and plan.predicted_bytes > rig.free_bytes:
        need, room = plan.predicted_bytes / 1e9, rig.free_bytes / 1e9
        raise planner.limit(None, f"needs {need:.2f} GB of disk where {room:.2f} GB are free; free some or plan less")
    return plan


@dataclass(frozen=True, slots=True)
class _Draft:
    """A step before it is numbered, with the schedule that its sharp set starts."""

    step: Step
    every_steps: int | None = None
    every_s: float | None = None


class _Planner:
    """Turns the phases of one campaign into drafts of steps."""

    def __init__(self, campaign: Campaign, rig: PlanRig) -> None:
        self.campaign, self.rig = campaign, rig
        self.source = campaign.source or "campaign"
        self.exposures_s = common_steps_s(rig.exposure_steps_s.values())
        self.notes: dict[str, None] = {}
        """In the order in which they came up, each once."""

    def limit(self, key: str | None, message: str) -> LimitError:
        return LimitError(message, source=self.source, key=key)

    def drafts(self) -> Iterator[_Draft]:
        count = 0
        if first := self.missing_sharp():
            yield from self.phase(*first)
        for _ in range(self.campaign.section.repeats):
            for place, phase in enumerate(self.campaign.section.phase):
                for _ in range(phase.repeats):
                    for draft in self.phase(place, phase):
                        count += 1
                        if count > MAX_STEPS:
                            raise self.limit(f"phase[{place}]", f"is beyond {MAX_STEPS} steps; split the campaign")
                        yield draft

    def missing_sharp(self) -> tuple[int, SharpPhase] | None:
        """A sharp phase for a campaign that captures before it has any: without one nothing can be measured."""
        for place, phase in enumerate(self.campaign.section.phase):
            if isinstance(phase, SharpPhase):
                return None
            if not isinstance(phase, PausePhase):
                return place, SharpPhase(kind="sharp", exposure_s=phase.exposure_s)
        return None

    def phase(self, place: int, phase: AnyPhase) -> Iterator[_Draft]:
        """Steps of one pass through one phase."""
        if isinstance(phase, SharpPhase):
            shot = self.shot(place, phase.exposure_s, None)
            yield _Draft(
                self.step(place, phase, None, None, (shot,) * phase.frames, at_rest=phase.at_rest),
                phase.every_steps,
                phase.every_s,
            )
        elif isinstance(phase, ExternalPhase):
            yield from self.external(place, phase)
        elif isinstance(phase, PausePhase):
            yield _Draft(self.step(place, phase, None, None, (), hold_s=phase.duration_s or 0.0))
        else:
            yield from self.shaking(place, phase)

    def external(self, place: int, phase: ExternalPhase) -> Iterator[_Draft]:
        """Captures that others fire: one step for all, or one for each group at several phases."""
        shot = self.shot(place, phase.exposure_s, phase.frequency_hz, half_cycles=phase.phase_rad is not None)
        groups = [(shot,) * phase.captures]
        if phase.phase_rad is not None:
            groups = [tuple(replace(shot, phase_rad=phase_rad) for phase_rad in phase.phase_rad)] * phase.captures
        for shots in groups:
            yield _Draft(self.step(place, phase, phase.frequency_hz, phase.amplitude_mm, shots, hold_s=phase.wait_s))

    def shaking(self, place: int, phase: StepsPhase | SweepPhase | DwellPhase) -> Iterator[_Draft]:
        """Steps that set the shaker: up, and down again if both directions are asked for."""
        if self.rig.limits is None:
            raise ConfigError(
                "sets the shaker, but the rig has none; use kind external", source=self.source, key=f"phase[{place}]"
            )
        if not self.rig.can_fire:
            raise ConfigError(
                "fires the shutters, but the rig has no trigger of ours; use kind external",
                source=self.source,
                key=f"phase[{place}]",
            )
        settings = list(_settings(phase))
        for frequency_hz, amplitude_mm, frequency_key, amplitude_key in settings:
            at = f"phase[{place}]."
            if crossed := check_frequency(self.rig.limits, frequency_hz):
                raise self.limit(at + frequency_key, crossed)
            if crossed := check_amplitude(self.rig.limits, frequency_hz, amplitude_mm):
                raise self.limit(at + amplitude_key, crossed)
            if refused := self.rig.refusal(frequency_hz, amplitude_mm):
                raise self.limit(at + amplitude_key, refused)
        sequence = settings + settings[-2::-1] if phase.both_directions else settings
        for frequency_hz, amplitude_mm, _, _ in sequence:
            yield from self.setting(place, phase, frequency_hz, amplitude_mm)

    def setting(
        self, place: int, phase: StepsPhase | SweepPhase | DwellPhase, frequency_hz: float, amplitude_mm: float
    ) -> Iterator[_Draft]:
        """One excitation: its captures, or one step for each group of captures at several phases."""
        hold_s = phase.hold_s if isinstance(phase, DwellPhase) else 0.0
        settle = phase.settle.value()
        if phase.light is not None:
            yield from self.lit(place, phase, frequency_hz, amplitude_mm, hold_s)
            return
        if phase.phase_rad is None:
            shots = (self.shot(place, phase.exposure_s, frequency_hz),) * phase.captures
            yield _Draft(self.step(place, phase, frequency_hz, amplitude_mm, shots, settle=settle, hold_s=hold_s))
            return
        plain = self.shot(place, phase.exposure_s, frequency_hz, half_cycles=True)
        shots = tuple(replace(plain, phase_rad=phase_rad) for phase_rad in phase.phase_rad)
        for group in range(phase.captures):
            held_s = hold_s if group == 0 else 0.0
            yield _Draft(self.step(place, phase, frequency_hz, amplitude_mm, shots, settle=settle, hold_s=held_s))

    def lit(
        self,
        place: int,
        phase: StepsPhase | SweepPhase | DwellPhase,
        frequency_hz: float,
        amplitude_mm: float,
        hold_s: float,
    ) -> Iterator[_Draft]:
        """One excitation under coded light: its captures, or one step for each group of captures with several codes."""
        expected_mm = phase.expected_mm or amplitude_mm
        lit = LitExcitation(phase.light_codes, phase.light_phase_rad, phase.exposure_s, frequency_hz, expected_mm)
        try:
            planned = plan_light(lit, self.rig.lamp, self.exposures_s, self.rig.scale)
        except (ConfigError, LimitError) as exc:
            key = f"phase[{place}]." + ("exposure_s" if isinstance(exc, LimitError) else "light")
            raise type(exc)(str(exc), source=self.source, key=key) from None
        self.notes |= dict.fromkeys(f"phase[{place}], {note}" for note in planned.notes)
        groups = [planned.shots * phase.captures] if len(planned.shots) == 1 else [planned.shots] * phase.captures
        for number, shots in enumerate(groups):
            held_s = hold_s if number == 0 else 0.0
            settle = phase.settle.value()
            step = self.step(place, phase, frequency_hz, amplitude_mm, shots, settle=settle, hold_s=held_s)
            yield _Draft(replace(step, precision=planned.precision, grouped=len(planned.shots) > 1))

    def shot(self, place: int, nominal_s: float, frequency_hz: float | None, *, half_cycles: bool = False) -> Shot:
        """The exposure that the cameras can give."""
        chosen = choose_exposure(self.exposures_s, nominal_s, frequency_hz, half_cycles=half_cycles)
        if chosen is None:
            key = f"phase[{place}].exposure_s"
            raise self.limit(key, f"no camera step lies near {nominal_s:g} s; {_offered(self.exposures_s)}")
        return Shot(chosen.exposure_s, chosen.cycles)

    def step(
        self,
        place: int,
        phase: AnyPhase,
        frequency_hz: float | None,
        amplitude_mm: float | None,
        shots: tuple[Shot, ...],
        *,
        settle: SettleRule | None = None,
        hold_s: float = 0.0,
        at_rest: bool = True,
    ) -> Step:
        settle = settle or SettleRule()
        label = (phase.label or phase.kind) + (f"-{frequency_hz:.3f}hz" if frequency_hz is not None else "")
        shooting_s = sum(shot.exposure_s + self.rig.shot_s for shot in shots)
        moving_s = 0.0
        if isinstance(phase, ShakingPhase) and frequency_hz is not None:
            moving_s = self.rig.set_s + min(settle.timeout_s, settling_time_s(frequency_hz, settle.damping_ratio))
        return Step(
            index=0,
            phase=place,
            kind=phase.kind,
            label=label,
            frequency_hz=frequency_hz,
            amplitude_mm=amplitude_mm,
            shots=shots,
            grouped=len({(shot.phase_rad, shot.light) for shot in shots}) > 1,
            settle=settle,
            on_fault=phase.on_fault,
            predicted_s=hold_s if phase.kind == "external" else moving_s + hold_s + shooting_s,
            predicted_bytes=len(shots) * sum(self.rig.frame_bytes.values()),
            hold_s=hold_s,
            not_before=phase.not_before,
            not_after=phase.not_after,
            at_rest=at_rest,
        )


def _offered(exposures_s: Sequence[float]) -> str:
    match exposures_s:
        case []:
            return "the cameras have no step in common"
        case [only]:
            return f"the cameras offer only {only:.4g} s (turn the dial to M or S for more)"
        case _:
            return f"the cameras offer {exposures_s[0]:.4g} to {exposures_s[-1]:.4g} s"


def _settings(phase: StepsPhase | SweepPhase | DwellPhase) -> Iterator[tuple[float, float, str, str]]:
    """Frequency, amplitude and the keys that they were read from, in the order of the file."""
    if isinstance(phase, DwellPhase):
        yield phase.frequency_hz, phase.amplitude_mm, "frequency_hz", "amplitude_mm"
        return
    values = frequencies(phase.frequency_hz)
    is_list = isinstance(phase.frequency_hz, tuple)
    for place, frequency_hz in enumerate(values):
        frequency_key = f"frequency_hz[{place}]" if is_list else "frequency_hz"
        if isinstance(phase, SweepPhase):
            yield frequency_hz, phase.amplitude_at(frequency_hz), frequency_key, phase.level_key
        elif isinstance(phase.amplitude_mm, tuple):
            yield frequency_hz, phase.amplitude_mm[place], frequency_key, f"amplitude_mm[{place}]"
        else:
            yield frequency_hz, phase.amplitude_mm, frequency_key, "amplitude_mm"


def _with_sharp_sets(drafts: Iterator[_Draft]) -> list[Step]:
    """Number the steps, put retaken sharp sets where their schedule wants them, and tell each step its set."""
    steps: list[Step] = []
    schedule: _Draft | None = None
    sets = since_steps = 0
    since_s = 0.0

    def add(step: Step) -> None:
        nonlocal sets, since_steps, since_s
        index = len(steps)
        if step.kind == "sharp":
            sets, since_steps, since_s = sets + 1, 0, 0.0
        sharp_set = f"set-{sets:03d}" if sets > 1 else ""
        steps.append(replace(step, index=index, label=f"{index:05d}-{step.label}", sharp_set=sharp_set))
        if step.kind != "sharp":
            since_steps, since_s = since_steps + 1, since_s + step.predicted_s

    for draft in drafts:
        if draft.step.kind == "sharp":
            schedule = draft
        elif schedule is not None and draft.step.shots:
            due = (schedule.every_steps is not None and since_steps >= schedule.every_steps) or (
                schedule.every_s is not None and since_s >= schedule.every_s
            )
            if due:
                add(schedule.step)
        add(draft.step)
    return steps
