"""What the table gauge says of an excitation that others set, and whether it agrees with what they state."""

from __future__ import annotations

import math
from dataclasses import dataclass

from labdaemon.capture.devices import GaugeReading, SineFinder
from labdaemon.capture.rig import CALL_S, Rig
from labdaemon.capture.settle import record_s
from labdaemon.capture.table import displacement_mm
from labdaemon.errors import DeviceError

LEAST_RECORD_S, LONGEST_RECORD_S = 4.0, 20.0
CLOCK_SD = 1e-3
"""Relative standard deviation of a gauge's own clock: many send "500 readings a second" by a timer in software."""
CALIBRATION_SD = 0.01
"""Relative standard deviation of a gauge's calibration, and of how well a stated amplitude is kept."""
SIGMAS = 3.0  # one statement in 370 that is right would be contradicted


@dataclass(frozen=True, slots=True)
class TableMotion:
    """The table as its gauge saw it about the time of an exposure.

    Attributes
    ----------
    gauge
        The gauge's name.
    frequency_hz, sd_frequency_hz
        Of the strongest sine; None where nothing stands out from the noise, or the gauge cannot search.
    amplitude_mm, sd_mm
        Zero to peak at `frequency_hz`, or at the stated frequency; None where neither is known.
    """

    gauge: str
    frequency_hz: float | None
    sd_frequency_hz: float
    amplitude_mm: float | None
    sd_mm: float


async def observe_table(rig: Rig, stated_hz: float | None, exposure_s: float) -> TableMotion | None:
    """Ask the table gauge; None where there is none.

    Parameters
    ----------
    stated_hz
        Frequency at which to look in any case; None to search only.
    exposure_s
        The record is as long at least.

    Raises
    ------
    DeviceError
        The gauge does not answer.
    """
    gauge = rig.gauge("table")
    if gauge is None:
        return None
    driver, duration_s = gauge.driver, min(max(exposure_s, LEAST_RECORD_S), LONGEST_RECORD_S)
    frequency_hz, sd_hz, value, sd = None, 0.0, None, 0.0
    if isinstance(driver, SineFinder):
        finder: SineFinder = driver
        sine = await gauge.call(lambda _: finder.find_sine(duration_s=duration_s), duration_s + CALL_S)
        if sine.is_significant:
            frequency_hz, sd_hz, value, sd = sine.frequency_hz, sine.sd_frequency_hz, sine.value, sine.sd
    if frequency_hz is None and stated_hz is not None:
        needed_s = max(duration_s, record_s(stated_hz))
        reading = await gauge.call(lambda one: one.read(stated_hz, duration_s=needed_s), needed_s + CALL_S)
        value, sd = reading.value, reading.sd
    at_hz = frequency_hz if frequency_hz is not None else stated_hz
    if value is None or at_hz is None:
        return TableMotion(driver.name, None, 0.0, None, 0.0)
    to_mm = displacement_mm(GaugeReading(1.0, 0.0, 0.0, 0.0), driver.unit, at_hz)
    return TableMotion(driver.name, frequency_hz, sd_hz, to_mm * value, to_mm * sd)


def contradiction(seen: TableMotion, stated_hz: float | None, stated_mm: float | None) -> DeviceError | None:
    """What was stated and what the gauge saw differ by more than three standard deviations; None where they agree."""
    parts: list[str] = []
    if stated_hz is not None and seen.frequency_hz is not None:
        sd_hz = math.hypot(seen.sd_frequency_hz, CLOCK_SD * seen.frequency_hz)
        if abs(stated_hz - seen.frequency_hz) > SIGMAS * sd_hz:
            parts.append(f"{seen.frequency_hz:.4g} Hz where {stated_hz:.4g} Hz was stated")
    if stated_mm is not None and seen.amplitude_mm is not None:
        sd_mm = math.hypot(seen.sd_mm, CALIBRATION_SD * seen.amplitude_mm)
        if abs(stated_mm - seen.amplitude_mm) > SIGMAS * sd_mm:
            parts.append(f"{seen.amplitude_mm:.3g} mm where {stated_mm:.3g} mm was stated")
    is_still = seen.frequency_hz is None and (seen.amplitude_mm or 0.0) <= SIGMAS * seen.sd_mm
    if stated_hz is not None and stated_mm is None and seen.amplitude_mm is not None and is_still:
        parts.append(f"no motion where {stated_hz:.4g} Hz was stated")
    if not parts:
        return None
    return DeviceError(
        f"sees {' and '.join(parts)}: the capture is kept as stated; check the statement, the gauge and its unit",
        device=seen.gauge,
    )
