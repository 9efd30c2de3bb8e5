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

from labdaemon.findings.linearise import ModalParameters, ModalProblem
from labdaemon.findings.response import ComplexArray, FloatArray, PhaseReference

TURNS = 25
MOST_SIGNS = 5
"""Modes whose signs are all combined; further ones start with a plus."""


def with_residues(problem: ModalProblem, parameters: ModalParameters) -> ModalParameters:
    """Parameters with the best residues for their poles.

    For data with known phases they are one linear solution, which the fit's first iteration finds; here they are only
    needed where phases are unknown.
    """
    if problem.series.phase is PhaseReference.TABLE:
        return parameters
    coefficients = _retrieve(problem, parameters)
    found = replace(parameters, coefficients=coefficients.astype(complex))
    if problem.series.phase is PhaseReference.STEP:
        return _align_targets(problem, found)
    return found


def _retrieve(problem: ModalProblem, parameters: ModalParameters) -> FloatArray:
    """(T, D, P) real residues, each target's up to a common sign."""
    series = problem.series
    columns = problem.basis.columns(series.frequency_hz, parameters.frequency_hz, parameters.damping)
    observed = problem.observed / series.table_mm[None, :, None]
    weight2 = (problem.weight_real * series.table_mm[None, :, None]) ** 2
    normal = np.einsum("tkd,kp,kq->tdpq", weight2, columns.conj(), columns, optimize=True).real
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
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
    return best


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
