"""A periodic motion in a gauge's record: fundamental, harmonics, drift and offset by least squares.

The model over a record is

    y(t) = offset + drift·(t − t_m) + Σ_n A_n sin(nωt + φ_n),   n = 1 … 5,

with t_m the middle of the record. At a fixed frequency it is linear, so that one least-squares solution is the answer
at any number of cycles, gaps included; the frequency, known to within a standard deviation or not at all, is improved
together with the rest (Gauss-Newton). This extends the three- and four-parameter fits of IEEE Std 1057-2017,
doi 10.1109/IEEESTD.2018.8291741, which `labdaemon.sine_fit` has.

The standard deviations rest on what the model leaves of the record. They allow for few readings (Student's t), for
noise that neighbouring readings share (first-order autocorrelation) and for the converter's steps. A record that cannot
show the motion raises `RecordError` with the reason; no number is made up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdaemon.record_range import RecordError, check_range, check_shape, smallest_step
from labdaemon.record_time import MIN_READINGS_PER_CYCLE, check_frequency, check_rate, check_steady, check_times
from labdaemon.sine_fit import fit_free_sine

FloatArray = NDArray[np.float64]

MAX_ORDER = 5
"""Highest harmonic looked for."""
MIN_CYCLES = 1.0
"""Below one cycle, offset and drift explain what the sine should."""
MIN_EXCESS_READINGS = 8
"""Readings beyond the number of unknowns; with fewer the noise is hardly known."""
MAX_BAD_SHARE = 0.2
"""Share of a record that may be without a number."""
MAX_OUTLIER_SHARE = 0.03
OUTLIER = 10.0
"""Residuals beyond this many times their median size (6.7 standard deviations) are no noise."""
MIN_READINGS_FOR_OUTLIERS = 50
"""The median size of fewer residuals is too uncertain to judge any by it."""
DITHER = 0.4
"""Noise below this part of the converter's step leaves errors that repeat in every cycle, and do not average out."""
MOST_READINGS, AVERAGED_PER_CYCLE = 50_000, 200
"""A record of more is averaged, as far as so many remain of each cycle: the fifth harmonic loses 0.1 %."""
MAX_PHASE_SD_RAD = 1.0
"""A phase that is known no better than this is none."""
ITERATIONS = 12
MAX_AUTOCORRELATION = 0.98


@dataclass(frozen=True, slots=True)
class RecordHarmonic:
    """One harmonic of a `PeriodicFit`.

    Attributes
    ----------
    order
        2 for twice the fundamental frequency, and so on.
    amplitude, sd
        Zero to peak, in the record's unit, and its standard deviation.
    phase_rad, sd_phase_rad
        φ_n − n·φ_1, in (−π, π]: with θ the fundamental's own phase, the harmonic is ``amplitude sin(nθ + phase_rad)``.
        It does not depend on when the record begins. None where it is not known to within 1 rad.
    """

    order: int
    amplitude: float
    sd: float
    phase_rad: float | None
    sd_phase_rad: float | None


@dataclass(frozen=True, slots=True)
class PeriodicFit:
    """A fitted periodic motion. Amplitudes are zero to peak, in the record's unit.

    Attributes
    ----------
    frequency_hz, sd_frequency_hz
        Of the fundamental, by the record's own clock.
    amplitude, sd
        Of the fundamental.
    phase_rad, sd_phase_rad
        Of the fundamental at t = 0; None where it is not known to within 1 rad.
    harmonics
        From the second on, as far as the rate of readings shows them.
    offset, sd_offset
        Mean level in the middle of the record.
    drift_per_s, sd_drift_per_s
        Its change, unit per second.
    noise
        Standard deviation of a reading about the model.
    readings, cycles
        Readings used, means of neighbours where there are very many, and cycles of the fundamental that the record
        spans.
    """

    frequency_hz: float
    sd_frequency_hz: float
    amplitude: float
    sd: float
    phase_rad: float | None
    sd_phase_rad: float | None
    harmonics: tuple[RecordHarmonic, ...]
    offset: float
    sd_offset: float
    drift_per_s: float
    sd_drift_per_s: float
    noise: float
    readings: int
    cycles: float


