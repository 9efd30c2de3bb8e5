"""Envelopes at a few frequencies compared as they are, where there are too few steps for modes.

Near a resonance the deflection is the table's motion plus the mode's shape times a factor that depends strongly on how
far the resonance is. A uniform change of modulus changes that factor; so the factor of each step, and the table's
motion, are nuisance parameters, and only a change of the form counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labdaemon.findings.common_scale import inverse
from labdaemon.findings.max_statistic import max_test
from labdaemon.findings.mode_shape import mac_value
from labdaemon.findings.response import FloatArray, ResponseSeries

SAME_FREQUENCY = 2e-3
"""Relative difference up to which two steps have one frequency."""
DEFLECTION_FLOOR = 5e-3
"""Systematic part of a component, of the step's largest: remaining transients, orientation, harmonics."""

LEAST_COMPONENTS = 4
"""Measured components of a step: a scale and the table's motion are taken out, and something must be left to test."""


@dataclass(frozen=True, slots=True)
class DeflectionDifference:
    """A target that moves differently.

    Attributes
    ----------
    target, axis, frequency_hz, z
        Which component of which target, at which step, by how many of its standard deviations.
    """

    target: str
    axis: str
    frequency_hz: float
    z: float


@dataclass(frozen=True, slots=True)
class DeflectionComparison:
    """Outcome.

    Attributes
    ----------
    changed, p_value
        At a false-alarm rate of 5 % over all targets and steps.
    differences
        Single ones that exceed their share, the largest first.
    scales
        (frequency, factor, sd) of the amplitude of each step, per table amplitude, that was left out of the test.
    macs
        (frequency, MAC).
    """

    changed: bool
    p_value: float
    differences: tuple[DeflectionDifference, ...]
    scales: tuple[tuple[float, float, float], ...]
    macs: tuple[tuple[float, float], ...]


def common_steps(baseline: ResponseSeries, other: ResponseSeries) -> list[tuple[int, int]]:
    """Pairs of steps with one frequency, each step of the other at most once."""
    pairs, used = [], set()
    for i, frequency in enumerate(baseline.frequency_hz):
        away = np.abs(other.frequency_hz / frequency - 1)
        for j in np.argsort(away):
            if away[j] <= SAME_FREQUENCY and int(j) not in used:
                used.add(int(j))
                pairs.append((i, int(j)))
                break
    return pairs


def compare_deflections(baseline: ResponseSeries, other: ResponseSeries) -> DeflectionComparison | None:
    """Compare the major axes of all targets at all common frequencies; None where there is no such frequency."""
    pairs = common_steps(baseline, other)
    rests, spreads, labels, scales, macs = [], [], [], [], []
    names = baseline.targets
    for i, j in pairs:
        one, two = _major_axes(baseline, i), _major_axes(other, j)
        seen = np.isfinite(one[1]) & np.isfinite(two[1])
        if np.count_nonzero(seen) < LEAST_COMPONENTS:
            continue
        sign = np.where(np.sum(np.where(seen, one[0] * two[0], 0), axis=1) < 0, -1.0, 1.0)[:, None]
        first, second = one[0][seen], (two[0] * sign)[seen]
        floor = DEFLECTION_FLOOR * float(np.abs(first).max())
        covariance = np.diag(one[1][seen] ** 2 + two[1][seen] ** 2 + 2 * floor**2)
        table = np.zeros(one[0].shape)
        table[:, 0] = np.sign(np.where(one[0][:, 0] == 0, 1.0, one[0][:, 0]))  # each target's own sign
        columns = np.column_stack([first, table[seen]])
        weight = inverse(covariance)
        inner = inverse(columns.T @ weight @ columns)
        value = inner @ (columns.T @ (weight @ (second - first)))
        rests.append(second - first - columns @ value)
        spreads.append(covariance - columns @ inner @ columns.T)
        frequency = float(baseline.frequency_hz[i])
        labels += [(names[t], "xyz"[d], frequency) for t, d in zip(*np.nonzero(seen), strict=True)]
        scales.append((frequency, 1 + float(value[0]), float(np.sqrt(max(inner[0, 0], 0.0)))))
        macs.append((frequency, mac_value(first.astype(complex), second.astype(complex))))
    if not rests:
        return None
    size = sum(len(rest) for rest in rests)
    covariance, at = np.zeros((size, size)), 0
    for part in spreads:
        covariance[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    test = max_test(np.eye(size), np.concatenate(rests), covariance, [f"{label[2]}" for label in labels])
    found = [
        DeflectionDifference(*label, float(z))
        for label, z, limit in zip(labels, test.z, test.critical, strict=True)
        if test.is_changed and abs(z) > limit
    ]
    found.sort(key=lambda one: -abs(one.z))
    return DeflectionComparison(test.is_changed, test.p_value, tuple(found), tuple(scales), tuple(macs))


def _major_axes(series: ResponseSeries, step: int) -> tuple[FloatArray, FloatArray]:
    """(T, D) motion along each target's major axis per table amplitude, and its standard deviations."""
    value = series.amplitude[step]
    valid = series.valid()[step]
    value = np.where(valid, value, 0)
    angle = 0.5 * np.angle(np.sum(value**2, axis=1, keepdims=True))
    sd = np.where(valid, np.maximum(series.sd_real[step], 1e-9), np.nan)
    return (value * np.exp(-1j * angle)).real / series.table_mm[step], sd / series.table_mm[step]


def masked_directions(series: ResponseSeries, directions: np.ndarray) -> ResponseSeries:
    """The series with only some directions measured."""
    amplitude = series.amplitude.copy()
    amplitude[:, :, ~directions] = np.nan
    return replace(series, amplitude=amplitude)
