"""Amplitude and phase of a sine of known frequency in a record: the three-parameter fit of IEEE 1057.

``y(t) = A cos ωt + B sin ωt + C`` is linear in A, B and C, so one least-squares solution is the answer, without
iteration and without windowing errors at part cycles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sine:
    """A fitted sine ``amplitude · sin(ωt + phase_rad) + offset``.

    Attributes
    ----------
    amplitude, sd
        Zero to peak, and its standard deviation from the residuals.
    phase_rad
        At t = 0 of the record.
    offset
        Mean level.
    residual_rms
        Of what the sine leaves, with the degrees of freedom taken into account.
    """

    amplitude: float
    sd: float
    phase_rad: float
    offset: float
    residual_rms: float

    def at(self, t_s: FloatArray, frequency_hz: float) -> FloatArray:
        """Values (n,) at times (n,) of the record."""
        return np.asarray(self.amplitude * np.sin(2 * math.pi * frequency_hz * t_s + self.phase_rad) + self.offset)


def fit_sine(t_s: FloatArray, y: FloatArray, frequency_hz: float) -> Sine:
    """Fit a sine of known frequency (IEEE 1057, three parameters).

    Parameters
    ----------
    t_s, y
        (n,) times in seconds and readings, n > 3.
    frequency_hz
        The sine's.
    """
    angle = 2 * math.pi * frequency_hz * t_s
    design = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    solution, *_ = np.linalg.lstsq(design, y)
    residual = y - design @ solution
    variance = float(residual @ residual) / max(1, y.size - 3)
    s, c, offset = (float(value) for value in solution)
    amplitude = math.hypot(s, c)
    covariance = variance * np.linalg.pinv(design.T @ design)
    direction = np.array([s, c, 0.0]) / amplitude if amplitude > 0 else np.array([1.0, 0.0, 0.0])
    sd = math.sqrt(max(0.0, float(direction @ covariance @ direction)))
    return Sine(amplitude, sd, math.atan2(c, s), offset, math.sqrt(variance))


def change_per_cycle(t_s: FloatArray, y: FloatArray, frequency_hz: float) -> float:
    """Relative change of the amplitude from one cycle to the next, the larger of the record's two halves.

    Each whole cycle is fitted alone; a straight line through the amplitudes of each half gives its rate. (Two halves,
    because a beat that happens to peak in the middle of the record has no slope over the whole.) NaN for a record of
    fewer than two cycles.
    """
    span_s = float(t_s[-1] - t_s[0])
    cycles = int(span_s * frequency_hz + 1e-6)
    if cycles < 2:
        return math.nan
    cycle = np.floor((t_s - t_s[0]) * frequency_hz + 1e-9).astype(int)
    amplitudes = np.array([fit_sine(t_s[cycle == k], y[cycle == k], frequency_hz).amplitude for k in range(cycles)])
    if not amplitudes.all():
        return math.nan
    halves = (amplitudes[: (cycles + 1) // 2], amplitudes[cycles // 2 :]) if cycles >= 4 else (amplitudes,)
    return max(abs(float(np.polyfit(np.arange(half.size), half, 1)[0] / half.mean())) for half in halves)