def fit_periodic(
    t_s: FloatArray, y: FloatArray, frequency_hz: float | None = None, *, sd_frequency_hz: float = 0.0
) -> PeriodicFit:
    """Fit fundamental, harmonics, drift and offset to a record.

    Parameters
    ----------
    t_s, y
        (n,) times in seconds, ascending, and readings in any unit; NaN where a reading has no number.
    frequency_hz
        Of the fundamental; None to search for the strongest sine.
    sd_frequency_hz
        How well that is known; 0 holds it. A gauge's clock is rarely better than 0.1 %.

    Raises
    ------
    RecordError
        Too few readings or cycles, a rate too low for the frequency, a record that is clipped, stuck, full of outliers,
        without numbers, at another frequency or not steady, or, where the frequency is searched for, noise alone.
    """
    t_s, y = np.asarray(t_s, np.float64), np.asarray(y, np.float64)
    check_times(t_s, y)
    usable = np.isfinite(y)
    if usable.size == 0 or not usable.any():
        raise RecordError("the record holds no readings")
    if 1.0 - usable.mean() > MAX_BAD_SHARE:
        raise RecordError(f"{1.0 - usable.mean():.0%} of the record has no numbers")
    t, values = t_s[usable], y[usable]
    check_range(values)
    if frequency_hz is None:
        frequency_hz, sd_frequency_hz = _search(t, values), math.inf
    check_rate(t_s, frequency_hz)
    t, values = _averaged(t, values, frequency_hz)
    fit = _fit(t, values, frequency_hz, sd_frequency_hz)
    if math.isinf(sd_frequency_hz) and fit.frequency_hz * float(t[-1] - t[0]) < MIN_CYCLES:
        raise RecordError("less than a cycle of the strongest sine: it may be drift")
    if values.size < MIN_READINGS_FOR_OUTLIERS:
        return _checked(fit, values, frequency_hz)
    # A spike would fill the residuals by which the others are judged: out with them, and fit once more.
    residual = np.abs(fit.residual)
    keep = residual <= OUTLIER * max(float(np.median(residual)), smallest_step(values), 1e-12)
    if 1.0 - keep.mean() > MAX_OUTLIER_SHARE:
        raise RecordError(f"{1.0 - keep.mean():.0%} of the record are outliers")
    if not keep.all():
        fit = _fit(t[keep], values[keep], frequency_hz, sd_frequency_hz)
    return _checked(fit, values[keep], frequency_hz)


