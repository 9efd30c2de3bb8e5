"""Part cycles of unknown and of known length, and third harmonics without a gauge, on single dots with paper texture.

Every trial renders dots of 8 mm that move straight with phases of their own (``labdaemon.bench.dots``), and measures
them as a sinusoid over whole cycles, and by the waveform that the frame's dots show together or through known windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import click
import numpy as np

from labdaemon.bench.dots import DIFFRACTION_PX, OWN_LENS_SIGMA_PX, PX_PER_MM, RADIUS_MM, DotBench
from labdaemon.bench.signed_error import interval_text, signed_error
from labdaemon.blur import (
    Defocus,
    DotImage,
    ExposureWindow,
    FloatArray,
    Measurement,
    Patch,
    SharpTarget,
    estimate_waveform,
    measure_frame,
    measure_group,
    predict_sd,
    with_relative_sd,
)
from labdaemon.flags import Flag

CYCLES = (2.3, 2.5, 3.4, 5.37, 5.5, 7.2, 9.5, 13.7, 19.6, 5.0)
UNKNOWN_MM = (0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 1.9, 2.5)
PHASES_DEG = (0.0, 60.0, 90.0, 120.0, 180.0)
KNOWN_MM = (0.3, 0.6, 0.8, 1.5, 3.0, 6.0, 12.0)
TEXTURE = 0.004
DEFOCUS = Defocus(0.0, 0.02)


@dataclass(frozen=True, slots=True)
class UnknownTrials:
    """Frames whose waveform nothing states.

    Attributes
    ----------
    cycles
        True cycles.
    found
        Estimated cycles of each frame, NaN where whole cycles were not excluded; of harmonics, their mean estimate.
    whole, estimated
        Relative errors of the amplitudes as a sinusoid over whole cycles, and by the estimate.
    pulls
        Errors of the latter over their standard deviations.
    """

    cycles: float
    found: FloatArray
    whole: FloatArray
    estimated: FloatArray
    pulls: FloatArray


def run_unknown(
    cycles: float, frames: int, seed: int = 1, amplitudes_mm: Sequence[float] = UNKNOWN_MM, *, third: complex = 0.0
) -> UnknownTrials:
    """Measure frames of one exposure whose cycles nothing states, of motion with an unknown third harmonic.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    bench = DotBench(seed, TEXTURE)
    sharps = [bench.sharp(amplitude, index) for index, amplitude in enumerate(amplitudes_mm)]
    size_px = np.asarray(amplitudes_mm) * PX_PER_MM
    found, whole, estimated, pulls = [], [], [], []
    for _ in range(frames):
        patches = [
            bench.blurred(amplitude, index, cycles, bench.angle(), direction_rad=bench.angle(), third=third)
            for index, amplitude in enumerate(amplitudes_mm)
        ]
        first, last, estimate = measure_unknown(sharps, patches)
        found.append(estimate)
        whole.append([one.amplitude_px for one in first] / size_px - 1)
        sizes = np.array([one.amplitude_px for one in last])
        estimated.append(sizes / size_px - 1)
        pulls.append((sizes - size_px) / [one.sd_px for one in last])
    return UnknownTrials(
        cycles, np.array(found), np.concatenate(whole), np.concatenate(estimated), np.concatenate(pulls)
    )


def measure_unknown(
    sharps: Sequence[SharpTarget], patches: Sequence[Patch]
) -> tuple[list[Measurement], list[Measurement], float]:
    """A frame as a sinusoid over whole cycles, and by the waveform that its targets show; its cycles or harmonic."""
    first = measure_frame(sharps, patches, defocus=DEFOCUS)
    shared = estimate_waveform(sharps, patches, first, defocus=DEFOCUS)
    last, estimate = first, np.nan
    if shared.window is not None:
        last = measure_frame(sharps, patches, window=replace(shared.window, phase_rad=0.0), defocus=DEFOCUS)
        estimate = shared.window.cycles
    elif shared.harmonic is not None:
        last = measure_frame(
            sharps, patches, defocus=DEFOCUS, harmonics=[shared.harmonic.of(one.name) for one in sharps]
        )
        estimate = shared.harmonic.mean
    return first, [with_relative_sd(one, shared.relative_sd) for one in last], estimate


@dataclass(frozen=True, slots=True)
class KnownTrials:
    """Dots of one amplitude through known windows.

    Attributes
    ----------
    amplitude_mm
        True semi-amplitude.
    error_mm, bound_mm
        Errors of the signed vectors (a, b), and their Cramér–Rao bound; of one opening, whose phase has its mirror
        image, those of the amplitude.
    amplitude_pulls, phase_pulls
        Errors over stated standard deviations; of one opening no phase.
    flagged
        Dots with a flag; their errors are not among the others.
    """

    amplitude_mm: float
    error_mm: FloatArray
    bound_mm: FloatArray
    amplitude_pulls: FloatArray
    phase_pulls: FloatArray
    flagged: int


