"""`labdaemon plan --optimise`: the captures that know a motion best in a given time, as text and as TOML."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import tomli_w

from labdaemon.campaign.campaign_file import Campaign, StepsPhase, SweepPhase, load_campaign
from labdaemon.campaign.capture_design import CaptureDesign, Expectation, Goal, GroupPrecision, StepDesign
from labdaemon.campaign.fisher_plan import DesignSearch, default_goal, excitations, spread_amplitudes
from labdaemon.campaign.light_plan import ImageScale
from labdaemon.campaign.plan import PlanRig, make_plan
from labdaemon.durable import write_durably
from labdaemon.errors import UsageError

TRANSMISSIBILITY = (0.5, 5.0)
"""Structure's motion over the table's, where nothing else is said: from near a node to near a mode."""

LARGEST_PX = 200.0
"""Largest semi-amplitude that is looked at: no label is so wide, and the modelled image grows with its square."""

LEAST_AMBIGUOUS = 0.005
"""Share of measurements with a twin that is worth a word."""

PlannedDesign = tuple[int, StepDesign]
"""Place of a phase in the file, and one of its excitations."""


def search_designs(
    campaign: Campaign,
    rig: PlanRig,
    scale: ImageScale,
    *,
    goal: Goal | None = None,
    expected_mm: tuple[float, float] | None = None,
    transmissibility: tuple[float, float] | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> list[PlannedDesign]:
    """The best captures of every excitation of a campaign.

    Parameters
    ----------
    goal
        What is to be known; for each phase what it asks for, if None.
    expected_mm
        Range of semi-amplitudes on the structure.
    transmissibility
        The same over the table's; used without `expected_mm`.
    progress
        Called with what is looked at.

    Raises
    ------
    UsageError
        The campaign sets no shaker, or the motions that are expected are none, or too large.
    LabdaemonError
        It cannot be planned.
    """
    found: list[PlannedDesign] = []
    todo = excitations(campaign, rig)
    if not todo:
        raise UsageError("the campaign has no step that sets the shaker: there is nothing to choose")
    searches: dict[tuple[Any, ...], DesignSearch] = {}
    for number, (place, frequency_hz, amplitude_mm) in enumerate(todo, start=1):
        phase: Any = campaign.section.phase[place]
        wanted = goal or default_goal(phase)
        if amplitude_mm == 0 and expected_mm is None:
            raise UsageError(f"phase[{place}].amplitude_mm is 0: say with --expected-mm what moves")
        low, high = expected_mm or tuple(amplitude_mm * one for one in transmissibility or TRANSMISSIBILITY)
        if high * scale.px_per_mm > LARGEST_PX:
            raise UsageError(
                f"a motion of {high:g} mm is one of {high * scale.px_per_mm:.0f} px, and {LARGEST_PX:g} at most are "
                "looked at; give a smaller range as --expected-mm"
            )
        key = (wanted, phase.exposure_s, low, high)
        if key not in searches:
            searches[key] = DesignSearch(rig, Expectation(spread_amplitudes(low, high), scale), wanted)
        progress(f"{number}/{len(todo)}: {frequency_hz:g} Hz, {low:.2g} to {high:.2g} mm expected, best {wanted}")
        found.append((place, searches[key].best(phase, frequency_hz, amplitude_mm)))
    return found


def lines(designs: Sequence[PlannedDesign]) -> list[str]:
    """The designs as text: for each excitation the campaign's own captures, and the best ones."""
    made = [f"{'excitation':<18}{'':<6}{'captures':<46}{'sd mm':>9}{'sd phase':>10}{'time':>8}"]
    for _, one in designs:
        at = f"{one.frequency_hz:.3f} Hz {one.amplitude_mm:.3g} mm"
        made.append(f"{at:<18}{'now':<6}{_captures(one.own, one.own_groups):<46}{_precision(one.own_precision)}")
        made.append(f"{'':<18}{'best':<6}{_captures(one.best, one.best_groups):<46}{_precision(one.best_precision)}")
    made.append(
        "(of one target and camera, 1.15 × Cramér–Rao and valleys of the phase, averaged over the expected amplitudes; "
        "time without settling)"
    )
    return made


