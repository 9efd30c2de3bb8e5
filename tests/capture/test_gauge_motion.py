"""From a gauge's record to its motion in millimetres: units, phases, and records that show nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.capture.abilities import GaugeRecord
from labdaemon.capture.gauge_motion import GaugeReport, RecordWindow, fit_gauges
from labdaemon.capture.request import CaptureRequest
from labdaemon.journal.records import CaptureRecord

WINDOW = RecordWindow.of_exposure(100.0, 1.0, 5.0)


def capture(phase_rad: float | None = 0.3, frequency_hz: float | None = 5.0) -> CaptureRecord:
    request = CaptureRequest("c", "n", 0, 0, "n", False, None, None, frequency_hz, 2.0, 1.0, ("left",))
    return replace(request.intended(), phase_rad=phase_rad, sd_phase_rad=0.001)


def report(unit: str = "mm", *, third: float = 0.05, delta: float = 0.4, lag: float = -0.5, sd_t_s: float = 0.001):
    """A point whose displacement is 2 sin(ωt + lag) mm and a third harmonic, with ωt = 0.3 at the opening."""
    t = np.arange(500) / 500.0
    theta = 0.3 + 2 * math.pi * 5.0 * t + lag
    omega = 2 * math.pi * 5.0
    if unit == "mm":
        y = 2.0 * np.sin(theta) + 2.0 * third * np.sin(3 * theta + delta)
    else:
        y = -(omega**2) * 2e-3 * np.sin(theta) - 9 * omega**2 * 2e-3 * third * np.sin(3 * theta + delta)
    noise = np.random.default_rng(1).normal(0, 1e-3 * np.abs(y).max(), 500)
    return GaugeReport("g", "table", unit, WINDOW, GaugeRecord(t, y + noise, sd_t_s))


@pytest.mark.parametrize("unit", ["mm", "m/s2"])
def test_displacement_and_acceleration_give_the_same_motion(unit: str) -> None:
    [found] = fit_gauges([report(unit)], capture())
    assert found.amplitude_mm == pytest.approx(2.0, rel=2e-3)
    assert found.phase_rad == pytest.approx(-0.5, abs=0.02)
    assert found.h3_mm == pytest.approx(0.1, abs=0.004)
    assert found.h3_phase_rad == pytest.approx(0.4, abs=0.05)
    assert (found.offset_mm is None) == (unit == "m/s2")


def test_the_wires_delay_is_in_the_phases_sd_and_ends_it() -> None:
    [found] = fit_gauges([report(sd_t_s=0.01)], capture())
    assert found.sd_phase_rad == pytest.approx(2 * math.pi * 5.0 * 0.01, rel=0.01)
    for sd_t_s in (0.1, math.nan):
        [found] = fit_gauges([report(sd_t_s=sd_t_s)], capture())
        assert found.phase_rad is None
        assert found.h3_phase_rad is not None  # no clock plays a part in it


def test_without_a_reference_or_an_opening_there_is_no_phase() -> None:
    untimed = RecordWindow.of_exposure(100.0, 1.0, 5.0, is_timed=False)
    for one, known in ((report(), capture(None)), (replace(report(), window=untimed), capture())):
        [found] = fit_gauges([one], known)
        assert found.phase_rad is None
        assert found.amplitude_mm == pytest.approx(2.0, rel=2e-3)


def test_an_unknown_frequency_is_searched_for() -> None:
    [found] = fit_gauges([report()], capture(None, None))
    assert found.frequency_hz == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (GaugeRecord(np.empty(0), np.empty(0)), "no readings"),
        (GaugeRecord(np.arange(500) / 500, np.full(500, 3.0)), "stuck at 3"),
        (GaugeRecord(np.arange(500) / 500, np.full(400, 3.0)), "one for each reading"),
        (GaugeRecord([1, 2], ["a", "b"]), "could not be fitted"),  # type: ignore[arg-type]
        (None, "its cable"),
    ],
)
def test_what_shows_nothing_has_a_reason_and_no_number(record: GaugeRecord | None, reason: str) -> None:
    [found] = fit_gauges([GaugeReport("g", "table", "mm", WINDOW, record, "its cable")], capture())
    assert reason in (found.reason or "")
    assert found.amplitude_mm is None
    assert found.model_dump(exclude_none=True).keys() <= {"gauge", "role", "unit", "reason"}


def test_a_short_exposure_is_widened_into_the_time_before_it() -> None:
    short = RecordWindow.of_exposure(100.0, 0.2, 5.0)
    assert (short.start_s, short.duration_s, short.opened_s) == pytest.approx((99.4, 0.8, 100.0))
    assert RecordWindow.of_exposure(100.0, 0.2, None).duration_s == pytest.approx(4.0)
    assert RecordWindow.of_exposure(100.0, 900.0, 5.0).duration_s == pytest.approx(60.0)
