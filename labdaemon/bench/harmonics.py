"""A table with harmonics: how far amplitudes are off without and with what a gauge shows of them.

Each trial renders a dot that moves with a third harmonic of random phase, gives it a D80's noise, and records the same
motion with a noisy gauge; the harmonic that goes into the fit is the gauge's, with its own error.
"""

from __future__ import annotations

from dataclasses import dataclass

import click
import numpy as np

from labdaemon.bench.dots import PLAIN_NOISE, PX_PER_MM, RADIUS_MM, mosaic_patch, render_dot
from labdaemon.bench.simulator import Renderer, renderer
from labdaemon.blur import (
    Defocus,
    Dot,
    FloatArray,
    MotionHarmonics,
    Patch,
    SharpTarget,
    fit_sharp,
    measure_frame,
)
from labdaemon.periodic_fit import fit_periodic

AMPLITUDES_MM = (0.4, 0.8, 2.0, 5.0)
GAUGE_NOISE_MM, GAUGE_RATE_HZ, FREQUENCY_HZ = 0.002, 500.0, 5.0
DIRECTION = np.array([np.cos(0.4), 0.0, np.sin(0.4)])


@dataclass(frozen=True, slots=True)
class HarmonicTrials:
    """Relative errors of the amplitude (n,), without and with the gauge's harmonic, and the latter's pulls."""

    amplitude_mm: float
    without: FloatArray
    with_gauge: FloatArray
    pulls: FloatArray

    @staticmethod
    def rms(values: FloatArray) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(values**2)))


def run_harmonics(
    amplitude_mm: float, count: int, *, third: float = 0.05, seed: int = 1, noise: bool = True
) -> HarmonicTrials:
    """Measure `count` dots of one amplitude, each with another phase of its harmonic.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    rng, render = np.random.default_rng(seed), renderer()
    sharp = _sharp_target(render, rng, amplitude_mm)
    without, with_gauge, pulls = [], [], []
    for trial in range(count):
        delta = 2.0 * np.pi * (trial + 0.5) / count
        harmonics = record_harmonics(rng, amplitude_mm, third, delta)

        def motion(t: FloatArray, delta: float = delta) -> FloatArray:
            theta = 2.0 * np.pi * FREQUENCY_HZ * t
            values = amplitude_mm * (np.sin(theta) + third * np.sin(3.0 * theta + delta))
            return np.asarray(values[:, None] * DIRECTION, np.float64)

        patch = _photograph(render, rng if noise else None, amplitude_mm, motion)
        found = measure_frame([sharp] * 2, [patch] * 2, defocus=Defocus(0.0, 0.01), harmonics=[None, harmonics])
        sizes = [one.amplitude_px / (amplitude_mm * PX_PER_MM) - 1.0 for one in found]
        without.append(sizes[0])
        with_gauge.append(sizes[1])
        pulls.append(sizes[1] * amplitude_mm * PX_PER_MM / found[1].sd_px)
    return HarmonicTrials(amplitude_mm, np.array(without), np.array(with_gauge), np.array(pulls))


def record_harmonics(
    rng: np.random.Generator, amplitude_mm: float, third: float, delta_rad: float, duration_s: float = 1.0
) -> MotionHarmonics:
    """The motion's harmonics, as a gauge with noise shows them over one exposure."""
    t = np.arange(round(duration_s * GAUGE_RATE_HZ)) / GAUGE_RATE_HZ
    theta = 2.0 * np.pi * FREQUENCY_HZ * t + rng.uniform(0.0, 2.0 * np.pi)
    y = amplitude_mm * (np.sin(theta) + third * np.sin(3.0 * theta + delta_rad))
    fit = fit_periodic(t, y + rng.normal(0.0, GAUGE_NOISE_MM, t.size), FREQUENCY_HZ, sd_frequency_hz=5e-3)
    parts = [
        (one.amplitude / fit.amplitude * np.exp(1j * (one.phase_rad or 0.0)), one.sd / fit.amplitude)
        for one in fit.harmonics
    ]
    return MotionHarmonics(
        tuple(float(value.real) for value, _ in parts),
        tuple(float(value.imag) for value, _ in parts),
        tuple(float(sd) for _, sd in parts),
    )


def _sharp_target(render: Renderer, rng: np.random.Generator, amplitude_mm: float) -> SharpTarget:
    patch = _photograph(render, rng, amplitude_mm, None)
    middle = (patch.shape[0] - 1) / 2
    dot = Dot(middle, middle, RADIUS_MM * PX_PER_MM, RADIUS_MM * PX_PER_MM, 0.0, name="T")
    return fit_sharp(dot, [patch], noise=PLAIN_NOISE)


def _photograph(render: Renderer, rng: np.random.Generator | None, amplitude_mm: float, motion: object) -> Patch:
    half = int(np.ceil((RADIUS_MM + 1.1 * amplitude_mm) * PX_PER_MM)) + 16
    size = 2 * half + 1
    sheet = (size + 40) / PX_PER_MM
    target = {"name": "T", "centre_mm": (0.0, 0.0, 0.0), "diameter_mm": 2 * RADIUS_MM, "paper_mm": (sheet, sheet)}
    scene = {"targets": [target], "texture": 0.0, "gradient": (0.0, 0.0), "vignetting": 0.0, "clutter": 0}
    image = render_dot(render, scene, half, motion)
    if rng is not None:
        image = image + rng.normal(size=image.shape) * np.sqrt(PLAIN_NOISE.variance(image))
    return mosaic_patch(image)


@click.command("harmonics")
@click.option("--count", default=12, show_default=True, help="Phases of the harmonic for each amplitude.")
@click.option("--third", default=0.05, show_default=True, help="Third harmonic over the fundamental.")
@click.option("--seed", default=1, show_default=True)
def command(count: int, third: float, seed: int) -> None:
    """A third harmonic: error of amplitudes without and with what a gauge shows of it."""
    click.echo("bias that the harmonic adds, over its phases, in noise-free frames; pulls of noisy ones with the gauge")
    click.echo("amplitude mm   without: rms, largest   with gauge: rms, largest   pull")
    for amplitude_mm in AMPLITUDES_MM:
        sine = float(run_harmonics(amplitude_mm, 1, third=0.0, seed=seed, noise=False).without[0])
        exact = run_harmonics(amplitude_mm, count, third=third, seed=seed, noise=False)
        noisy = run_harmonics(amplitude_mm, count, third=third, seed=seed)
        cells = "   ".join(
            f"{HarmonicTrials.rms(one - sine):11.3%} {np.abs(one - sine).max():8.3%}"
            for one in (exact.without, exact.with_gauge)
        )
        click.echo(f"{amplitude_mm:12.1f}   {cells}   {HarmonicTrials.rms(noisy.pulls):12.2f}")