def run_known(
    amplitude_mm: float, cycles: float, dots: int, texture: float, seed: int = 1, *, openings: int = 2
) -> KnownTrials:
    """Dots on a sheet of paper each, in captures that are opened a quarter of a cycle apart, or in one.

    Parameters
    ----------
    openings
        2 for signed vectors, 1 for amplitudes.
    """
    bench = DotBench(seed, texture)
    size = amplitude_mm * PX_PER_MM
    windows = [ExposureWindow(5.0, cycles / 5.0, opening * np.pi / 2) for opening in range(openings)]
    errors, bounds, pulls, flagged = [], [], [], 0
    for paper in range(dots):
        sharp = bench.sharp(amplitude_mm, paper)
        phase, direction = bench.angle(), bench.angle()
        patches = [
            bench.blurred(amplitude_mm, paper, cycles, phase + (window.phase_rad or 0.0), direction_rad=direction)
            for window in windows
        ]
        bound = predict_sd(windows, size, phase, _dot_image(bench), direction_rad=-direction)
        if openings > 1:
            found = measure_group(sharp, patches, windows, defocus=DEFOCUS)
        else:
            found = measure_frame([sharp], patches, window=windows[0], defocus=DEFOCUS)[0]
        if found.flags - {Flag.AT_REST} or not np.isfinite(found.a_px).all():
            flagged += 1
            continue
        if openings == 1:
            off_px = found.amplitude_px - size
            pulls.append([off_px / found.sd_px])
            errors.append(abs(off_px) / PX_PER_MM)
            bounds.append(bound.amplitude_px / PX_PER_MM)
            continue
        along = np.array([np.cos(direction), -np.sin(direction)])
        error = signed_error(found, size * np.concatenate((np.cos(phase) * along, np.sin(phase) * along)))
        pulls.append([error.amplitude_pull, error.phase_pull])
        errors.append(error.vector_px / PX_PER_MM)
        whole = np.hypot(bound.amplitude_px, size * np.hypot(bound.phase_rad, bound.direction_rad))
        bounds.append(float(whole) / PX_PER_MM)
    table = np.array(pulls).reshape(-1, openings)
    by_phase = table[:, 1] if openings > 1 else np.zeros(0)
    return KnownTrials(amplitude_mm, np.array(errors), np.array(bounds), table[:, 0], by_phase, flagged)


def _dot_image(bench: DotBench) -> DotImage:
    return DotImage(
        RADIUS_MM * PX_PER_MM,
        OWN_LENS_SIGMA_PX,
        bench.white_dn,
        0.05,
        bench.noise,
        sd_defocus_px2=DEFOCUS.sd_px2,
        diffraction_px=DIFFRACTION_PX,
    )


def _cells(trials: UnknownTrials, nothing: str) -> str:
    """One line of errors."""
    parts = [
        f"{errors.mean():19.2%} {_rms(errors):7.2%} {np.abs(errors).max():8.2%}"
        for errors in (trials.whole, trials.estimated)
    ]
    found = ", ".join(nothing if np.isnan(value) else f"{value:.3f}" for value in trials.found)
    return f"{parts[0]}{parts[1][3:]}   {_rms(trials.pulls):5.2f}   {found}"


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


@click.command("windows")
@click.option("--section", type=click.Choice(["all", "unknown", "harmonic", "known"]), default="all", show_default=True)
@click.option("--frames", default=3, show_default=True, help="Frames of eight dots for each unknown waveform.")
@click.option("--dots", default=12, show_default=True, help="Dots of each amplitude through known windows.")
@click.option("--cycles", default=5.5, show_default=True, help="Of the known windows.")
@click.option("--openings", type=click.IntRange(1, 2), default=2, show_default=True, help="Captures of each dot.")
@click.option(
    "--texture", default=TEXTURE, show_default=True, help="Relative paper texture seen through known windows."
)
@click.option("--amplitude-mm", "amplitudes", type=float, multiple=True, help="Through known windows; may be repeated.")
@click.option("--seed", default=1, show_default=True)
def command(
    section: str,
    frames: int,
    dots: int,
    cycles: float,
    openings: int,
    texture: float,
    amplitudes: tuple[float, ...],
    seed: int,
) -> None:
    """Part cycles: of unknown length, and signed vectors through known windows, next to the Cramér–Rao bound."""
    head = "as a sinusoid: mean     rms  largest   estimated: mean     rms  largest   pulls   "
    if section in ("all", "unknown"):
        click.echo("Exposure unknown: relative error of amplitudes of 0.3 to 2.5 mm, every dot with its own phase")
        click.echo(f"cycles   {head}cycles found")
        for one in CYCLES:
            click.echo(f"{one:6.2f}   {_cells(run_unknown(one, frames, seed), 'whole')}")
    if section in ("all", "harmonic"):
        click.echo("5 % of the third harmonic, no gauge, whole cycles; by its phase")
        click.echo(f"phase °  {head}in-phase part found")
        for degrees in PHASES_DEG:
            third = 0.05 * complex(np.exp(1j * np.radians(degrees)))
            click.echo(f"{degrees:6.0f}   {_cells(run_unknown(5.0, frames, seed, third=third), 'none')}")
    if section in ("all", "known"):
        what = "signed vectors, a quarter of a cycle apart" if openings > 1 else "amplitudes"
        click.echo(f"Windows known: {openings} x {cycles:g} cycles, {what}, texture {texture:.1%}")
        click.echo(
            "amplitude mm   dots   flagged   rms µm   bound µm      over the bound   95 % µm    pulls: amplitude"
            "               phase"
        )
        for amplitude in amplitudes or KNOWN_MM:
            known = run_known(amplitude, cycles, dots, texture, seed, openings=openings)
            p95 = float(np.percentile(known.error_mm, 95)) if known.error_mm.size else float("nan")
            ratio = interval_text(known.error_mm / known.bound_mm)
            click.echo(
                f"{amplitude:12.1f}   {dots:4d}   {known.flagged:7d}   {_rms(known.error_mm) * 1e3:6.1f}   "
                f"{_rms(known.bound_mm) * 1e3:8.1f}   {ratio}   {p95 * 1e3:7.1f}   "
                f"{interval_text(known.amplitude_pulls)}   {interval_text(known.phase_pulls)}"
            )