def _averaged(t: FloatArray, y: FloatArray, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    """Means of neighbours that stand for the readings of a record of very many."""
    span_s = float(t[-1] - t[0])
    size = min(t.size // MOST_READINGS, int(t.size / (AVERAGED_PER_CYCLE * max(span_s * frequency_hz, 1.0))))
    if size < 2:
        return t, y
    whole = t.size // size * size
    return t[:whole].reshape(-1, size).mean(axis=1), y[:whole].reshape(-1, size).mean(axis=1)


def _checked(fit: _LinearFit, y: FloatArray, stated_hz: float) -> PeriodicFit:
    """The result, if its motion stays the same all through, and has the frequency that was stated."""
    result = _result(fit)
    check_steady(fit.t_s, y, fit.frequency_hz)
    check_shape(y, y - fit.residual, result.readings / result.cycles)
    if result.phase_rad is not None:
        check_frequency(fit.frequency_hz, stated_hz)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _LinearFit:
    """Solution at one frequency: (s, c) of each order, offset, drift; and frequency, where it is free."""

    t_s: FloatArray
    orders: int
    frequency_hz: float
    solution: FloatArray
    covariance: FloatArray
    residual: FloatArray
    noise: float


def _fit(t: FloatArray, y: FloatArray, frequency_hz: float, sd_frequency_hz: float) -> _LinearFit:
    span_s = float(t[-1] - t[0])
    if span_s * frequency_hz < MIN_CYCLES - 1e-6 - frequency_hz * span_s / max(t.size, 1):
        raise RecordError(f"{span_s * frequency_hz:.2g} cycles are too few to tell motion from drift")
    orders = _orders(t, frequency_hz)
    is_free = sd_frequency_hz > 0
    count = 2 * orders + 2 + is_free
    if t.size < count + MIN_EXCESS_READINGS:
        raise RecordError(f"{t.size} readings are too few")
    start_hz, resolution_hz = frequency_hz, 0.5 / span_s
    design = _design(t, frequency_hz, orders)
    solution = _solve(design, y)
    for _ in range(ITERATIONS if is_free else 0):
        extended, right = _with_frequency(t, y, design, solution, frequency_hz, orders), y - design @ solution
        noise2 = max(float(right @ right) / max(t.size - count, 1), 1e-30)
        prior = math.sqrt(noise2) / sd_frequency_hz  # 0 for a frequency that is not known at all
        row = np.append(np.zeros(design.shape[1]), prior)
        step = _solve(np.vstack((extended, row)), np.append(right, prior * (start_hz - frequency_hz)))[-1]
        moved = frequency_hz + float(np.clip(step, -resolution_hz, resolution_hz))
        done = abs(moved - frequency_hz) < 1e-10 * frequency_hz
        frequency_hz = float(np.clip(moved, 0.5 * start_hz, 1.5 * start_hz))
        design = _design(t, frequency_hz, orders)
        solution = _solve(design, y)
        if done:
            break
    residual = y - design @ solution
    if is_free:
        design = _with_frequency(t, y, design, solution, frequency_hz, orders)
        solution = np.append(solution, frequency_hz)
    covariance, noise = _covariance(t, y, design, residual, orders, frequency_hz, sd_frequency_hz)
    return _LinearFit(t, orders, frequency_hz, solution, covariance, residual, noise)


def _solve(design: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design, y)[0], np.float64)


def _design(t: FloatArray, frequency_hz: float, orders: int) -> FloatArray:
    """(n, 2·orders + 2) columns sin nωt, cos nωt, 1 and t − t_m."""
    angle = 2.0 * math.pi * frequency_hz * t
    waves = [wave(order * angle) for order in range(1, orders + 1) for wave in (np.sin, np.cos)]
    return np.stack([*waves, np.ones_like(t), t - (t[0] + t[-1]) / 2.0], axis=1)


def _with_frequency(
    t: FloatArray, y: FloatArray, design: FloatArray, solution: FloatArray, frequency_hz: float, orders: int
) -> FloatArray:
    """The columns, and the derivative by the frequency about the record's middle."""
    by_frequency = np.zeros_like(y)
    for order in range(1, orders + 1):
        s, c = solution[2 * order - 2], solution[2 * order - 1]
        turn = order * (s * design[:, 2 * order - 1] - c * design[:, 2 * order - 2])
        by_frequency += 2.0 * math.pi * t * turn
    return np.column_stack((design, by_frequency))


def _covariance(
    t: FloatArray,
    y: FloatArray,
    design: FloatArray,
    residual: FloatArray,
    orders: int,
    frequency_hz: float,
    sd_frequency_hz: float,
) -> tuple[FloatArray, float]:
    """Covariance of the solution, and the standard deviation of a reading."""
    freedom = max(t.size - design.shape[1], 3)
    # A converter's steps are noise even where the residuals happen to be smaller.
    rms, step = math.sqrt(float(residual @ residual) / freedom), smallest_step(y)
    variance = max(rms, step / math.sqrt(12.0)) ** 2
    precision = design.T @ design / variance
    if 0 < sd_frequency_hz < math.inf:
        precision[-1, -1] += 1.0 / sd_frequency_hz**2
    scale = np.sqrt(np.diag(precision))
    scale[scale == 0] = 1.0
    covariance = np.linalg.pinv(precision / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    # The variance itself is known from `freedom` values: what it divides is distributed as Student's t.
    covariance *= freedom / (freedom - 2.0)
    if rms < DITHER * step:
        covariance *= max(float(t[-1] - t[0]) * frequency_hz, 1.0)
    inflation = np.sqrt(_colour(t, residual, orders, frequency_hz, design.shape[1]))
    return covariance * np.outer(inflation, inflation), math.sqrt(variance)


def _colour(t: FloatArray, residual: FloatArray, orders: int, frequency_hz: float, count: int) -> FloatArray:
    """By how much the noise's spectral density at each parameter's frequency exceeds that of white noise."""
    power = float(residual @ residual)
    correlation = float(residual[1:] @ residual[:-1]) / power if power > 0 else 0.0
    if correlation < 2.0 / math.sqrt(residual.size):
        return np.ones(count)
    r = min(correlation, MAX_AUTOCORRELATION)
    step_s = float(t[-1] - t[0]) / (t.size - 1)
    hertz = np.zeros(count)
    hertz[: 2 * orders] = np.repeat(np.arange(1, orders + 1) * frequency_hz, 2)
    hertz[2 * orders + 2 :] = frequency_hz
    density = (1.0 - r**2) / (1.0 - 2.0 * r * np.cos(2.0 * math.pi * hertz * step_s) + r**2)
    return np.maximum(density, 1.0)


def _result(fit: _LinearFit) -> PeriodicFit:
    amplitudes, phases, slopes = [], [], []
    for order in range(1, fit.orders + 1):
        s, c = (float(value) for value in fit.solution[2 * order - 2 : 2 * order])
        size = math.hypot(s, c)
        amplitudes.append(size)
        phases.append(math.atan2(c, s))
        by_amplitude, by_phase = np.zeros(fit.solution.size), np.zeros(fit.solution.size)
        at, unit = slice(2 * order - 2, 2 * order), max(size, 1e-300)
        by_amplitude[at] = (s / unit, c / unit) if size > 0 else (1.0, 0.0)
        by_phase[at] = (-c / unit**2, s / unit**2)
        slopes.append((by_amplitude, by_phase))

    def sd(slope: FloatArray) -> float:
        return math.sqrt(max(float(slope @ fit.covariance @ slope), 0.0))

    def phase_of(phase_rad: float, slope: FloatArray, sure: bool) -> tuple[float | None, float | None]:
        sd_rad = sd(slope) if np.isfinite(slope).all() else math.inf
        if not sure or not sd_rad < MAX_PHASE_SD_RAD:
            return None, None
        return math.remainder(phase_rad, 2.0 * math.pi), sd_rad

    sds = [sd(by_amplitude) for by_amplitude, _ in slopes]
    first = phase_of(phases[0], slopes[0][1], amplitudes[0] > sds[0])
    harmonics = tuple(
        RecordHarmonic(
            order,
            amplitudes[order - 1],
            sds[order - 1],
            *phase_of(
                phases[order - 1] - order * phases[0],
                slopes[order - 1][1] - order * slopes[0][1],
                first[0] is not None and amplitudes[order - 1] > sds[order - 1],
            ),
        )
        for order in range(2, fit.orders + 1)
    )
    level, is_free = 2 * fit.orders, fit.solution.size > 2 * fit.orders + 2
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    step_s = float(fit.t_s[-1] - fit.t_s[0]) / (fit.t_s.size - 1)
    return PeriodicFit(
        frequency_hz=fit.frequency_hz,
        sd_frequency_hz=float(spread[-1]) if is_free else 0.0,
        amplitude=amplitudes[0],
        sd=sds[0],
        phase_rad=first[0],
        sd_phase_rad=first[1],
        harmonics=harmonics,
        offset=float(fit.solution[level]),
        sd_offset=float(spread[level]),
        drift_per_s=float(fit.solution[level + 1]),
        sd_drift_per_s=float(spread[level + 1]),
        noise=fit.noise,
        readings=int(fit.t_s.size),
        cycles=(float(fit.t_s[-1] - fit.t_s[0]) + step_s) * fit.frequency_hz,
    )


def _orders(t: FloatArray, frequency_hz: float) -> int:
    """Harmonics that the rate of readings shows and their number can carry."""
    rate_hz = (t.size - 1) / float(t[-1] - t[0])
    shown = int(rate_hz / (MIN_READINGS_PER_CYCLE * frequency_hz))
    carried = (t.size - MIN_EXCESS_READINGS - 3) // 4
    return max(1, min(MAX_ORDER, shown, carried))


def _search(t: FloatArray, y: FloatArray) -> float:
    """Frequency of the strongest sine, hertz."""
    even = np.linspace(t[0], t[-1], t.size)
    try:
        found = fit_free_sine(even - even[0], np.interp(even, t, y))
    except ValueError:
        raise RecordError(f"{t.size} readings are too few to search for a sine") from None
    if not found.is_significant:
        raise RecordError("no sine stands out from the noise")
    return found.frequency_hz
