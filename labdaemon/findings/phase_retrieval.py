"""Residues from amplitudes: signs of modes relative to each other, found by trying them.

Where phases are unknown, the residues at given poles are not a linear problem. Near a resonance, however, the motion of
a target is that mode's alone, up to a sign. So each combination of signs is a start, from which phases (of the model)
and residues (by linear least squares) improve each other in turns (error reduction: Gerchberg and Saxton 1972; Fienup
1982, doi:10.1364/AO.21.002758). The best combination is kept, target by target.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from labdaemon.findings.linearise import ModalParameters, ModalProblem
from labdaemon.findings.modal_fit import ModalFit, fit
from labdaemon.findings.response import ComplexArray, FloatArray, PhaseReference

TURNS = 25
REPAIRS = 4
UNEXPLAINED = 1.5
"""χ² per degree of freedom above which signs are tried again."""
MOST_SIGNS = 5
"""Modes whose signs are all combined; further ones start with a plus."""


def with_residues(problem: ModalProblem, parameters: ModalParameters) -> ModalParameters:
    """Parameters with the best residues for their poles.

    For data with known phases they are one linear solution, which the fit's first iteration finds; here they are only
    needed where phases are unknown.
    """
    if problem.series.phase is PhaseReference.TABLE:
        return parameters
    coefficients, _ = _retrieve(problem, parameters)
    found = replace(parameters, coefficients=coefficients.astype(complex))
    if problem.series.phase is PhaseReference.STEP:
        return _align_targets(problem, found)
    return found


def fit_with_signs(problem: ModalProblem, start: ModalParameters) -> ModalFit:
    """Fit, and fit again while other signs of a target's modes explain it better.

    Poles that were far off at the start leave some targets with a wrong sign, from which no small step leads away.
    """
    fitted = fit(problem, start)
    if problem.series.phase is not PhaseReference.TARGET or not problem.is_real:
        return fitted
    for _ in range(REPAIRS):
        if fitted.freedom <= 0 or fitted.noise_factor < UNEXPLAINED:
            break
        coefficients, is_better = _better_signs(problem, fitted.parameters)
        if not is_better.any():
            break
        mended = np.where(is_better[:, None, None], coefficients, fitted.parameters.coefficients)
        again = fit(problem, replace(fitted.parameters, coefficients=mended.astype(complex)))
        if again.chi2 >= 0.999 * fitted.chi2:
            break
        fitted = again
    return fitted


def _better_signs(problem: ModalProblem, at: ModalParameters) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(T, D, P) residues with the best signs at these poles, and (T,) whether they are better than the present ones."""
    present = at.coefficients.real
    modes = at.modes
    combined = min(modes, MOST_SIGNS)
    signs = np.array(list(product((1.0, -1.0), repeat=combined))) if combined else np.ones((1, 0))
    factor = np.ones((len(signs), present.shape[2]))
    terms = problem.basis.residual_terms
    factor[:, terms : terms + combined] = signs
    best, misfits = _retrieve(problem, at, present[None] * factor[:, None, None, :])
    return best, misfits.min(axis=0) < 0.9 * misfits[0]


