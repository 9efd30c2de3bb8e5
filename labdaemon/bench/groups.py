"""Groups of captures that show one motion, and groups that do not: how often each is called a contradiction.

A dot on textured paper is rendered for each exposure of a group (see ``planned``), with a D80's noise, at any phase.
In a true group both captures show the same motion. In the others the second one has another amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import click
import numpy as np
from scipy.stats import beta

from labdaemon.bench.planned import TRIALS_A_SHEET, DotCamera, exposure_brightness
from labdaemon.bench.simulator import renderer
from labdaemon.blur import Defocus, ExposureWindow, LightCode, measure_group, named_code
from labdaemon.flags import Flag

AMPLITUDES_MM = (0.3, 0.8, 2.0)
GOAL = 0.01
"""Share of true groups that may be called a contradiction."""


@dataclass(frozen=True, slots=True)
class GroupTrials:
    """Number of groups, how many were called a contradiction, and how many had no phased result to compare."""

    count: int
    contradictions: int
    without_phase: int

    @property
    def share(self) -> float:
        """Share of contradictions."""
        return self.contradictions / max(self.count, 1)

    @property
    def upper(self) -> float:
        """Upper end of the share's two-sided 95 % interval (Clopper and Pearson 1934, doi:10.1093/biomet/26.4.404)."""
        if self.contradictions >= self.count:
            return 1.0
        return float(beta.ppf(0.975, self.contradictions + 1, self.count - self.contradictions))


def group_windows() -> dict[str, list[ExposureWindow]]:
    """Kinds of phased groups: the exposures of each."""
    cosine, sine = ([1.0 + wave(2 * math.pi * (k + 0.5) / 64) for k in range(64)] for wave in (math.cos, math.sin))
    seven = list(named_code("1110100"))
    return {
        "two openings, 5.5 cycles": [ExposureWindow(5.5, 1.0, phase) for phase in (0.0, math.pi / 2)],
        "four openings, 2.5 cycles": [ExposureWindow(2.5, 1.0, k * math.pi / 2) for k in range(4)],
        "cosine and sine": [_coded([value / 2 for value in wave]) for wave in (cosine, sine)],
        "code 1110100 twice": [_coded(seven), _coded(seven)],
    }


def _coded(levels: Sequence[float]) -> ExposureWindow:
    return ExposureWindow(5.0, 1.0, light=LightCode(tuple(levels), 0.0, 5))


def run_groups(
    windows: Sequence[ExposureWindow], amplitude_mm: float, count: int, *, change: float = 0.0, seed: int = 1
) -> GroupTrials:
    """Take and measure `count` groups.

    Parameters
    ----------
    windows
        The group's exposures.
    amplitude_mm
        Semi-amplitude of the motion.
    change
        Relative change of the amplitude in the last capture.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    rng = np.random.default_rng(seed)
    camera = DotCamera(renderer(), rng, amplitude_mm * (1 + change))
    scales = [1.0 / (1 + change)] * (len(windows) - 1) + [1.0]
    contradictions = without_phase = 0
    for trial in range(count):
        if trial % TRIALS_A_SHEET == 0:
            camera.sheet = 1000 * seed + trial
            sharp = camera.sharp_target()
        phase_rad = float(rng.uniform(0, 2 * math.pi))
        patches = [
            camera.photograph(camera.motion(window, phase_rad, scale), exposure_brightness(window))
            for window, scale in zip(windows, scales, strict=True)
        ]
        found = measure_group(sharp, patches, windows, defocus=Defocus(0.0, 0.01))
        contradictions += Flag.CONTRADICTS_GROUP in found.flags
        without_phase += not (found.phased and np.isfinite(found.a_px).all())
    return GroupTrials(count, contradictions, without_phase)


@click.command("groups")
@click.option("--count", default=50, show_default=True, help="Groups of each kind and amplitude.")
@click.option("--change", default=0.05, show_default=True, help="Relative change of the last capture, for the others.")
@click.option("--seed", "seeds", type=int, multiple=True, default=(1,), show_default=True, help="May be given again.")
@click.option("--kind", "kinds", multiple=True, help="Only kinds that begin so.")
def command(count: int, change: float, seeds: tuple[int, ...], kinds: tuple[str, ...]) -> None:
    """Groups of one motion and of two: how often `contradicts_group` is called."""
    click.echo(f"{'group':28s} {'mm':>4s} {'groups':>7s} {'false':>6s} {f'seen, {change:.0%} apart':>16s}")
    total = GroupTrials(0, 0, 0)
    for name, windows in group_windows().items():
        if kinds and not name.startswith(kinds):
            continue
        for amplitude in AMPLITUDES_MM:
            true = [run_groups(windows, amplitude, count, seed=seed) for seed in seeds]
            others = run_groups(windows, amplitude, max(count // 5, 1), change=change, seed=seeds[0])
            pooled = _pool([*true])
            total = _pool([total, pooled])
            click.echo(f"{name:28s} {amplitude:4.1f} {pooled.count:7d} {pooled.contradictions:6d} {others.share:16.0%}")
    click.echo(
        f"all: {total.share:.2%} of {total.count} (95 % of such series: at most {total.upper:.2%}; goal {GOAL:.0%})"
    )


def _pool(parts: Sequence[GroupTrials]) -> GroupTrials:
    return GroupTrials(
        sum(one.count for one in parts),
        sum(one.contradictions for one in parts),
        sum(one.without_phase for one in parts),
    )
