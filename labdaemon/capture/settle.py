"""When table and structure have settled after a change of excitation.

The structure rings for ln(1000)/(ζ·2πf) seconds to 0.1 % of its answer. With a response gauge settled means that its
amplitude changes by less than a limit from cycle to cycle; without one, that this time has passed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from labdaemon.capture.devices import Gauge, GaugeReading
from labdaemon.capture.rig import CALL_S, DeviceHandle, Rig
from labdaemon.clock import Clock
from labdaemon.errors import DeviceError

MIN_CYCLES = 4.0  # a sine needs two; from four on the change from one to the next shows
MIN_RECORD_S = 0.5  # at high frequencies the gauge's own rate bounds what four cycles say
IN_A_ROW = 2
"""Readings that must agree: one alone may catch a beat at its turning point."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """What the table is to do, and when it counts as done. Amplitude is the table's, zero to peak."""

    frequency_hz: float
    amplitude_mm: float
    max_change_per_cycle: float = 0.001
    timeout_s: float = 60.0
    damping_ratio: float = 0.01
    """Assumed without a response gauge."""


@dataclass(frozen=True, slots=True)
class SettlingResult:
    """What the gauges read at the end, None for a gauge that is not there, and how long it took."""

    table: GaugeReading | None
    response: GaugeReading | None
    waited_s: float


def settling_time_s(frequency_hz: float, damping_ratio: float) -> float:
    """Time for a transient of the structure to fall to 0.1 %: ln(1000)/(ζ·2πf), seconds (5 Hz at 1 %: 22 s)."""
    return math.log(1000.0) / (damping_ratio * 2.0 * math.pi * frequency_hz)


def record_s(frequency_hz: float) -> float:
    """Length of a gauge record that holds enough cycles."""
    return max(MIN_CYCLES / frequency_hz, MIN_RECORD_S)


def is_steady(reading: GaugeReading, max_change_per_cycle: float) -> bool:
    """Whether the amplitude no longer changes; what is within 3 sd of rest has nothing left to settle."""
    return reading.change_per_cycle <= max_change_per_cycle or reading.value <= 3.0 * reading.sd


async def read_gauge(gauge: DeviceHandle[Gauge], frequency_hz: float) -> GaugeReading:
    """One reading over enough cycles."""
    duration_s = record_s(frequency_hz)
    return await gauge.call(lambda driver: driver.read(frequency_hz, duration_s=duration_s), duration_s + CALL_S)


async def wait_settled(rig: Rig, excitation: Excitation, clock: Clock) -> SettlingResult:
    """Wait until table and structure have settled.

    Raises
    ------
    DeviceError
        They have not in time.
    """
    start, frequency_hz, timeout_s = clock.monotonic(), excitation.frequency_hz, excitation.timeout_s
    response, table = rig.gauge("response"), rig.gauge("table")
    reading: GaugeReading | None = None
    if response is None:
        await clock.sleep(min(settling_time_s(frequency_hz, excitation.damping_ratio), timeout_s))
    else:
        steady = 0
        while steady < IN_A_ROW:
            await clock.sleep(record_s(frequency_hz))  # no reading may reach back beyond the one before, or the change
            reading = await read_gauge(response, frequency_hz)
            steady = steady + 1 if is_steady(reading, excitation.max_change_per_cycle) else 0
            if steady < IN_A_ROW and clock.monotonic() - start > timeout_s:
                raise DeviceError(
                    f"the structure has not settled within {timeout_s:g} s at {frequency_hz:g} Hz (still changing "
                    f"by {reading.change_per_cycle:.2%} a cycle); raise settle.timeout_s or look for what disturbs it",
                    device=response.driver.name,
                )
    table_reading = await read_gauge(table, frequency_hz) if table is not None else None
    return SettlingResult(table_reading, reading, clock.monotonic() - start)
