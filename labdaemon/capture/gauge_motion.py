"""What each gauge saw during an exposure: its record is read when the shutters close, and a periodic motion fitted.

Nothing here holds up a capture or spoils it: a gauge that is silent, clipped or too slow is reported with the reason
instead of numbers.
"""

from __future__ import annotations

import asyncio
import logging
import math
from dataclasses import dataclass

from labdaemon.capture.abilities import GaugeRecord, RecordSource
from labdaemon.capture.devices import Gauge
from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.clock import Clock
from labdaemon.errors import DeviceError, LabdaemonError
from labdaemon.events import GaugeMotion
from labdaemon.journal.records import CaptureRecord
from labdaemon.periodic_fit import PeriodicFit, fit_periodic
from labdaemon.record_range import RecordError

LEAST_CYCLES = 4.0
"""An exposure of fewer is widened into the time before it: the table moves steadily."""
SEARCH_S = 4.0
"""Least length of a record in which an unknown frequency is searched for."""
LONGEST_S = 60.0
READ_S = 2.0
"""Longest wait for a record once its window has passed: frames are fetched meanwhile."""
CLOCK_SD = 1e-3
"""Relative standard deviation of a gauge's clock against the excitation's frequency."""

log: logging.Logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RecordWindow:
    """The time over which gauges are read for a capture.

    Attributes
    ----------
    start_s, duration_s
        On the host's monotonic clock.
    opened_s
        When the shutters opened; NaN where it is known too badly for a phase.
    """

    start_s: float
    duration_s: float
    opened_s: float

    @classmethod
    def of_exposure(
        cls, opened_s: float, exposure_s: float, frequency_hz: float | None, *, is_timed: bool = True
    ) -> RecordWindow:
        """The exposure, widened into the time before it where it holds too few cycles."""
        least_s = SEARCH_S if frequency_hz is None else LEAST_CYCLES / frequency_hz
        duration_s = min(max(exposure_s, least_s), LONGEST_S)
        return cls(opened_s + exposure_s - duration_s, duration_s, opened_s if is_timed else math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class GaugeReport:
    """What a gauge sent over a window, or why it sent nothing."""

    gauge: str
    role: str
    unit: str
    window: RecordWindow
    record: GaugeRecord | None
    reason: str | None = None


async def read_gauges(rig: Rig, clock: Clock, window: RecordWindow) -> list[GaugeReport]:
    """Read every gauge as soon as the window has passed; none of them holds up another, or what else it is asked."""
    await clock.sleep(max(window.start_s + window.duration_s - clock.monotonic(), 0.0))
    return list(await asyncio.gather(*(_read(gauge, window) for gauge in rig.gauges)))


async def _read(gauge: DeviceHandle[Gauge], window: RecordWindow) -> GaugeReport:
    driver = gauge.driver
    about = (str(driver.name), str(driver.role), str(driver.unit), window)
    if not isinstance(driver, RecordSource):
        return GaugeReport(*about, None, "its driver keeps no record")
    source: RecordSource = driver
    try:
        record = await gauge.observe(
            lambda _: source.record(start_s=window.start_s, duration_s=window.duration_s), READ_S
        )
    except LabdaemonError as exc:
        log.warning("gauge %s was not recorded: %s", driver.name, exc)
        return GaugeReport(*about, None, _bare(exc))
    return GaugeReport(*about, record)


def _bare(exc: LabdaemonError) -> str:
    """The message without the device's name, which the report has."""
    text, device = str(exc), exc.device if isinstance(exc, DeviceError) else None
    return text.removeprefix(f"{device}: ") if device else text


def fit_gauges(reports: list[GaugeReport], capture: CaptureRecord) -> tuple[GaugeMotion, ...]:
    """Fit the motion of each gauge, at the capture's frequency or, where that is unknown, at the strongest sine's.

    Parameters
    ----------
    reports
        From `read_gauges`.
    capture
        With its frequency and opening phase as far as they are known.
    """
    return tuple(_fit_gauge(report, capture) for report in reports)


def _fit_gauge(report: GaugeReport, capture: CaptureRecord) -> GaugeMotion:
    about = {"gauge": report.gauge, "role": report.role, "unit": report.unit}
    nothing = GaugeMotion(gauge=report.gauge, role=report.role, unit=report.unit)
    if report.record is None:
        return nothing.model_copy(update={"reason": report.reason})
    window, record = report.window, report.record
    frequency_hz = capture.frequency_hz
    # Time counts from the opening; without one it counts from the record's start, and no phase is reported.
    origin_s = window.opened_s - window.start_s if math.isfinite(window.opened_s) else 0.0
    try:
        fit = fit_periodic(
            record.t_s - origin_s, record.values, frequency_hz, sd_frequency_hz=CLOCK_SD * (frequency_hz or 0.0)
        )
    except RecordError as exc:
        log.info("gauge %s during %s: %s", report.gauge, capture.name, exc)
        return nothing.model_copy(update={"reason": str(exc)})
    except Exception as exc:  # a lab's own driver may return anything, and the capture is worth more than its record
        log.exception("the record of gauge %s during %s could not be fitted", report.gauge, capture.name)
        return nothing.model_copy(update={"reason": f"its record could not be fitted ({type(exc).__name__})"})
    opening = capture if math.isfinite(window.opened_s) else None
    return GaugeMotion.model_validate({**about, **_numbers(fit, report, opening)})


def _numbers(fit: PeriodicFit, report: GaugeReport, opening: CaptureRecord | None) -> dict[str, float | int | None]:
    """Members of `GaugeMotion` in millimetres, rounded to what a reader may compare."""
    is_displacement = report.unit == "mm"
    omega = 2.0 * math.pi * fit.frequency_hz

    def to_mm(order: int) -> float:
        """Displacement per unit at a harmonic: acceleration in m/s² is −(nω)² times displacement."""
        return 1.0 if is_displacement else 1000.0 / (order * omega) ** 2

    phase_rad, sd_phase_rad = _excitation_phase(fit, report, opening)
    numbers: dict[str, float | int | None] = {
        "frequency_hz": fit.frequency_hz,
        "sd_frequency_hz": fit.sd_frequency_hz,
        "amplitude_mm": to_mm(1) * fit.amplitude,
        "sd_amplitude_mm": to_mm(1) * fit.sd,
        "phase_rad": phase_rad,
        "sd_phase_rad": sd_phase_rad,
        "readings": fit.readings,
        "duration_s": fit.cycles / fit.frequency_hz,
        "cycles": fit.cycles,
    }
    for one in fit.harmonics:
        h = f"h{one.order}"
        numbers[f"{h}_mm"], numbers[f"sd_{h}_mm"] = to_mm(one.order) * one.amplitude, to_mm(one.order) * one.sd
        if one.phase_rad is not None:
            # Every order of an acceleration is opposite to its displacement: φ_n + π − n(φ_1 + π).
            opposite = 0.0 if is_displacement else (1 - one.order) * math.pi
            numbers[f"{h}_phase_rad"] = math.remainder(one.phase_rad + opposite, 2.0 * math.pi)
            numbers[f"sd_{h}_phase_rad"] = one.sd_phase_rad
    if is_displacement:
        numbers |= {"offset_mm": fit.offset, "sd_offset_mm": fit.sd_offset}
        numbers |= {"drift_mm_s": fit.drift_per_s, "sd_drift_mm_s": fit.sd_drift_per_s, "noise_mm": fit.noise}
    return {key: _rounded(value) for key, value in numbers.items()}


def _rounded(value: float | None) -> float | None:
    """Nine significant digits; None for what is no finite number, which JSON has no word for."""
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.9g}") if math.isfinite(value) else None


def _excitation_phase(
    fit: PeriodicFit, report: GaugeReport, opening: CaptureRecord | None
) -> tuple[float | None, float | None]:
    """Phase against the excitation's reference and its standard deviation; None where either is unknown."""
    if opening is None or opening.phase_rad is None or fit.phase_rad is None or report.record is None:
        return None, None
    timing_rad = 2.0 * math.pi * fit.frequency_hz * report.record.sd_t_s
    sd_rad = math.hypot(fit.sd_phase_rad or 0.0, timing_rad, opening.sd_phase_rad or 0.0)
    if not sd_rad <= 1.0:
        return None, None
    own = fit.phase_rad if report.unit == "mm" else fit.phase_rad + math.pi
    return math.remainder(own - opening.phase_rad, 2.0 * math.pi), sd_rad