def _retrieve(
    problem: ModalProblem, parameters: ModalParameters, starts: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """(T, D, P) real residues, each target's up to a common sign, and (S, T) the misfit from each start."""
    series = problem.series
    columns = problem.basis.columns(series.frequency_hz, parameters.frequency_hz, parameters.damping)
    table = series.table_mm * (1 + parameters.gain)
    observed = problem.observed / table[None, :, None]
    weight2 = (problem.weight_real * table[None, :, None]) ** 2
    normal = np.einsum("tkd,kp,kq->tdpq", weight2, columns.conj(), columns, optimize=True).real
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
    if starts is None:
        starts = _starts(observed, weight2, columns, problem.basis.residual_terms)
    model = np.einsum("kp,stdp->stkd", columns, starts)
    misfit = np.full(starts.shape[:2], np.inf)
    for _ in range(TURNS):
        turned = _turned(observed, weight2, model)
        right = np.einsum("tkd,stkd,kp->stdp", weight2, turned, columns.conj(), optimize=True).real
        starts = np.einsum("tdpq,stdq->stdp", inverse, right)
        model = np.einsum("kp,stdp->stkd", columns, starts)
        misfit = np.sum(weight2 * np.abs(_turned(observed, weight2, model) - model) ** 2, axis=(2, 3))
    chosen = np.argmin(misfit, axis=0)
    best: FloatArray = starts[chosen, np.arange(starts.shape[1])]
    return best, misfit


def _turned(observed: ComplexArray, weight2: FloatArray, model: ComplexArray) -> ComplexArray:
    """(S, T, K, D) observations with the phase, and the direction of rotation, of the model."""
    forward = np.sum(weight2 * model * observed.conj(), axis=3, keepdims=True)
    backward = np.sum(weight2 * model * observed, axis=3, keepdims=True)
    is_back = np.abs(backward) > np.abs(forward)
    factor = np.where(is_back, backward, forward)
    factor = factor / np.maximum(np.abs(factor), 1e-300)
    result: ComplexArray = np.where(is_back, observed.conj(), observed) * factor
    return result


def _starts(observed: ComplexArray, weight2: FloatArray, columns: ComplexArray, residual_terms: int) -> FloatArray:
    """(S, T, D, P) residues for each combination of the modes' signs."""
    targets, _, directions = observed.shape
    modes = columns.shape[1] - residual_terms
    seen = (weight2 > 0).any(axis=2)
    base = np.zeros((targets, directions, columns.shape[1]))
    everyone = np.arange(targets)
    if residual_terms:
        # Far below all modes a target moves with the table.
        quiet = np.max(np.abs(columns[:, residual_terms:]), axis=1) if modes else np.zeros(len(columns))
        step = np.argmin(np.where(seen, quiet[None, :], np.inf), axis=1)
        base[:, :, 0] = _real_vector(observed[everyone, step])
    for mode in range(modes):
        size = np.abs(columns[:, residual_terms + mode])
        step = np.argmax(np.where(seen, size[None, :], -1.0), axis=1)
        base[:, :, residual_terms + mode] = _real_vector(observed[everyone, step]) / size[step][:, None]
    combined = min(modes, MOST_SIGNS)
    signs = np.array(list(product((1.0, -1.0), repeat=combined))) if combined else np.ones((1, 0))
    factor = np.ones((len(signs), columns.shape[1]))
    factor[:, residual_terms : residual_terms + combined] = signs
    result: FloatArray = base[None] * factor[:, None, None, :]
    return result


def _real_vector(values: ComplexArray) -> FloatArray:
    """(T, D) the vectors along their major axes, up to a sign."""
    angle = 0.5 * np.angle(np.sum(values**2, axis=1, keepdims=True))
    result: FloatArray = (values * np.exp(-1j * angle)).real
    return result


def _align_targets(problem: ModalProblem, parameters: ModalParameters) -> ModalParameters:
    """Signs of targets and phases of steps, where all targets of a step share one unknown phase."""
    model = problem.predict(parameters)
    weight2 = problem.weight_real**2
    # (T, K) phase of the data over the model's; a target with the wrong sign is half a turn away in all steps.
    factor = np.sum(weight2 * problem.observed * model.conj(), axis=2)
    size = np.sqrt(np.abs(factor))
    factor = np.where(size > 0, factor / np.maximum(size, 1e-300), 0.0)
    reference = factor[int(np.argmax(np.sum(np.abs(factor), axis=1)))]
    signs = np.ones(len(factor))
    for _ in range(5):
        signs = np.where(np.sum(factor * reference.conj()[None, :], axis=1).real < 0, -1.0, 1.0)
        reference = np.sum(signs[:, None] * factor, axis=0)
    phase = np.angle(reference)
    return replace(parameters, coefficients=parameters.coefficients * signs[:, None, None], phase_rad=phase)
