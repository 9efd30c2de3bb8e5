"""Amplitude and phase of a sine in a record: the three- and four-parameter fits of IEEE 1057.

``y(t) = A cos ωt + B sin ωt + C`` is linear in A, B and C, so one least-squares solution is the answer, without
iteration and without windowing errors at part cycles. Where the frequency is unknown too, it is searched and fitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SineFit:
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


def fit_sine(t_s: FloatArray, y: FloatArray, frequency_hz: float) -> SineFit:
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
    return SineFit(amplitude, sd, math.atan2(c, s), offset, math.sqrt(variance))


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


@dataclass(frozen=True, slots=True)
class FreeSineFit:
    """A fitted sine whose frequency was fitted too.

    Attributes
    ----------
    frequency_hz, sd_frequency_hz
        Its frequency, and the standard deviation from the residuals.
    sine
        Amplitude, phase and offset at that frequency.
    is_significant
        False where noise alone may look like this: no frequency of the record stands out.
    """

    frequency_hz: float
    sd_frequency_hz: float
    sine: SineFit
    is_significant: bool


FALSE_ALARM = 1e-4
"""Probability that noise without a sine is taken for one."""
LEAST_CYCLES = 1.5
"""Below so many cycles in the record a drift looks like a sine."""
ITERATIONS = 20


def fit_free_sine(t_s: FloatArray, y: FloatArray) -> FreeSineFit:
    """Fit a sine of unknown frequency (IEEE 1057, four parameters).

    The highest peak of the zero-padded spectrum is the start; then frequency, amplitude, phase and offset are improved
    together (Gauss-Newton), which is linear but for the frequency.

    Parameters
    ----------
    t_s, y
        (n,) times in seconds, evenly spaced, and readings; n ≥ 16.

    Raises
    ------
    ValueError
        The record is too short.
    """
    if y.size < 16:
        raise ValueError(f"{y.size} readings are no record to look for a sine in")
    step_s = float(t_s[-1] - t_s[0]) / (y.size - 1)
    frequency_hz, step_hz = _spectral_peak(y, step_s), 1.0 / (y.size * step_s)
    lowest, highest = LEAST_CYCLES * step_hz, 0.5 / step_s
    for _ in range(ITERATIONS):
        change = _frequency_step(t_s, y, frequency_hz)
        moved = min(max(frequency_hz + min(max(change, -step_hz), step_hz), lowest), highest)
        done = abs(moved - frequency_hz) < 1e-9 * frequency_hz
        frequency_hz = moved
        if done:
            break
    sine = fit_sine(t_s, y, frequency_hz)
    design = _free_design(t_s, frequency_hz, sine)
    covariance = sine.residual_rms**2 * np.linalg.pinv(design.T @ design)
    # The periodogram of white noise is exponentially distributed; the highest of n/2 independent values is looked at.
    power = y.size * sine.amplitude**2 / (4.0 * sine.residual_rms**2) if sine.residual_rms > 0 else math.inf
    stands_out = sine.amplitude > 1e-12 * float(np.abs(y).max()) and power > math.log(y.size / 2.0 / FALSE_ALARM)
    return FreeSineFit(frequency_hz, math.sqrt(max(0.0, float(covariance[3, 3]))), sine, stands_out)


def _spectral_peak(y: FloatArray, step_s: float) -> float:
    """Frequency of the highest peak that makes enough cycles in the record, Hz."""
    padded = 8 * y.size
    window = np.hanning(y.size)
    power = np.abs(np.fft.rfft((y - y.mean()) * window, padded))
    first = math.ceil(LEAST_CYCLES * padded / y.size)
    return float(first + int(np.argmax(power[first:]))) / (padded * step_s)


def _frequency_step(t_s: FloatArray, y: FloatArray, frequency_hz: float) -> float:
    """By how much the frequency is to change, Hz."""
    sine = fit_sine(t_s, y, frequency_hz)
    residual = y - sine.at(t_s, frequency_hz)
    solution, *_ = np.linalg.lstsq(_free_design(t_s, frequency_hz, sine), residual)
    return float(solution[3])


def _free_design(t_s: FloatArray, frequency_hz: float, sine: SineFit) -> FloatArray:
    """(n, 4) derivatives by the sine's and cosine's parts, offset and frequency."""
    angle = 2 * math.pi * frequency_hz * t_s
    by_frequency = 2 * math.pi * t_s * sine.amplitude * np.cos(angle + sine.phase_rad)
    return np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle), by_frequency], axis=1)