def _captures(design: CaptureDesign, groups: int) -> str:
    shot = design.step.shots[0]
    text = f"{groups * len(design.step.shots)} × {shot.exposure_s:.3g} s ({design.windows[0].cycles:.2f} cycles)"
    if design.phase.light is not None:
        code = design.phase.light
        return f"{text} {code if isinstance(code, str) else ' and '.join(map(str, code))}"
    if design.phase.phase_rad is not None:
        return f"{text} at {', '.join(f'{math.degrees(one):.0f}°' for one in design.phase.phase_rad)}"
    return text


def _precision(precision: GroupPrecision) -> str:
    if math.isinf(precision.sd_amplitude_mm):
        return f"{'part_cycles':>19}{precision.seconds:>6.1f} s"
    known = math.isfinite(precision.sd_phase_rad)
    phase = f"{math.degrees(precision.sd_phase_rad):.2f}°" if known else "–"
    twins = f"   {precision.ambiguous:.0%} ambiguous" if precision.ambiguous > LEAST_AMBIGUOUS else ""
    return f"{precision.sd_amplitude_mm:>9.4f}{phase:>10}{precision.seconds:>6.1f} s{twins}"


def document(designs: Sequence[PlannedDesign]) -> list[dict[str, Any]]:
    """The same for `--json`: lists of what the captures are and what they are predicted to know."""
    return [
        {
            "phase": place,
            "frequency_hz": one.frequency_hz,
            "amplitude_mm": one.amplitude_mm,
            "now": _design(one.own, one.own_groups, one.own_precision),
            "best": _design(one.best, one.best_groups, one.best_precision),
        }
        for place, one in designs
    ]


def _design(design: CaptureDesign, groups: int, precision: GroupPrecision) -> dict[str, Any]:
    known = {key: value if math.isfinite(value) else None for key, value in asdict(precision).items()}
    keys = ("exposure_s", "phase_rad", "light")
    return {"captures": groups, **{key: getattr(design.phase, key) for key in keys}, **known}


def campaign_toml(campaign: Campaign, designs: Sequence[PlannedDesign]) -> str:
    """The campaign with a phase of its own for each excitation, as the designs have it."""
    phases: list[dict[str, Any]] = []
    for place, phase in enumerate(campaign.section.phase):
        own = phase.model_dump(exclude_unset=True, exclude_none=True)
        best = [one for at, one in designs if at == place]
        if not best:
            phases.append(own)
            continue
        ordered = [*best, *best[-2::-1]] if getattr(phase, "both_directions", False) else best
        written = [phase_table(own, one, is_dwell=not isinstance(phase, StepsPhase | SweepPhase)) for one in ordered]
        phases += written * (phase.repeats if len(written) > 1 else 1)
    section = campaign.section.model_dump(exclude_unset=True, exclude={"phase"})
    return tomli_w.dumps({**section, "phase": phases})


def phase_table(own: dict[str, Any], design: StepDesign, *, is_dwell: bool) -> dict[str, Any]:
    """One excitation as a ``[[phase]]``; what the phase says beyond the captures stays."""
    dropped = {"velocity_mm_s", "acceleration_mm_s2", "both_directions", "phase_rad", "light", "expected_mm"}
    kept = {key: value for key, value in own.items() if key not in dropped}
    if not is_dwell:
        kept.pop("repeats", None)
        kept["kind"] = "steps"
    best = design.best.phase
    table = kept | {
        "frequency_hz": design.frequency_hz,
        "amplitude_mm": design.amplitude_mm,
        "captures": design.best_groups,
        "exposure_s": round(best.exposure_s, 6),
    }
    if best.phase_rad is not None:
        table["phase_rad"] = list(best.phase_rad)
    if best.light is not None:
        table["light"] = best.light if isinstance(best.light, str) else list(best.light)
        if best.expected_mm is not None:
            table["expected_mm"] = round(best.expected_mm, 4)
    return table


def save(text: str, to: Path, rig: PlanRig) -> None:
    """Write a campaign, after it was read back and planned.

    Raises
    ------
    LabdaemonError
        It cannot be planned, or not be written.
    """
    make_plan(load_campaign(text), rig)
    write_durably(to, text)
    click.echo(f"written to {to}", err=True)
