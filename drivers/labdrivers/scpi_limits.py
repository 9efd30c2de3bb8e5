"""What a shaker's driver refuses to set, whatever the caller checked before."""

from __future__ import annotations

import math

from labdaemon.campaign.limits import check_amplitude, check_frequency
from labdaemon.errors import LimitError
from labdrivers.scpi_settings import ShakerSettings


def check_excitation(name: str, settings: ShakerSettings, frequency_hz: float, amplitude_mm: float) -> None:
    """Refuse what the table cannot do.

    Parameters
    ----------
    name
        The section's name in the rig file.
    settings
        The section.
    frequency_hz, amplitude_mm
        The excitation; the amplitude is zero to peak.

    Raises
    ------
    LimitError
        It is no excitation, or it lies beyond the table's limits.
    """
    if not (math.isfinite(frequency_hz) and math.isfinite(amplitude_mm)) or frequency_hz <= 0 or amplitude_mm < 0:
        raise LimitError(f"{frequency_hz} Hz at {amplitude_mm} mm is no excitation", key=name)
    limits = settings.limits
    crossed = check_frequency(limits, frequency_hz) or check_amplitude(limits, frequency_hz, amplitude_mm)
    if crossed:
        raise LimitError(crossed, key=f"{name}.limits")


def check_level(
    name: str, settings: ShakerSettings, frequency_hz: float, amplitude_mm: float, *, level_v: float, lowest_mm: float
) -> None:
    """Refuse a level that the generator cannot put out.

    Parameters
    ----------
    name, settings, frequency_hz, amplitude_mm
        As of `check_excitation`.
    level_v
        The level that the amplitude needs, volts zero to peak.
    lowest_mm
        Amplitude at the generator's lowest level, mm.

    Raises
    ------
    LimitError
        It is below the lowest level or above the highest.
    """
    if 0 < level_v < settings.lowest_level_v:
        raise LimitError(
            f"{amplitude_mm:g} mm at {frequency_hz:g} Hz needs {level_v:.2g} V, below the generator's "
            f"{settings.lowest_level_v:g} V; at least {lowest_mm:.2g} mm is possible",
            key=f"{name}.lowest_level_v",
        )
    if level_v > settings.highest_level_v:
        raise LimitError(
            f"{amplitude_mm:g} mm at {frequency_hz:g} Hz needs {level_v:.3g} V, limit "
            f"{settings.highest_level_v:g} V; lower the amplitude, or raise the gain and calibrate",
            key=f"{name}.highest_level_v",
        )
