"""A four-storey frame on the table: its modes, and their exact response to any history of sinusoidal commands.

Each mode m is a damped oscillator in its modal coordinate q, driven by the table's acceleration,

    q'' + 2 ζ ω0 q' + ω0² q = -x_T''

and displaces a point by φ_m(point)·q, φ containing the participation factor. The table's motion between two commands
is a sum of complex exponentials (see `table`), so q is known in closed form there: one particular solution for each
exponential and the free vibration that carries position and momentum over from the interval before. Nothing is
integrated numerically, and ring-up, beating and ring-down are all in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

HEIGHT_MM = 760.0
"""Of the frame, four storeys of 190 mm."""


@dataclass(frozen=True, slots=True)
class VibrationMode:
    """A mode of a frame that stands on z = 0, vibrating like a bent and twisted cantilever.

    Attributes
    ----------
    frequency_hz, damping_ratio
        Natural frequency, and ζ as a fraction of critical.
    quarter_waves
        Number of quarter sine waves over the height, 1, 3, 5 … (1 first bending, 3 second).
    sway
        (x, y) displacement of the top's axis per unit modal coordinate.
    twist_per_mm
        Rotation of the top about its axis per unit modal coordinate, rad/mm.
    rocking
        Fraction of the section's rotation that shows as vertical motion (1: plane sections; a shear frame less).
    parts
        Weights and other modes whose shapes add up to this one's, which then has none of its own: a modified frame.
    """

    frequency_hz: float
    damping_ratio: float
    quarter_waves: int
    sway: tuple[float, float]
    twist_per_mm: float = 0.0
    rocking: float = 0.15
    parts: tuple[tuple[float, VibrationMode], ...] = ()

    def shape(self, points_mm: FloatArray) -> FloatArray:
        """Displacement (n, 3) of points (n, 3) per unit modal coordinate; 0 at and below the table."""
        points = np.atleast_2d(np.asarray(points_mm, float))
        if self.parts:
            total: FloatArray = np.sum([weight * mode.shape(points) for weight, mode in self.parts], axis=0)
            return total
        x, y, z = points.T
        argument = 0.5 * np.pi * self.quarter_waves * np.clip(z, 0.0, None) / HEIGHT_MM
        profile = np.sin(argument)
        slope = np.where(z > 0, np.cos(argument), 0.0) * 0.5 * np.pi * self.quarter_waves / HEIGHT_MM
        ux = profile * (self.sway[0] - self.twist_per_mm * y)
        uy = profile * (self.sway[1] + self.twist_per_mm * x)
        uz = -self.rocking * slope * (self.sway[0] * x + self.sway[1] * y)
        return np.stack([ux, uy, uz], axis=1)


DEFAULT_MODES = (
    VibrationMode(5.4, 0.020, 1, (0.26, 0.05), 1.5e-4),
    VibrationMode(8.5, 0.018, 1, (0.12, 0.20), 9.0e-4),
    VibrationMode(12.7, 0.015, 3, (0.34, 0.08), -3.0e-4),
)
"""Sway along the table; sway across it with torsion; second bending. Just above the 5, 8 and 12 Hz of McCarthy 2016."""


@dataclass(frozen=True, slots=True)
class FreeVibration:
    """State of all modes at the start of an interval: the homogeneous part, and what drives it.

    Attributes
    ----------
    poles, amplitudes
        Complex exponentials C·exp(s·(t - t0)) whose real parts add up to the table's displacement, mm.
    displacement, velocity
        (modes,) q and q' at t0, mm and mm/s.
    """

    poles: tuple[complex, ...]
    amplitudes: tuple[complex, ...]
    displacement: tuple[float, ...]
    velocity: tuple[float, ...]


def particular(mode: VibrationMode, pole: complex, amplitude: complex) -> complex:
    """Amplitude of q under a table displacement ``amplitude·exp(pole·t)``."""
    omega = 2.0 * np.pi * mode.frequency_hz
    return -amplitude * pole**2 / (pole**2 + 2.0 * mode.damping_ratio * omega * pole + omega**2)


def modal_response(
    modes: Sequence[VibrationMode], state: FreeVibration, elapsed_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Modal coordinates and velocities after `elapsed_s` (n,) of an interval.

    Returns
    -------
    q, q'
        (modes, n) each, mm and mm/s.
    """
    elapsed = np.asarray(elapsed_s, float)
    q = np.zeros((len(modes), elapsed.size))
    velocity = np.zeros_like(q)
    waves = [np.exp(pole * elapsed) for pole in state.poles]
    for index, mode in enumerate(modes):
        omega = 2.0 * np.pi * mode.frequency_hz
        decay = mode.damping_ratio * omega
        damped = omega * np.sqrt(1.0 - mode.damping_ratio**2)
        free, free_rate = state.displacement[index], state.velocity[index]
        for pole, amplitude, wave in zip(state.poles, state.amplitudes, waves, strict=True):
            gain = particular(mode, pole, amplitude)
            q[index] += (gain * wave).real
            velocity[index] += (gain * pole * wave).real
            free -= gain.real
            free_rate -= (gain * pole).real
        # e^{(-decay + i damped) t}(c): real part starts at `free` with slope `free_rate`
        coefficient = complex(free, -(free_rate + decay * free) / damped)
        exponent = complex(-decay, damped)
        wave = coefficient * np.exp(exponent * elapsed)
        q[index] += wave.real
        velocity[index] += (exponent * wave).real
    return q, velocity
