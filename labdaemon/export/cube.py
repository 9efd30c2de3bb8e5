"""Envelopes as arrays over captures and targets: the form that HDF5, MATLAB and netCDF files hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from labdaemon.envelope import TargetEnvelope
from labdaemon.export.results import FolderResults
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
    "amplitude_mm": "major semi-axis of the orbit, zero to peak",
    "sd_amplitude_mm": "standard deviation of amplitude_mm",
}
"""Scalars of a target, (captures, targets) mm."""
PER_CAPTURE = {
    "frequency_hz": ("Hz", "excitation frequency"),
    "excitation_amplitude_mm": ("mm", "amplitude of the table, zero to peak"),
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
    vectors
        `VECTORS` by name, (captures, targets, 3) each, x y z; NaN where not measured.
    scalars
        `SCALARS` by name, (captures, targets) each.
    flags
        (captures, targets) of text, separated by ``;``; "not_found" where a capture has no row of a target.
    """

    captures: tuple[str, ...]
    targets: tuple[str, ...]
    per_capture: dict[str, FloatArray]
    opened_at: TextArray
    is_phase_known: NDArray[np.bool_]
    vectors: dict[str, FloatArray]
    scalars: dict[str, FloatArray]
    flags: TextArray

    @classmethod
    def of(cls, results: FolderResults) -> EnvelopeCube:
        """Arrange the envelopes of a folder."""
        targets = results.targets
        rows = [{one.target: one for one in envelope.targets} for envelope in results.envelopes]
        return cls(
            tuple(envelope.capture for envelope in results.envelopes),
            targets,
            {
                name: np.array([_or_nan(getattr(envelope, name)) for envelope in results.envelopes])
                for name in PER_CAPTURE
            },
            np.array([envelope.opened_at or "" for envelope in results.envelopes], dtype=np.str_),
            np.array([facts.is_phase_known for facts in results.facts], dtype=np.bool_),
            {name: _stack(rows, targets, attrgetter(name), 3) for name in VECTORS},
            {
                "amplitude_mm": _stack(rows, targets, attrgetter("amplitude_mm"), 1)[..., 0],
                "sd_amplitude_mm": _stack(rows, targets, attrgetter("sd_mm"), 1)[..., 0],
            },
            np.array([[_flags(row.get(target)) for target in targets] for row in rows], dtype=np.str_),
        )

    @property
    def complex_amplitude_mm(self) -> NDArray[np.complex128]:
        """(captures, targets, 3) U with d(t) = Re(U exp(iωt)), thus U = b − i a; real (a) where phase is unknown."""
        a, b = self.vectors["a_mm"], self.vectors["b_mm"]
        return np.where(self.is_phase_known[:, None, None], b - 1j * a, a.astype(np.complex128))


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


def _flags(one: TargetEnvelope | None) -> str:
    if one is None:
        return Flag.NOT_FOUND.value
    return ";".join(flag.value for flag in Flag if flag in one.flags)
