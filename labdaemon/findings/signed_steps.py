"""Steps that show phase among steps that do not: coded light and phase groups in a series of amplitudes.

The series is first fitted by amplitudes alone. That leaves each target's sign free. The steps with phase then settle
the signs, and the model is fitted again with their vectors as they are: one phase a step, known as well as the table's
gauge shows it. Where they demand it, residues become complex (damping that is not proportional);
what modes outside the band leave stays real.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from labdaemon.findings.linearise import ModalParameters, ModalProblem
from labdaemon.findings.modal_fit import ModalFit, fit
from labdaemon.findings.response import BoolArray, FloatArray, ResponseSeries

TURNS = 20
SIGNIFICANCE = 1e-3
"""Probability of a fall of χ² below which complex residues are kept."""
LARGEST_MISFIT = 3.0
"""Factor by which the misfit per degree of freedom may grow before the phases are left out."""


def without_signs(series: ResponseSeries) -> ResponseSeries:
    """The series as amplitudes alone: each vector turned to the phase at which its major semi-axis is real."""
    if series.signed is None:
        return series
    value = np.where(np.isfinite(series.amplitude), series.amplitude, 0.0)
    turn = np.exp(-0.5j * np.angle(np.sum(value**2, axis=2, keepdims=True)))
    amplitude = np.where(series.signed[:, None, None], series.amplitude * turn, series.amplitude)
    return replace(series, amplitude=amplitude, signed=None)


def with_signed_steps(fitted: ModalFit, series: ResponseSeries) -> tuple[ModalFit, str]:
    """Fit the same modes to the vectors of the steps that show phase, and to the amplitudes of the others.

    Parameters
    ----------
    fitted
        The fit to `without_signs(series)`.
    series
        With `signed`.

    Returns
    -------
    fit, reason
        The new fit, and an empty text; or the old one, and why the phases were not used.
    """
    problem = ModalProblem.of(series, fitted.problem.basis, is_real=True)
    start = _aligned(problem, fitted.parameters)
    found = _best_form(problem, fit(problem, start))
    if found.freedom <= 0 or found.noise_factor > LARGEST_MISFIT * max(fitted.noise_factor, 1.0):
        return (
            fitted,
            "the captures that show phase do not agree with the amplitudes of the others: phases are not used",
        )
    return found, ""


def _best_form(problem: ModalProblem, real: ModalFit) -> ModalFit:
    """The fit with complex residues where it explains significantly more, else the one with real residues."""
    free = fit(replace(problem, is_real=False, is_background_real=True), real.parameters)
    fall, added = real.chi2 - free.chi2, real.freedom - free.freedom
    is_better = free.freedom > 0 and fall > 0
    is_better = is_better and bool(stats.chi2.sf(fall / max(free.noise_factor, 1.0), added) < SIGNIFICANCE)
    return free if is_better else real


def _aligned(problem: ModalProblem, at: ModalParameters) -> ModalParameters:
    """Parameters with the signs of targets, and the phases of steps, that agree best with the signed vectors."""
    signed = problem.signed
    phase = np.zeros(len(at.phase_rad))
    model = problem.predict(replace(at, phase_rad=phase))
    overlap = np.sum(problem.weight_real**2 * problem.observed * model.conj(), axis=2) * signed[None, :]
    is_known: BoolArray = np.isfinite(problem.series.sd_phase())
    # Targets that agree over all steps: the leading vector of their products, in which the steps' phases cancel.
    together = np.linalg.eigh((overlap @ overlap.conj().T).real)[1][:, -1]
    signs: FloatArray = np.where(together < 0, -1.0, 1.0)
    if (signs @ overlap)[is_known].real.sum() < 0:
        signs = -signs
    for _ in range(TURNS):
        turn = np.where(is_known, 0.0, np.angle(signs @ overlap)) * signed
        better: FloatArray = np.where((overlap * np.exp(-1j * turn)[None, :]).real.sum(axis=1) < 0, -1.0, 1.0)
        phase = turn
        if (better == signs).all():
            break
        signs = better
    return replace(at, coefficients=at.coefficients * signs[:, None, None], phase_rad=phase)
