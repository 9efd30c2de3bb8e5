"""`labdaemon bench findings`: how well modes are found and changes located, over many seeds, without images."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any

import click
import numpy as np

from labdaemon.bench.findings_trials import (
    BAND_HZ,
    ComparisonTrials,
    ResonanceTrial,
    run_resonance,
    uniform_steps,
)
from labdaemon.bench.shear_structure import ShearStructure
from labdaemon.findings.closed_loop import ResonanceGoal
from labdaemon.findings.comparison import Comparison


@dataclass(frozen=True, slots=True)
class FindingsGoal:
    """A figure with its limit.

    Attributes
    ----------
    name
        What it is.
    value, low, high
        Measured, and between which values it must lie.
    """

    name: str
    value: float
    low: float
    high: float

    @property
    def is_met(self) -> bool:
        """Whether the value lies within the limits."""
        return self.low <= self.value <= self.high


def resonance_goals(trials: list[ResonanceTrial], ratios: list[float]) -> list[FindingsGoal]:
    """Figures of closed-loop sweeps."""
    good = [one for one in trials if one.found]

    def every(name: str) -> np.ndarray:
        return np.array([value for one in good for value in getattr(one, name)])

    hz, zeta, pulls, sds = (every(name) for name in ("errors_hz", "errors_damping", "pulls", "sd_ratios"))
    return [
        FindingsGoal("structures whose modes were all found, part", len(good) / len(trials), 1.0, 1.0),
        FindingsGoal("largest error of a frequency, %", 100 * float(np.abs(hz).max(initial=0.0)), 0.0, 0.006),
        FindingsGoal("largest error of a damping, % of itself", 100 * float(np.abs(zeta).max(initial=0.0)), 0.0, 2.0),
        FindingsGoal("pulls, root mean square", float(np.sqrt(np.mean(pulls**2))) if pulls.size else 0.0, 0.8, 1.3),
        FindingsGoal("stated sd over the Cramér-Rao bound, largest", float(sds.max(initial=0.0)), 0.0, 1.5),
        FindingsGoal("captures over those of an equal log-uniform sweep, mean", float(np.mean(ratios)), 0.0, 1 / 3),
    ]


def _share(results: list[bool]) -> float:
    return float(np.mean(results)) if results else 0.0


def power_goals(trials: ComparisonTrials, draws: int, rng: np.random.Generator) -> list[FindingsGoal]:
    """Losses of stiffness in one storey: found, and in the right place."""
    structure = trials.structure
    storeys = [draw % 4 for draw in range(draws)]

    def lose(storey: int, loss: float, *, same_scale: bool = False) -> Comparison:
        return trials.compare(structure.with_stiffness(storey, 1 - loss), rng, same_scale=same_scale)

    small = [lose(storey, 0.002) for storey in storeys]
    vouched = [lose(storey, 0.002, same_scale=True) for storey in storeys]
    large = [lose(storey, 0.005) for storey in storeys]

    def is_first(found: Comparison, storey: int) -> bool:
        return bool(found.storeys) and found.storeys[0].where.startswith(f"storey {storey + 1} ")

    def is_among(found: Comparison, storey: int) -> bool:
        return any(one.where.startswith(f"storey {storey + 1} ") for one in found.storeys)

    right, held, vouch = (
        _share([test(one, storey) for one, storey in zip(found, storeys, strict=True)])
        for test, found in ((is_first, large), (is_among, small), (is_first, vouched))
    )
    return [
        FindingsGoal(
            "0.2 % loss in one storey: called changed, part", _share([one.changed for one in small]), 0.95, 1.0
        ),
        FindingsGoal("0.2 % loss: the set holds the storey, part", held, 0.95, 1.0),
        FindingsGoal("0.2 % loss, same scale: the right storey, part", vouch, 0.95, 1.0),
        FindingsGoal("0.5 % loss: the right storey, part", right, 0.95, 1.0),
    ]


def false_alarm_goals(seed: int, draws: int, rng: np.random.Generator) -> list[FindingsGoal]:
    """What is the same everywhere must not be called damage; each draw has a baseline of its own in turn."""
    baselines = [ComparisonTrials.of(seed + k) for k in range(max(draws // 20, 1))]
    base = ShearStructure(per_column=6)
    cases: dict[str, tuple[ShearStructure, dict[str, Any]]] = {
        "no change": (base, {}),
        "uniform -1 % modulus": (base.scaled(stiffness=0.99), {}),
        "+1 % mass everywhere": (base.scaled(mass=1.01), {}),
        "another table amplitude": (base, {"level": 0.6}),
        "moved cameras": (base, {"is_moved": True}),
    }
    goals = []
    for name, (other, how) in cases.items():
        calls = [baselines[draw % len(baselines)].compare(other, rng, **how).changed for draw in range(draws)]
        goals.append(FindingsGoal(f"{name}: called damage, part", _share(calls), 0.0, 0.05))
    return goals


@click.command("findings")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--seeds", type=click.IntRange(1), default=20, show_default=True, help="Structures to sweep.")
@click.option("--draws", type=click.IntRange(8), default=200, show_default=True, help="Comparisons of each kind.")
@click.option("--only", type=click.Choice(["resonance", "power", "false-alarms"]), help="One part alone.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(seed: int, seeds: int, draws: int, only: str | None, as_json: bool) -> None:
    """Modes found by closed-loop sweeps, and changes found by comparison, on envelopes drawn from a shear frame."""
    rng = np.random.default_rng([seed, 16])
    goals: list[FindingsGoal] = []
    started = time.monotonic()
    if only in (None, "resonance"):
        trials, ratios = [], []
        for number in range(seeds):
            trial, structure = run_resonance(seed + number)
            ratios.append(trial.steps / uniform_steps(structure, ResonanceGoal(BAND_HZ)))
            trials.append(trial)
            click.echo(f"structure {number + 1}: {trial.steps} captures, {time.monotonic() - started:.0f} s", err=True)
        goals += resonance_goals(trials, ratios)
    if only in (None, "power"):
        goals += power_goals(ComparisonTrials.of(seed), draws, rng)
        click.echo(f"losses of stiffness: {time.monotonic() - started:.0f} s", err=True)
    if only in (None, "false-alarms"):
        goals += false_alarm_goals(seed, draws, rng)
    if as_json:
        rows = [{"name": one.name, "value": one.value, "met": one.is_met} for one in goals]
        click.echo(json.dumps({"goals": rows, "seconds": time.monotonic() - started}))
    else:
        for one in goals:
            verdict = "" if one.is_met else f"   NOT within {one.low:g} to {one.high:.3g}"
            click.echo(f"{one.value:9.4f}  {one.name}{verdict}")
    if not all(one.is_met for one in goals):
        raise click.exceptions.Exit(1)
