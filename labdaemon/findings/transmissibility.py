"""Transmissibility: how far each target moves per millimetre of the table, at each step, with its standard deviation.

The amplitude of a target is the major semi-axis of its orbit; the ratio to the table's amplitude (both zero to peak) is
the absolute displacement transmissibility of the textbooks (Ewins 2000, Modal Testing, section 1.4). The error of the
table's amplitude is common to all targets of a step, so it is given apart, too: ratios between targets do not have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from labdaemon.findings.response import FloatArray, ResponseSeries

LARGEST_TABLE_SD = 0.5
"""Relative sd of the table's amplitude from which on it counts as unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Transmissibility:
    """Amplitudes per amplitude of the table.

    Attributes
    ----------
    frequency_hz
        (K,) in ascending order.
    value, sd
        (K, T) mm per mm, and standard deviation with that of the table; NaN where the target was not measured or the
        table's amplitude is not known.
    sd_common
        (K,) relative standard deviation that all targets of a step share: that of the table's amplitude.
    targets
        Names, T of them.
    """

    frequency_hz: FloatArray
    value: FloatArray
    sd: FloatArray
    sd_common: FloatArray
    targets: tuple[str, ...]

    def peak(self) -> tuple[str, float, float, float] | None:
        """Target, frequency in Hz, value and sd of the largest ratio; None where there is none."""
        if not np.isfinite(self.value).any():
            return None
        step, place = np.unravel_index(int(np.nanargmax(self.value)), self.value.shape)
        at = (step, place)
        return self.targets[place], float(self.frequency_hz[step]), float(self.value[at]), float(self.sd[at])

    def to_json(self) -> dict[str, Any]:
        """Lists over frequency, by target; null where there is no number."""
        return {
            "frequency_hz": self.frequency_hz.tolist(),
            "sd_common": _listed(self.sd_common),
            "targets": {
                name: {"value": _listed(self.value[:, place]), "sd": _listed(self.sd[:, place])}
                for place, name in enumerate(self.targets)
            },
        }


def transmissibility_of(series: ResponseSeries) -> Transmissibility:
    """Transmissibility of all targets at all steps.

    Parameters
    ----------
    series
        Motion of targets; directions that were not measured count as 0.
    """
    order = np.argsort(series.frequency_hz, kind="stable")
    sorted_series = series.subset(order)
    size, sd_size = amplitudes(sorted_series)
    sd_table = np.where(sorted_series.sd_table < LARGEST_TABLE_SD, sorted_series.sd_table, np.nan)
    value, sd = amplitude_ratio(size, sd_size, sorted_series.table_mm[:, None], sd_table[:, None])
    names = series.targets or tuple(str(place) for place in range(value.shape[1]))
    return Transmissibility(sorted_series.frequency_hz, value, sd, sd_table, names)


def amplitude_ratio(
    size_mm: FloatArray, sd_mm: FloatArray, table_mm: FloatArray, sd_table: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Ratio of amplitudes to the table's, and its standard deviation to first order; NaN where any of them is.

    Parameters
    ----------
    size_mm, sd_mm
        (K, T) amplitudes of targets, mm.
    table_mm, sd_table
        (K, 1) amplitude of the table, mm, and its relative standard deviation.
    """
    ratio = size_mm / table_mm
    sd: FloatArray = np.hypot(sd_mm / table_mm, ratio * sd_table)
    return np.where(np.isfinite(sd), ratio, np.nan), sd


def amplitudes(series: ResponseSeries) -> tuple[FloatArray, FloatArray]:
    """(K, T) major semi-axes, mm, and their standard deviations to first order; NaN where nothing was measured.

    With the singular value decomposition (a b) = s₁ u₁ v₁ᵀ + s₂ u₂ v₂ᵀ the derivative of s₁ by (a b) is u₁ v₁ᵀ.
    """
    valid = series.valid()
    pair = np.stack([series.amplitude.real, series.amplitude.imag], axis=3)
    left, singular, right = np.linalg.svd(np.where(valid[..., None], pair, 0.0), full_matrices=False)
    slope = left[..., :, :1] * right[..., :1, :]
    sd = np.where(valid[..., None], np.stack([series.sd_real, series.sd_imag], axis=3), 0.0)
    spread = np.sqrt(np.sum((slope * sd) ** 2, axis=(2, 3)))
    is_seen = valid.any(axis=2)
    return np.where(is_seen, singular[..., 0], np.nan), np.where(is_seen, spread, np.nan)


def _listed(values: FloatArray) -> list[float | None]:
    return [float(one) if np.isfinite(one) else None for one in values]
