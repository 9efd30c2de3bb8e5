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
    """

    frequency_hz: float
    targets: Mapping[str, TargetEnvelope]
    table_mm: float = 1.0
    sd_table: float = UNKNOWN_TABLE_SD
    phase_rad: float | None = None
    sd_phase_rad: float | None = None


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
    phase, else to the step. Otherwise each target has a phase of its own.
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
    if _is_signed(amplitude):
        phase, amplitude, sd_phase = _phases(amplitude, steps)
    else:
        phase, amplitude, sd_phase = PhaseReference.TARGET, _along_axes(amplitude), np.full(len(steps), np.inf)
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
    )
    return EnvelopeSeries(series, _mean_positions(position), np.isfinite(sd_real).any(axis=(0, 1)), counts)


def _phases(amplitude: ComplexArray, steps: Sequence[MeasuredStep]) -> tuple[PhaseReference, ComplexArray, FloatArray]:
    """What phases refer to, amplitudes in that reference, and (K,) sd of the table's phase.

    Where a gauge saw the table's phase in every capture, phases refer to the table; else each step has a phase of its
    own, as the drive's phase against the excitation's reference is not known.
    """
    phase = np.array([0.0 if one.phase_rad is None else one.phase_rad for one in steps])
    sd = np.array([np.inf if one.sd_phase_rad is None else one.sd_phase_rad for one in steps])
    sd = np.where(sd < LARGEST_PHASE_SD, sd, np.inf)
    if not np.isfinite(sd).all():
        return PhaseReference.STEP, amplitude, np.full(len(sd), np.inf)
    return PhaseReference.TABLE, amplitude * np.exp(-1j * phase)[:, None, None], sd


def _mean_positions(position: FloatArray) -> FloatArray:
    count = np.isfinite(position).sum(axis=0)
    total = np.nansum(position, axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _is_signed(amplitude: ComplexArray) -> bool:
    """Whether every capture carries a phase: its vectors are then not the semi-axes in their fixed order and sign."""
    is_signed = []
    for step in amplitude:
        value = step[np.isfinite(step).all(axis=1)]
        if not len(value):
            continue
        a, b = value.real, value.imag
        size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        slanted = np.abs(np.sum(a * b, axis=1)) > RIGHT_ANGLE * size + 1e-5 * np.linalg.norm(a, axis=1)
        largest = np.take_along_axis(a, np.argmax(np.abs(a), axis=1)[:, None], axis=1)[:, 0]
        longer = np.linalg.norm(b, axis=1) > np.linalg.norm(a, axis=1) + 1e-5
        is_signed.append(bool(np.any(slanted | (largest < 0) | longer)))
    return bool(is_signed) and all(is_signed)


def _along_axes(amplitude: ComplexArray) -> ComplexArray:
    """Amplitudes turned to the phase at which the major semi-axis is real."""
    square = np.nansum(amplitude**2, axis=2, keepdims=True)
    result: ComplexArray = amplitude * np.exp(-0.5j * np.angle(square))
    return result
