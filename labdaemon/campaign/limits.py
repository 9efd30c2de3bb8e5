"""What a table may be asked to do, checked for every step before it moves.

A sine of semi-amplitude A at f has peak velocity v = 2πf·A and peak acceleration a = (2πf)²·A; driving a mass m takes
the force m·a. The stroke is the table's whole travel, so A may reach half of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ShakerLimits:
    """The table's limits.

    Attributes
    ----------
    stroke_mm
        Whole travel, end to end: twice the largest semi-amplitude.
    velocity_mm_s, acceleration_mm_s2
        Peak values.
    frequency_hz
        Lowest and highest.
    force_n, moving_mass_kg
        Force of the actuator and mass of armature, table and structure; checked when both are given.
    """

    stroke_mm: float
    velocity_mm_s: float
    acceleration_mm_s2: float
    frequency_hz: tuple[float, float]
    force_n: float | None = None
    moving_mass_kg: float | None = None


def peak_velocity_mm_s(frequency_hz: float, amplitude_mm: float) -> float:
    """2πf·A."""
    return 2 * math.pi * frequency_hz * amplitude_mm


def peak_acceleration_mm_s2(frequency_hz: float, amplitude_mm: float) -> float:
    """(2πf)²·A."""
    return (2 * math.pi * frequency_hz) ** 2 * amplitude_mm


def check_frequency(limits: ShakerLimits, frequency_hz: float) -> str | None:
    """Say how this frequency is outside the table's range, or None."""
    low, high = limits.frequency_hz
    if low <= frequency_hz <= high:
        return None
    return f"{frequency_hz:g} Hz is outside the table's {low:g} to {high:g} Hz"


def check_amplitude(limits: ShakerLimits, frequency_hz: float, amplitude_mm: float) -> str | None:
    """Say which limit this excitation crosses (the tightest) and what would be allowed; None if it crosses none.

    Parameters
    ----------
    frequency_hz, amplitude_mm
        Excitation; amplitude of the table, zero to peak.
    """
    allowed = _allowed_mm(limits, frequency_hz)
    tightest = min(allowed, key=lambda name: allowed[name])
    if amplitude_mm <= allowed[tightest] * (1 + 1e-9):
        return None
    acceleration = peak_acceleration_mm_s2(frequency_hz, amplitude_mm)
    what = {
        "stroke": f"{2 * amplitude_mm:g} mm of travel is beyond the table's stroke of {limits.stroke_mm:g} mm",
        "velocity": f"peak velocity {peak_velocity_mm_s(frequency_hz, amplitude_mm):.4g} mm/s is beyond the table's "
        f"{limits.velocity_mm_s:g} mm/s",
        "acceleration": f"peak acceleration {acceleration:.4g} mm/s² is beyond the table's "
        f"{limits.acceleration_mm_s2:g} mm/s²",
        "force": f"force {(limits.moving_mass_kg or 0.0) * acceleration / 1000:.4g} N is beyond the shaker's "
        f"{limits.force_n or 0.0:g} N",
    }[tightest]
    advised = _floor(allowed[tightest])
    return f"{amplitude_mm:g} mm at {frequency_hz:g} Hz: {what}; at most {advised:g} mm is allowed there"


def largest_amplitude_mm(limits: ShakerLimits, frequency_hz: float) -> float:
    """Largest semi-amplitude that crosses no limit at this frequency, millimetres."""
    return min(_allowed_mm(limits, frequency_hz).values())


def _allowed_mm(limits: ShakerLimits, frequency_hz: float) -> dict[str, float]:
    """Largest semi-amplitude by each limit."""
    omega = 2 * math.pi * frequency_hz
    allowed = {
        "stroke": limits.stroke_mm / 2,
        "velocity": limits.velocity_mm_s / omega,
        "acceleration": limits.acceleration_mm_s2 / omega**2,
    }
    if limits.force_n is not None and limits.moving_mass_kg is not None:
        allowed["force"] = 1000 * limits.force_n / limits.moving_mass_kg / omega**2
    return allowed


def _floor(value: float) -> float:
    """Three significant figures, rounded down so that what is advised is allowed."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / unit) * unit
