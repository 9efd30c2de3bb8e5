"""Displacement-time laws for targets whose motion a test decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdrivers.sim.lens import FloatArray
from labdrivers.sim.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Harmonic:
    """d(t) = offset + a·sin(ωt) + b·cos(ωt).

    Attributes
    ----------
    frequency_hz
        ω/2π.
    a_mm, b_mm, offset_mm
        (3,) each.
    """

    frequency_hz: float
    a_mm: FloatArray
    b_mm: FloatArray
    offset_mm: FloatArray

    def __call__(self, t: FloatArray) -> FloatArray:
        """Displacement (n, 3) at times (n,), mm."""
        angle = 2.0 * np.pi * self.frequency_hz * np.asarray(t, float)[:, None]
        return np.asarray(self.offset_mm + self.a_mm * np.sin(angle) + self.b_mm * np.cos(angle))


def random_motions(
    scene: Scene,
    rng: np.random.Generator,
    amplitude_mm: tuple[float, float],
    orbit: float,
    frequency_hz: float,
    offset_sd_mm: float,
    planar: bool,
    in_phase: bool = False,
    level: bool = False,
) -> dict[str, Harmonic]:
    """A motion for each target.

    Parameters
    ----------
    amplitude_mm
        Smallest and largest major semi-axis, drawn evenly in the logarithm.
    orbit
        Ratio of minor to major semi-axis.
    offset_sd_mm
        Standard deviation of each component of the mean's distance from rest.
    planar
        Keep to the plane of x and z.
    in_phase
        One phase for all, as in an in-phase motion; the sign of each stays random.
    level
        Keep to the plane of x and y.
    """
    motions: dict[str, Harmonic] = {}
    common = rng.uniform(0.0, 2.0 * np.pi) if in_phase else None
    for target in scene.targets:
        major = float(np.exp(rng.uniform(*np.log(amplitude_mm))))
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0].T
        if planar:
            turn = rng.uniform(0.0, 2.0 * np.pi)
            axes = np.array([(np.cos(turn), 0.0, np.sin(turn)), (-np.sin(turn), 0.0, np.cos(turn))])
        if level:
            turn = rng.uniform(0.0, 2.0 * np.pi)
            axes = np.array([(np.cos(turn), np.sin(turn), 0.0), (-np.sin(turn), np.cos(turn), 0.0)])
        offset = rng.normal(0.0, 1.0, 3) * offset_sd_mm * (1.0, 0.0 if planar else 1.0, 1.0)
        u, v = major * axes[0], major * orbit * axes[1]
        # where the point is on its orbit at the excitation's zero: any phase
        phase = common if common is not None else rng.uniform(0.0, 2.0 * np.pi)
        a, b = u * np.cos(phase) - v * np.sin(phase), u * np.sin(phase) + v * np.cos(phase)
        motions[target.name] = Harmonic(frequency_hz, a, b, offset)
    return motions
