"""Where the next step of a closed-loop sweep gives most information, and when a step is settled.

The next frequency is the one that most increases the determinant of the information on all poles, with residues and
table amplitudes eliminated (D_s-optimality: Atkinson, Donev and Tobias 2007, Optimum Experimental Designs, chapter 10;
for modal parameters Pintelon and Schoukens 2012, section 5.4). It lies near ±1 half-bandwidth of a natural frequency
for the frequency, and farther out for the damping, whichever is known worst.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdaemon.findings.modal_fit import ModalFit, refit
from labdaemon.findings.response import FloatArray, ResponseSeries

IndexArray = NDArray[np.intp]

OFFSETS = (0.0, 0.5, 0.8, 1.0, 1.3, 1.7, 2.2, 3.0, 4.5)
"""Candidates around each natural frequency, half-bandwidths."""
UNKNOWN_DAMPING = 3.0
"""Factor by which the damping may be wrong when a transient is judged."""


@dataclass(frozen=True, slots=True)
class NextStep:
    """The best next frequency.

    Attributes
    ----------
    frequency_hz
        Where to excite.
    gain
        Increase of the logarithm of the determinant.
    """

    frequency_hz: float
    gain: float


def candidate_frequencies(fitted: ModalFit, band_hz: tuple[float, float]) -> FloatArray:
    """Frequencies around all modes, inside the band."""
    frequency, damping = fitted.parameters.frequency_hz, fitted.parameters.damping
    offsets = np.array([sign * one for one in OFFSETS for sign in (1.0, -1.0)])
    places = (frequency[:, None] * (1 + damping[:, None] * offsets[None, :])).ravel()
    return np.unique(places[(places >= band_hz[0]) & (places <= band_hz[1])])


def next_frequency(
    fitted: ModalFit,
    candidates_hz: FloatArray,
    *,
    sd_mm: float,
    sd_table: float,
    table_mm: float | FloatArray,
    wanted: tuple[float, float] | None = None,
) -> NextStep | None:
    """The candidate that gives most information about the poles.

    Parameters
    ----------
    sd_mm
        Expected standard deviation of an amplitude's component.
    sd_table
        Relative standard deviation of the table's amplitude.
    table_mm
        Amplitude of the table; one for all, or one a candidate.
    wanted
        Relative sd wanted of frequency and damping. Poles that have it count no more; None if all have it. Without it
        all poles count.
    """
    index = _poles_that_count(fitted, wanted)
    if not index.size or not len(candidates_hz):
        return None
    table = np.broadcast_to(np.asarray(table_mm, float), (len(candidates_hz),))
    gains = information_gains(fitted, _candidate_steps(fitted, candidates_hz, table, sd_mm, sd_table), index)
    best = int(np.argmax(gains))
    return NextStep(float(candidates_hz[best]), float(gains[best]))


def with_expected_steps(
    fitted: ModalFit, frequency_hz: FloatArray, table_mm: FloatArray, *, sd_mm: float, sd_table: float
) -> ModalFit:
    """The fit as it will be once these steps are measured, if they show what it predicts.

    Parameters
    ----------
    frequency_hz, table_mm
        (K,) excitation of steps that are captured and not measured yet.
    sd_mm, sd_table
        As for `next_frequency`.
    """
    expected = _candidate_steps(fitted, frequency_hz, table_mm, sd_mm, sd_table)
    return refit(fitted, joined(fitted.problem.series, expected))


def _poles_that_count(fitted: ModalFit, wanted: tuple[float, float] | None) -> IndexArray:
    if wanted is None:
        return np.arange(2 * fitted.modes)
    is_open = np.concatenate([fitted.sd_log_frequency > wanted[0], fitted.sd_log_damping > wanted[1]])
    return np.flatnonzero(is_open)


def _candidate_steps(
    fitted: ModalFit, frequency: FloatArray, table: FloatArray, sd_mm: float, sd_table: float
) -> ResponseSeries:
    """Steps whose results are what the model predicts."""
    series = fitted.problem.series
    shape = (len(frequency), *series.amplitude.shape[1:])
    alone = replace(
        series,
        frequency_hz=np.asarray(frequency, float),
        amplitude=np.ones(shape, complex),
        sd_real=np.full(shape, sd_mm),
        sd_imag=np.full(shape, sd_mm),
        table_mm=np.asarray(table, float),
        sd_table=np.full(len(frequency), sd_table),
        at_rest=None,
        sd_phase_rad=np.full(len(frequency), float(np.median(series.sd_phase()))),
        signed=None if series.signed is None else np.full(len(frequency), bool(series.signed[-1])),
    )
    zero = np.zeros(len(frequency))
    parameters = replace(fitted.parameters, gain=zero, phase_rad=zero)
    predicted = replace(fitted.problem, series=alone).predict(parameters).transpose(1, 0, 2)
    return replace(alone, amplitude=predicted)


def joined(first: ResponseSeries, second: ResponseSeries) -> ResponseSeries:
    """Steps of one series after those of another of the same targets."""
    return ResponseSeries(
        np.concatenate([first.frequency_hz, second.frequency_hz]),
        np.concatenate([first.amplitude, second.amplitude]),
        np.concatenate([first.sd_real, second.sd_real]),
        np.concatenate([first.sd_imag, second.sd_imag]),
        np.concatenate([first.table_mm, second.table_mm]),
        np.concatenate([first.sd_table, second.sd_table]),
        phase=first.phase,
        at_rest=np.concatenate([first.resting(), second.resting()]),
        targets=first.targets,
        sd_phase_rad=np.concatenate([first.sd_phase(), second.sd_phase()]),
        signed=None
        if first.signed is None and second.signed is None
        else np.concatenate([first.signed_steps(), second.signed_steps()]),
    )


def information_gains(fitted: ModalFit, candidates: ResponseSeries, index: IndexArray) -> FloatArray:
    """(G,) increases of the log determinant of the information on some shared parameters, one candidate at a time.

    Parameters
    ----------
    candidates
        One step each.
    index
        Positions among the shared parameters; all others are eliminated.
    """
    steps, count = fitted.problem.series.steps, candidates.steps
    problem = fitted.problem.over(joined(fitted.problem.series, candidates))
    zero = np.zeros(count)
    before = fitted.parameters
    gain, phase = np.concatenate([before.gain, zero]), np.concatenate([before.phase_rad, zero])
    system = problem.linearise(replace(before, gain=gain, phase_rad=phase))
    shared = len(system.prior_weight)
    targets = len(system.local)
    local = system.local.reshape(targets, steps + count, -1, system.local.shape[2])
    common = system.shared.reshape(targets, steps + count, -1, shared)
    old_local = local[:, :steps].reshape(targets, -1, local.shape[3])
    old_common = common[:, :steps].reshape(targets, -1, shared)
    unit = np.linalg.norm(old_local, axis=1)
    unit = np.where(unit > 0, unit, 1.0)  # a direction that was not measured
    local = local * (np.linalg.norm(old_local, axis=1) > 0)[:, None, None]
    old_local, local = old_local / unit[:, None], local / unit[:, None, None]
    normal = old_local.transpose(0, 2, 1) @ old_local + 1e-12 * np.eye(local.shape[3])
    cross = old_local.transpose(0, 2, 1) @ old_common
    own = np.einsum("trm,trn->mn", old_common, old_common, optimize=True) + np.diag(system.prior_weight)
    values = [_log_information(own, cross, normal, index)]
    for step in range(steps, steps + count):
        a, s = local[:, step], common[:, step]
        values.append(
            _log_information(
                own + np.einsum("trm,trn->mn", s, s, optimize=True),
                cross + a.transpose(0, 2, 1) @ s,
                normal + a.transpose(0, 2, 1) @ a,
                index,
            )
        )
    return np.array(values[1:]) - values[0]


def _log_information(own: FloatArray, cross: FloatArray, normal: FloatArray, index: IndexArray) -> float:
    """Logarithm of the determinant of the information on some shared parameters, the others eliminated.

    Parameters that no observation depends on (the phase of a step that is only a candidate) are left out.
    """
    reduced = own - np.einsum("tlm,tln->mn", cross, np.linalg.solve(normal, cross), optimize=True)
    rest = np.setdiff1d(np.flatnonzero(np.diag(own) > 0), index)
    sign, value = np.linalg.slogdet(reduced[np.ix_(index, index)])
    if rest.size:
        # log det of the Schur complement = log det of the whole − log det of the eliminated part
        both = np.concatenate([index, rest])
        sign, value = np.linalg.slogdet(reduced[np.ix_(both, both)])
        value -= np.linalg.slogdet(reduced[np.ix_(rest, rest)])[1]
    return float(value) if sign > 0 else -np.inf


def remaining_transient(change_per_cycle: float, damping: float, factor: float = UNKNOWN_DAMPING) -> float:
    """Largest part of the amplitude that may still be transient.

    A mode rings down by exp(−2πζ) a cycle, so that a change of c per cycle leaves c/(2πζ) to come.

    Parameters
    ----------
    change_per_cycle
        Relative change of the response from cycle to cycle.
    damping
        ζ as it is known now.
    factor
        By which it may be too large.
    """
    return abs(change_per_cycle) * factor / (2 * np.pi * damping)


def is_settled(change_per_cycle: float, damping: float, sd_relative: float, factor: float = UNKNOWN_DAMPING) -> bool:
    """Whether the remaining transient is below a third of the amplitude's standard deviation."""
    return remaining_transient(change_per_cycle, damping, factor) <= sd_relative / 3
