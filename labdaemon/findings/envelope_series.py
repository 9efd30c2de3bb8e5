"""Envelopes of many steps as the series that a modal model is fitted to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.envelope import TargetEnvelope
from labdaemon.findings.response import BoolArray, ComplexArray, FloatArray, PhaseReference, ResponseSeries
from labdaemon.flags import Flag

UNKNOWN_TABLE_SD = 1.0
"""Relative sd of the table's amplitude where nothing states it."""
LARGEST_PHASE_SD = 0.3
"""Radians from which on the table's phase counts as unknown."""
RIGHT_ANGLE = 1e-3
"""Cosine below which two semi-axes are at right angles, given six decimals in the file."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredStep:
    """An envelope with its excitation.

    Attributes
    ----------
    frequency_hz
        Of the excitation.
    targets
        Motion of each target by name.
    table_mm, sd_table
        Amplitude of the table, zero to peak, and its relative standard deviation.
    phase_rad, sd_phase_rad
        Phase of the table against the excitation's reference; None where no gauge saw it.
    is_signed
        Whether vectors have phases (coded light, known opening phases); None where only the vectors themselves show it.
    """

    frequency_hz: float
    targets: Mapping[str, TargetEnvelope]
    table_mm: float = 1.0
    sd_table: float = UNKNOWN_TABLE_SD
    phase_rad: float | None = None
    sd_phase_rad: float | None = None
    is_signed: bool | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopeSeries:
    """What envelopes say about the structure's response.

    Attributes
    ----------
    series
        Targets at steps.
    positions_mm
        (T, 3) mean positions over all steps; NaN where never measured.
    directions
        (3,) which of x, y and z were measured.
    left_out
        How many rows of targets were left out for each flag.
    """

    series: ResponseSeries
    positions_mm: FloatArray
    directions: BoolArray
    left_out: Counter[str]


def envelope_series(steps: Sequence[MeasuredStep]) -> EnvelopeSeries:
    """Arrange envelopes; rows with a flag other than ``at_rest`` are left out.

    Where every envelope carries phases (known opening phases, coded light), they refer to the table if a gauge saw its
    phase, else to the step. Otherwise each target has a phase of its own, except at the steps that carry phases.
    """
    names = tuple(sorted({target for step in steps for target in step.targets}))
    counts: Counter[str] = Counter()
    shape = (len(steps), len(names), 3)
    amplitude = np.full(shape, np.nan, complex)
    sd_real, sd_imag = np.full(shape, np.nan), np.full(shape, np.nan)
    position, at_rest = np.full(shape, np.nan), np.zeros(shape[:2], bool)
    for row, step in enumerate(steps):
        for place, target in enumerate(names):
            one = step.targets.get(target)
            if one is None:
                continue
            position[row, place] = one.mean_mm
            doubts = one.flags - {Flag.AT_REST}
            if doubts:
                counts.update(flag.value for flag in doubts)
                continue
            amplitude[row, place] = one.a_mm + 1j * np.nan_to_num(one.b_mm)
            sd_real[row, place] = one.sd_a_mm
            sd_imag[row, place] = np.where(np.isfinite(one.sd_b_mm), one.sd_b_mm, one.sd_a_mm)
            at_rest[row, place] = Flag.AT_REST in one.flags
    signed = np.array(
        [
            _shows_phase(rows) if step.is_signed is None else step.is_signed
            for step, rows in zip(steps, amplitude, strict=True)
        ]
    )
    phase_rad, sd_phase = _table_phases(steps)
    turned = amplitude * np.exp(-1j * phase_rad)[:, None, None]
    amplitude = np.where(signed[:, None, None], turned, _along_axes(amplitude))
    phase = _reference(signed, sd_phase)
    series = ResponseSeries(
        np.array([step.frequency_hz for step in steps]),
        amplitude,
        sd_real,
        sd_imag,
        np.array([step.table_mm for step in steps]),
        np.array([step.sd_table for step in steps]),
        phase,
        at_rest,
        names,
        sd_phase,
        signed if signed.any() and phase is PhaseReference.TARGET else None,
    )
    return EnvelopeSeries(series, _mean_positions(position), np.isfinite(sd_real).any(axis=(0, 1)), counts)


def _table_phases(steps: Sequence[MeasuredStep]) -> tuple[FloatArray, FloatArray]:
    """(K,) phase of the table against the excitation's reference, and its sd: infinite where no gauge saw it well."""
    phase = np.array([0.0 if one.phase_rad is None else one.phase_rad for one in steps])
    sd = np.array([np.inf if one.sd_phase_rad is None else one.sd_phase_rad for one in steps])
    is_known = sd < LARGEST_PHASE_SD
    return np.where(is_known, phase, 0.0), np.where(is_known, sd, np.inf)


def _reference(signed: BoolArray, sd_phase: FloatArray) -> PhaseReference:
    """What phases refer to where all steps show them; else amplitudes are what all have."""
    if not signed.all():
        return PhaseReference.TARGET
    return PhaseReference.TABLE if np.isfinite(sd_phase).all() else PhaseReference.STEP


def _mean_positions(position: FloatArray) -> FloatArray:
    count = np.isfinite(position).sum(axis=0)
    total = np.nansum(position, axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _shows_phase(amplitude: ComplexArray) -> bool:
    """Whether the vectors (T, 3) of a step are not semi-axes in their fixed order and sign: they carry phases."""
    value = amplitude[np.isfinite(amplitude).all(axis=1)]
    if not len(value):
        return False
    a, b = value.real, value.imag
    size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    slanted = np.abs(np.sum(a * b, axis=1)) > RIGHT_ANGLE * size + 1e-5 * np.linalg.norm(a, axis=1)
    largest = np.take_along_axis(a, np.argmax(np.abs(a), axis=1)[:, None], axis=1)[:, 0]
    longer = np.linalg.norm(b, axis=1) > np.linalg.norm(a, axis=1) + 1e-5
    return bool(np.any(slanted | (largest < 0) | longer))


def _along_axes(amplitude: ComplexArray) -> ComplexArray:
    """Amplitudes turned to the phase at which the major semi-axis is real."""
    square = np.nansum(amplitude**2, axis=2, keepdims=True)
    result: ComplexArray = amplitude * np.exp(-0.5j * np.angle(square))
    return result
