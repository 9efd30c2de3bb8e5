"""A campaign file becomes a plan: every step with its exposures, checked against the rig before anything moves."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from labdaemon.campaign.campaign_file import (
    MAX_STEPS,
    AnyPhase,
    Campaign,
    DwellPhase,
    ExternalPhase,
    PausePhase,
    ResonancePhase,
    ShakingPhase,
    SharpPhase,
    SweepPhase,
)
from labdaemon.campaign.excitations import ExcitedPhase, excitations, hold_after_settling_s
from labdaemon.campaign.light_plan import ImageScale, LightPlan, LitExcitation, lit_shots, plan_light
from labdaemon.campaign.limits import ShakerLimits, check_amplitude, check_frequency
from labdaemon.campaign.sharp_schedule import StepDraft, open_steps, with_sharp_sets
from labdaemon.campaign.steps import Plan, SearchPlan, SettleRule, Shot, Step
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
    steps = with_sharp_sets(planner.drafts())
    if len(steps) > MAX_STEPS:
        raise planner.limit("phase", f"makes more than {MAX_STEPS} steps; split the campaign")
    digest = hashlib.sha256(json.dumps([campaign.toml, rig.digest]).encode()).hexdigest()
    plan = Plan(campaign.name, tuple(steps), campaign.toml, digest, tuple(planner.notes), tuple(planner.searches))
    if rig.free_bytes is not None and plan.predicted_bytes > rig.free_bytes:
        need, room = plan.predicted_bytes / 1e9, rig.free_bytes / 1e9
        raise planner.limit(None, f"needs {need:.2f} GB of disk where {room:.2f} GB are free; free some or plan less")
    return plan


class _Planner:
    """Turns the phases of one campaign into drafts of steps."""

    def __init__(self, campaign: Campaign, rig: PlanRig) -> None:
        self.campaign, self.rig = campaign, rig
        self.source = campaign.source or "campaign"
        self.exposures_s = common_steps_s(rig.exposure_steps_s.values())
        self.notes: dict[str, None] = {}
        """In the order in which they came up, each once."""
        self.searches: list[SearchPlan] = []

    def limit(self, key: str | None, message: str) -> LimitError:
        return LimitError(message, source=self.source, key=key)

    def drafts(self) -> Iterator[StepDraft]:
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

    def phase(self, place: int, phase: AnyPhase) -> Iterator[StepDraft]:
        """Steps of one pass through one phase."""
        if isinstance(phase, SharpPhase):
            shot = self.shot(place, phase.exposure_s, None)
            yield StepDraft(
                self.step(place, phase, None, None, (shot,) * phase.frames, at_rest=phase.at_rest),
                phase.every_steps,
                phase.every_s,
            )
        elif isinstance(phase, ExternalPhase):
            yield from self.external(place, phase)
        elif isinstance(phase, PausePhase):
            yield StepDraft(self.step(place, phase, None, None, (), hold_s=phase.duration_s or 0.0))
        elif isinstance(phase, ResonancePhase):
            yield from self.resonance(place, phase)
        elif isinstance(phase, DwellPhase) and phase.at is not None:
            yield from self.peaks(place, phase)
        elif isinstance(phase, SweepPhase) and self.campaign.section.leads_to_peaks(place):
            yield from self.sweep_for_peaks(place, phase)
        else:
            yield from self.shaking(place, phase)

    def resonance(self, place: int, phase: ResonancePhase) -> Iterator[StepDraft]:
        """A first sweep, and as many steps as may follow it, decided on the way; the last one only ends it."""
        number = len(self.searches)
        settle = phase.settle.value()
        first = [replace(draft, step=replace(draft.step, search=number)) for draft in self.shaking(place, phase)]
        if len(first) > phase.most_steps:
            raise self.limit(
                f"phase[{place}].most_steps",
                f"is {phase.most_steps}, and the first sweep over this band alone has {len(first)} steps",
            )
        self.searches.append(
            SearchPlan(
                number,
                phase.band_hz,
                phase.sd_frequency,
                phase.sd_damping,
                phase.most_steps,
                phase.amplitude_mm,
                phase.largest_mm,
                settle,
                partial(self.decided, place, phase),
            )
        )
        yield from first
        longest = max((draft.step for draft in first), key=lambda step: step.predicted_s)
        yield from open_steps(longest, number, phase.most_steps - len(first))

    def sweep_for_peaks(self, place: int, phase: SweepPhase) -> Iterator[StepDraft]:
        """A sweep as it is written, and a last step without captures in which its modes are found."""
        number, drafts = len(self.searches), list(self.shaking(place, phase))
        hz = [draft.step.frequency_hz or 0.0 for draft in drafts]
        sd, mm, settle = math.inf, max(draft.step.amplitude_mm or 0.0 for draft in drafts), phase.settle.value()
        make_step = partial(self.decided, place, phase)
        search = SearchPlan(number, (min(hz), max(hz)), sd, sd, len(hz), mm, None, settle, make_step, sweep=place)
        self.searches.append(search)
        yield from drafts
        yield from open_steps(drafts[-1].step, number, 0)

    def peaks(self, place: int, phase: DwellPhase) -> Iterator[StepDraft]:
        """A dwell at each mode that the search before it will find; they are checked when they are known."""
        found = [search for search in self.searches if search.source is None]
        if not found:
            key = f"phase[{place}].at"
            raise ConfigError(
                "needs a phase of kind resonance or sweep before it, which finds them", source=self.source, key=key
            )
        for frequency_hz in found[-1].band_hz:
            self.check(place, frequency_hz, phase.amplitude_mm, "at", "amplitude_mm")
        number, hold_s = len(self.searches), phase.hold_s
        search = replace(
            found[-1], number=number, most_steps=phase.most_peaks, amplitude_mm=phase.amplitude_mm, sweep=None
        )
        make_step = partial(self.decided, place, phase)
        self.searches.append(replace(search, source=found[-1].number, hold_s=hold_s, make_step=make_step))
        low_hz = found[-1].band_hz[0]
        slowest = next(self.setting(place, phase, low_hz, phase.amplitude_mm, hold_s=hold_s, is_predicted=False))
        yield from open_steps(slowest.step, number, phase.most_peaks)

    def decided(
        self,
        place: int,
        phase: ResonancePhase | DwellPhase | SweepPhase,
        step: Step,
        frequency_hz: float,
        amplitude_mm: float,
        hold_s: float,
    ) -> Step:
        """An open step with its excitation, checked as every step is."""
        key = "band_hz" if isinstance(phase, ResonancePhase) else "at"
        self.check(place, frequency_hz, amplitude_mm, key, "amplitude_mm")
        draft = next(self.setting(place, phase, frequency_hz, amplitude_mm, hold_s=hold_s, is_predicted=False))
        label = f"{step.index:05d}-{draft.step.label}"
        return replace(draft.step, index=step.index, label=label, sharp_set=step.sharp_set, search=step.search)

    def external(self, place: int, phase: ExternalPhase) -> Iterator[StepDraft]:
        """Captures that others fire: one step for all, or one for each group at several phases."""
        shot = self.shot(place, phase.exposure_s, phase.frequency_hz, half_cycles=phase.phase_rad is not None)
        groups = [(shot,) * phase.captures]
        if phase.phase_rad is not None:
            groups = [tuple(replace(shot, phase_rad=phase_rad) for phase_rad in phase.phase_rad)] * phase.captures
        for shots in groups:
            yield StepDraft(self.step(place, phase, phase.frequency_hz, phase.amplitude_mm, shots, hold_s=phase.wait_s))

    def shaking(self, place: int, phase: ExcitedPhase) -> Iterator[StepDraft]:
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
        settings = list(excitations(phase))
        for frequency_hz, amplitude_mm, frequency_key, amplitude_key in settings:
            self.check(place, frequency_hz, amplitude_mm, frequency_key, amplitude_key)
        sequence = settings + settings[-2::-1] if phase.both_directions else settings
        # What light will know changes slowly over a search's first sweep, and takes long to predict.
        count = len(sequence)
        is_sampled = isinstance(phase, ResonancePhase)
        predicted = {0, count // 2, count - 1} if is_sampled else set(range(count))
        for number, (frequency_hz, amplitude_mm, _, _) in enumerate(sequence):
            hold_s = hold_after_settling_s(phase, frequency_hz)
            yield from self.setting(
                place, phase, frequency_hz, amplitude_mm, hold_s=hold_s, is_predicted=number in predicted
            )

    def check(
        self, place: int, frequency_hz: float, amplitude_mm: float, frequency_key: str, amplitude_key: str
    ) -> None:
        """Refuse what the table must not or cannot do, by the key that it was read from."""
        assert self.rig.limits is not None
        at = f"phase[{place}]."
        if crossed := check_frequency(self.rig.limits, frequency_hz):
            raise self.limit(at + frequency_key, crossed)
        if crossed := check_amplitude(self.rig.limits, frequency_hz, amplitude_mm):
            raise self.limit(at + amplitude_key, crossed)
        if refused := self.rig.refusal(frequency_hz, amplitude_mm):
            raise self.limit(at + amplitude_key, refused)

    def setting(
        self,
        place: int,
        phase: ExcitedPhase,
        frequency_hz: float,
        amplitude_mm: float,
        *,
        hold_s: float,
        is_predicted: bool = True,
    ) -> Iterator[StepDraft]:
        """One excitation: its captures, or one step for each group of captures at several phases."""
        settle = phase.settle.value()
        if phase.light is not None:
            yield from self.lit(place, phase, frequency_hz, amplitude_mm, hold_s, is_predicted=is_predicted)
            return
        if phase.phase_rad is None:
            shots = (self.shot(place, phase.exposure_s, frequency_hz),) * phase.captures
            yield StepDraft(self.step(place, phase, frequency_hz, amplitude_mm, shots, settle=settle, hold_s=hold_s))
            return
        plain = self.shot(place, phase.exposure_s, frequency_hz, half_cycles=True)
        shots = tuple(replace(plain, phase_rad=phase_rad) for phase_rad in phase.phase_rad)
        for group in range(phase.captures):
            held_s = hold_s if group == 0 else 0.0
            yield StepDraft(self.step(place, phase, frequency_hz, amplitude_mm, shots, settle=settle, hold_s=held_s))

    def lit(
        self,
        place: int,
        phase: ExcitedPhase,
        frequency_hz: float,
        amplitude_mm: float,
        hold_s: float,
        *,
        is_predicted: bool,
    ) -> Iterator[StepDraft]:
        """One excitation under coded light: its captures, or one step for each group of captures with several codes."""
        expected_mm = phase.expected_mm or amplitude_mm
        lit = LitExcitation(phase.light_codes, phase.light_phase_rad, phase.exposure_s, frequency_hz, expected_mm)
        try:
            if is_predicted:
                planned = plan_light(lit, self.rig.lamp, self.exposures_s, self.rig.scale)
            else:
                planned = LightPlan(lit_shots(lit, self.rig.lamp, self.exposures_s), None, ())
        except (ConfigError, LimitError) as exc:
            key = f"phase[{place}]." + ("exposure_s" if isinstance(exc, LimitError) else "light")
            raise type(exc)(str(exc), source=self.source, key=key) from None
        self.notes |= dict.fromkeys(f"phase[{place}], {note}" for note in planned.notes)
        groups = [planned.shots * phase.captures] if len(planned.shots) == 1 else [planned.shots] * phase.captures
        for number, shots in enumerate(groups):
            held_s = hold_s if number == 0 else 0.0
            settle = phase.settle.value()
            step = self.step(place, phase, frequency_hz, amplitude_mm, shots, settle=settle, hold_s=held_s)
            yield StepDraft(replace(step, precision=planned.precision, grouped=len(planned.shots) > 1))

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
