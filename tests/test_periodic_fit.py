"""Fundamental, harmonics, drift and offset of a record, with the standard deviations that they claim."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from labdaemon.periodic_fit import FloatArray, PeriodicFit, fit_periodic
from labdaemon.record_range import RecordError

RATE_HZ = 500.0


def record(
    rng: np.random.Generator,
    *,
    n: int = 500,
    rate_hz: float = RATE_HZ,
    frequency_hz: float = 5.0,
    noise: float = 0.01,
    third: float = 0.05,
    correlation: float = 0.0,
) -> tuple[FloatArray, FloatArray, float, float]:
    """Times, readings, phase of the fundamental at 0 and phase of the third harmonic against it."""
    t = np.arange(n) / rate_hz
    phase, delta = rng.uniform(-math.pi, math.pi, 2)
    theta = 2 * math.pi * frequency_hz * t + phase
    white = rng.normal(0.0, noise, n)
    for i in range(1, n if correlation else 0):
        white[i] = correlation * white[i - 1] + math.sqrt(1 - correlation**2) * white[i]
    y = np.sin(theta) + third * np.sin(3 * theta + delta) + 0.3 + 0.1 * (t - t.mean()) + white
    return t, y, phase, delta


def turn(angle: float) -> float:
    return math.remainder(angle, 2 * math.pi)


def third_of(fit: PeriodicFit) -> tuple[float, float, float, float]:
    one = fit.harmonics[1]
    assert one.order == 3
    assert one.phase_rad is not None
    assert one.sd_phase_rad is not None
    return one.amplitude, one.sd, one.phase_rad, one.sd_phase_rad


@pytest.mark.parametrize(
    ("n", "rate_hz", "frequency_hz", "noise", "correlation", "sd_hz", "really"),
    [
        (500, 500.0, 5.0, 0.01, 0.0, 0.0, 1.0),
        (500, 500.0, 5.0, 0.01, 0.0, 0.005, 1.0008),  # the gauge's clock is off by 0.08 %
        (400, 500.0, 12.0, 0.03, 0.8, 0.0, 1.0),  # a gauge with a slow filter
        (40, 40.0, 5.0, 0.01, 0.0, 0.0, 1.0),  # few readings
        (720, 500.0, 3.7, 0.01, 0.0, 0.004, 1.0),  # 5.3 cycles
    ],
)
def test_the_pulls_are_those_of_the_stated_standard_deviations(
    n: int, rate_hz: float, frequency_hz: float, noise: float, correlation: float, sd_hz: float, really: float
) -> None:
    rng, pulls = np.random.default_rng(1), []
    for _ in range(80):
        t, y, phase, delta = record(
            rng, n=n, rate_hz=rate_hz, frequency_hz=frequency_hz * really, noise=noise, correlation=correlation
        )
        fit = fit_periodic(t, y, frequency_hz, sd_frequency_hz=sd_hz)
        size, sd, angle, sd_angle = third_of(fit)
        assert fit.phase_rad is not None
        assert fit.sd_phase_rad is not None
        pulls.append(
            [
                (fit.amplitude - 1) / fit.sd,
                turn(fit.phase_rad - phase) / fit.sd_phase_rad,
                (size - 0.05) / sd,
                turn(angle - delta) / sd_angle,
                (fit.offset - 0.3) / fit.sd_offset,
                (fit.drift_per_s - 0.1) / fit.sd_drift_per_s,
            ]
        )
    spread = np.std(pulls, axis=0)
    assert np.all((spread > 0.7) & (spread < 1.35)), spread


def test_a_gap_and_missing_numbers_change_the_result_by_no_more_than_their_noise() -> None:
    t, y, phase, _ = record(np.random.default_rng(2))
    y[37], y[401:430] = math.nan, math.nan
    holes = np.delete(np.arange(t.size), np.s_[150:260])
    fit = fit_periodic(t[holes], y[holes], 5.0, sd_frequency_hz=0.005)
    assert fit.readings == t.size - 110 - 30
    assert fit.amplitude == pytest.approx(1.0, abs=5 * fit.sd)
    assert fit.phase_rad is not None
    assert abs(turn(fit.phase_rad - phase)) < 5 * (fit.sd_phase_rad or 0)


def test_the_strongest_sine_is_found_where_no_frequency_is_stated() -> None:
    t, y, _, delta = record(np.random.default_rng(3), n=2000, frequency_hz=7.123)
    fit = fit_periodic(t, y)
    assert abs(fit.frequency_hz - 7.123) < 5 * fit.sd_frequency_hz < 0.01
    assert abs(turn(third_of(fit)[2] - delta)) < 5 * third_of(fit)[3]


def test_a_converter_without_dither_claims_no_more_than_its_steps_allow() -> None:
    rng, pulls = np.random.default_rng(4), []
    for _ in range(60):
        t, y, _, _ = record(rng, noise=0.0)
        fit = fit_periodic(t, np.round(y / 0.01) * 0.01, 5.0)
        assert fit.noise == pytest.approx(0.01 / math.sqrt(12), rel=0.2)
        pulls.append((fit.amplitude - 1) / fit.sd)
    assert np.std(pulls) < 1.3


def test_rest_has_an_amplitude_within_its_sd_and_no_phase() -> None:
    t = np.arange(500) / RATE_HZ
    fit = fit_periodic(t, np.random.default_rng(6).normal(0.0, 0.002, 500), 5.0)
    assert fit.amplitude < 4 * fit.sd
    assert all(one.phase_rad is None or one.amplitude > one.sd for one in fit.harmonics)


def test_harmonics_beyond_the_rate_of_readings_are_left_out() -> None:
    t, y, _, _ = record(np.random.default_rng(7), n=400, rate_hz=40.0)
    assert [one.order for one in fit_periodic(t, y, 5.0).harmonics] == [2, 3]
    t, y, _, _ = record(np.random.default_rng(7), n=400, rate_hz=40.0, frequency_hz=12.0, third=0.0)
    assert fit_periodic(t, y, 12.0).harmonics == ()


def test_spikes_are_left_out() -> None:
    t, y, _, _ = record(np.random.default_rng(8))
    y[[40, 200, 333]] += 50.0
    fit = fit_periodic(t, y, 5.0)
    assert fit.readings == 497
    assert fit.noise < 0.012


def _sine(t: FloatArray) -> FloatArray:
    return np.asarray(np.sin(2 * np.pi * 5.0 * t))


@pytest.mark.parametrize(
    ("damage", "frequency_hz", "reason"),
    [
        (lambda t: np.clip(_sine(t), -0.8, 0.8), 5.0, "clipped at"),
        (lambda t: np.clip(_sine(t), -2.0, 0.8), 5.0, "clipped at 0.8"),
        (lambda t: np.full(t.size, 1.25), 5.0, "stuck at 1.25"),
        (lambda t: np.full(t.size, math.nan), 5.0, "no readings"),
        (lambda t: np.where(np.arange(t.size) % 3 == 0, math.nan, _sine(t)), 5.0, "no numbers"),
        (lambda t: _sine(t) + 50.0 * (np.arange(t.size) % 20 == 0), 5.0, "outliers"),
        (lambda t: np.where(t < 0.5, _sine(t), 0.0), 5.0, "changes by .* during the record"),  # silent for half
        (lambda t: np.where(t < 0.9, _sine(t), 0.0), 5.0, "changes by"),
        (lambda t: _sine(t + 0.05 * (t > 0.4)), 5.0, "changes by"),  # readings lost without their times
        (lambda t: _sine(1.6 * t), 5.0, "changes by"),  # at 8 Hz
        (lambda t: _sine(1.03 * t), 5.0, "changes by"),
        (lambda t: (1.5 * _sine(t) + 1) % 2 - 1, 5.0, "jumps over its whole range"),
        (lambda t: np.clip(_sine(t), -2, 0.7) + np.random.default_rng(3).normal(0, 1e-3, 500), 5.0, "clipped near"),
        (_sine, 0.7, "cycles are too few"),
        (_sine, RATE_HZ / 4, "harmonic 3 looks like the motion itself"),
        (_sine, 240.0, "readings/s are too few"),
        (lambda t: np.random.default_rng(9).normal(size=t.size), None, "no sine stands out"),
    ],
)
def test_a_record_that_shows_nothing_gives_a_reason(
    damage: Callable[[FloatArray], FloatArray], frequency_hz: float | None, reason: str
) -> None:
    t = np.arange(500) / RATE_HZ
    with pytest.raises(RecordError, match=reason):
        fit_periodic(t, damage(t), frequency_hz)


@pytest.mark.parametrize("n", [0, 1, 2, 9])
def test_a_handful_of_readings_gives_a_reason(n: int) -> None:
    t = np.arange(n) / 10.0
    with pytest.raises(RecordError, match=r"too few|no readings|equal readings"):
        fit_periodic(t, np.sin(2 * np.pi * 1.3 * t), 1.3)


def test_what_is_steady_enough_is_measured() -> None:
    rng = np.random.default_rng(12)
    for change in (lambda t: 1 + 0.1 * t, lambda t: 1 + 0.2 * np.sin(40 * t), lambda t: 1 + 0.3 * np.cos(314 * t)):
        for noise in (1e-3, 1.0):
            t = np.arange(500) / RATE_HZ
            fit = fit_periodic(t, change(t) * _sine(t) + rng.normal(0, noise, 500), 5.0, sd_frequency_hz=5e-3)
            assert abs(fit.amplitude - 1.0) < 4 * fit.sd + 0.06


def test_a_clock_that_is_far_off_is_refused() -> None:
    t = np.arange(500) / RATE_HZ
    with pytest.raises(RecordError, match=r"it moves at 5\.15 Hz, not at 5 Hz"):
        fit_periodic(t, _sine(1.03 * t), 5.0, sd_frequency_hz=5e-2)


def test_packets_of_readings_with_one_time_are_refused() -> None:
    t = np.repeat(np.arange(0, 500, 10) / RATE_HZ, 10)
    with pytest.raises(RecordError, match="90% of the readings have the time of the one before"):
        fit_periodic(t, _sine(t), 5.0)


def test_a_record_of_very_many_readings_is_averaged() -> None:
    t, y, *_ = record(np.random.default_rng(13), n=400_000, rate_hz=400_000.0)
    fit = fit_periodic(t, y, 5.0, sd_frequency_hz=5e-3)
    assert fit.readings == 50_000
    assert abs(fit.amplitude - 1.0) < 5 * fit.sd < 5e-4


def test_times_that_do_not_ascend_are_refused() -> None:
    t = np.arange(100) / RATE_HZ
    with pytest.raises(RecordError, match="do not ascend"):
        fit_periodic(t[::-1], np.sin(t), 5.0)


def test_a_sine_of_a_few_steps_is_not_clipped() -> None:
    t = np.arange(1000) / RATE_HZ
    y = np.round(3.0 * np.sin(2 * np.pi * 5.03 * t)) + 0.0
    assert fit_periodic(t, y, 5.03).amplitude == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize("shift", [0.1, 1.9, 3.3, 4.7, 6.1])
def test_any_phase_is_found_from_no_start(shift: float) -> None:
    t = np.linspace(0.0, 3.0, 300)
    y = 1.3 * np.sin(2 * np.pi * t + shift) + np.random.default_rng(5).normal(0, 0.05, 300)
    fit = fit_periodic(t, y, 1.0, sd_frequency_hz=0.01)
    assert fit.amplitude == pytest.approx(1.3, abs=4 * fit.sd)
    assert abs(turn((fit.phase_rad or 0.0) - shift)) < 4 * (fit.sd_phase_rad or 0.0)


def test_less_than_a_cycle_of_unknown_frequency_is_no_sine() -> None:
    t = np.linspace(0.0, 0.8, 200)
    y = np.sin(2 * np.pi * t) + np.random.default_rng(5).normal(0, 0.1, 200)
    with pytest.raises(RecordError, match=r"less than a cycle|no sine"):
        fit_periodic(t, y)


def test_readings_in_tight_clusters_claim_what_they_know() -> None:
    rng, pulls = np.random.default_rng(6), []
    for _ in range(40):
        t = np.sort(np.concatenate([k + rng.uniform(0, 0.02, 20) for k in range(10)]))
        y = np.sin(2 * np.pi * 0.2137 * t + rng.uniform(0, 6)) + rng.normal(0, 0.02, t.size)
        fit = fit_periodic(t, y, 0.2137)
        pulls.append((fit.amplitude - 1) / fit.sd)
    assert 0.6 < float(np.std(pulls)) < 1.5
