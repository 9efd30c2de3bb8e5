"""Envelopes as arrays over captures and targets: the form that HDF5, MATLAB and netCDF files hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from labdaemon.correlations import MOTION, NUMBERS, POSITION
from labdaemon.envelope import TargetEnvelope
from labdaemon.export.results import FolderResults
from labdaemon.findings import amplitude_ratio
from labdaemon.flags import Flag

FloatArray = NDArray[np.float64]
TextArray = NDArray[np.str_]

VECTORS = {
    "mean_mm": "mean position over the exposure",
    "a_mm": "motion in phase with the excitation (sine); without phase the major semi-axis of the orbit",
    "b_mm": "motion in quadrature (cosine); without phase the minor semi-axis of the orbit",
    "sd_mean_mm": "standard deviation of mean_mm",
    "sd_a_mm": "standard deviation of a_mm",
    "sd_b_mm": "standard deviation of b_mm",
}
"""Vectors of a target, (captures, targets, 3) mm, and what they are."""
SCALARS = {
    "amplitude_mm": ("mm", "major semi-axis of the orbit, zero to peak"),
    "sd_amplitude_mm": ("mm", "standard deviation of amplitude_mm"),
    "transmissibility": ("1", "amplitude_mm divided by table_amplitude_mm"),
    "sd_transmissibility": ("1", "standard deviation of transmissibility, with that of the table's amplitude"),
}
"""Scalars of a target, (captures, targets), their unit and what they are."""
COVARIANCES = {
    "covariance_mean_mm2": (POSITION, "covariance of x, y, z of mean_mm"),
    "covariance_motion_mm2": (MOTION, "covariance of x, y, z of a_mm, then of b_mm"),
}
"""Covariances of a target, (captures, targets, n, n) mm²: which of the nine numbers, and what they are."""


def covariance_axis(name: str) -> list[str]:
    """What the rows and columns of a covariance belong to."""
    return [f"{number}_mm" for number in NUMBERS[COVARIANCES[name][0]]]


PER_CAPTURE = {
    "frequency_hz": ("Hz", "excitation frequency"),
    "excitation_amplitude_mm": ("mm", "amplitude of the table as it was set, zero to peak"),
    "table_amplitude_mm": ("mm", "amplitude of the table as a gauge on it saw it, else as it was set, zero to peak"),
    "sd_table_amplitude_mm": ("mm", "standard deviation of table_amplitude_mm"),
    "exposure_s": ("s", "exposure time"),
}
"""Numbers of a capture, their unit and what they are; NaN where unknown."""


@dataclass(frozen=True, slots=True)
class EnvelopeCube:
    """All envelopes of a folder as arrays.

    Attributes
    ----------
    captures, targets
        Names.
    per_capture
        `PER_CAPTURE` by name, (captures,) each.
    opened_at
        (captures,) RFC 3339 text, empty where unknown.
    is_phase_known
        (captures,) of bool.
    table_phase_rad
        (captures,) phase of the table against the excitation's reference, 0 where no gauge saw it.
    vectors
        `VECTORS` by name, (captures, targets, 3) each, x y z; NaN where not measured.
    scalars
        `SCALARS` by name, (captures, targets) each.
    covariances
        `COVARIANCES` by name; NaN where not measured, diagonal where only the standard deviations are known.
    flags
        (captures, targets) of text, separated by ``;``; "not_found" where a capture has no row of a target.
    """

    captures: tuple[str, ...]
    targets: tuple[str, ...]
    per_capture: dict[str, FloatArray]
    opened_at: TextArray
    is_phase_known: NDArray[np.bool_]
    table_phase_rad: FloatArray
    vectors: dict[str, FloatArray]
    scalars: dict[str, FloatArray]
    covariances: dict[str, FloatArray]
    flags: TextArray

    @classmethod
    def of(cls, results: FolderResults) -> EnvelopeCube:
        """Arrange the envelopes of a folder."""
        targets = results.targets
        rows = [{one.target: one for one in envelope.targets} for envelope in results.envelopes]
        per_capture = _per_capture(results)
        return cls(
            tuple(envelope.capture for envelope in results.envelopes),
            targets,
            per_capture,
            np.array([envelope.opened_at or "" for envelope in results.envelopes], dtype=np.str_),
            np.array([facts.is_phase_known for facts in results.facts], dtype=np.bool_),
            np.array([0.0 if one.table is None else one.table.phase_rad or 0.0 for one in results.facts]),
            {name: _stack(rows, targets, attrgetter(name), 3) for name in VECTORS},
            _scalars(rows, targets, per_capture),
            {name: _matrices(rows, targets, name) for name in COVARIANCES},
            np.array([[_flags(row.get(target)) for target in targets] for row in rows], dtype=np.str_),
        )

    @property
    def complex_amplitude_mm(self) -> NDArray[np.complex128]:
        """(captures, targets, 3) U with d(t) = Re(U exp(iωt)), thus U = b − i a; real (a) where phase is unknown."""
        a, b = self.vectors["a_mm"], self.vectors["b_mm"]
        return np.where(self.is_phase_known[:, None, None], b - 1j * a, a.astype(np.complex128))

    @property
    def frequency_response(self) -> NDArray[np.complex128]:
        """(captures, targets, 3) displacement per displacement of the table, mm per mm; NaN without an amplitude of it.

        A target that rides the table has 1, one that lags it a negative phase. The phase refers to the table where a
        gauge saw its phase, else to the excitation. Without phase it is a divided by the table's amplitude, real.
        """
        a, b = self.vectors["a_mm"], self.vectors["b_mm"]
        motion = a + 1j * np.where(self.is_phase_known[:, None, None], b, 0.0)
        turn = np.where(self.is_phase_known, np.exp(-1j * self.table_phase_rad), 1.0)
        is_driven = np.isfinite(self.per_capture["table_amplitude_mm"])
        factor = turn / np.where(is_driven, self.per_capture["table_amplitude_mm"], 1.0)
        result: NDArray[np.complex128] = np.where(is_driven[:, None, None], motion * factor[:, None, None], np.nan)
        return result


def _per_capture(results: FolderResults) -> dict[str, FloatArray]:
    stated = ("frequency_hz", "excitation_amplitude_mm", "exposure_s")
    found = {name: np.array([_or_nan(getattr(one, name)) for one in results.envelopes]) for name in stated}
    tables = [facts.table for facts in results.facts]
    found["table_amplitude_mm"] = np.array([math.nan if one is None else one.amplitude_mm for one in tables])
    found["sd_table_amplitude_mm"] = np.array([math.nan if one is None else one.sd_mm for one in tables])
    return found


def _scalars(
    rows: list[dict[str, TargetEnvelope]], targets: tuple[str, ...], per_capture: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    size = _stack(rows, targets, attrgetter("amplitude_mm"), 1)[..., 0]
    sd = _stack(rows, targets, attrgetter("sd_mm"), 1)[..., 0]
    table, sd_table = (per_capture[name][:, None] for name in ("table_amplitude_mm", "sd_table_amplitude_mm"))
    ratio, sd_ratio = amplitude_ratio(size, sd, table, sd_table / table)
    return {"amplitude_mm": size, "sd_amplitude_mm": sd, "transmissibility": ratio, "sd_transmissibility": sd_ratio}


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _stack(
    rows: list[dict[str, TargetEnvelope]],
    targets: tuple[str, ...],
    value: Callable[[TargetEnvelope], float | FloatArray],
    width: int,
) -> FloatArray:
    """(captures, targets, width) of what `value` gives, NaN for a target without a row."""
    out = np.full((len(rows), len(targets), width), np.nan)
    for i, row in enumerate(rows):
        for j, target in enumerate(targets):
            if target in row:
                out[i, j] = value(row[target])
    return out


def _matrices(rows: list[dict[str, TargetEnvelope]], targets: tuple[str, ...], name: str) -> FloatArray:
    size = len(covariance_axis(name))
    flat = _stack(rows, targets, lambda one: np.ravel(getattr(one, name)), size**2)
    return flat.reshape(len(rows), len(targets), size, size)


def _flags(one: TargetEnvelope | None) -> str:
    if one is None:
        return Flag.NOT_FOUND.value
    return ";".join(flag.value for flag in Flag if flag in one.flags)
