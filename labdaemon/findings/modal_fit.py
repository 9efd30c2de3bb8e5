"""Fit of a modal model to a series of envelopes: poles shared by all targets, residues of each, table amplitudes.

Levenberg–Marquardt on the reduced equations of `bordered`: the residues are eliminated exactly in each iteration, so
that 60 targets cost no more than their own small factorisations. The inverse normal matrix is the covariance; where the
residuals are larger than the stated noise it is scaled by χ² per degree of freedom.

The model is that of the textbooks (Ewins 2000; Pintelon and Schoukens 2012, doi:10.1002/9781118287422, chapters 1 and
9); the maximum-likelihood view of it is that of Guillaume, Verboven and Vanlanduit 1998 (ISMA 23, pages 359–366).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labdaemon.findings.bordered import BlockCovariance, BlockSystem
from labdaemon.findings.linearise import ModalParameters, ModalProblem
from labdaemon.findings.response import ComplexArray, FloatArray, PhaseReference, ResponseSeries

ITERATIONS = 60
CONVERGED = 1e-9
"""Relative fall of χ² at which a fit ends."""


@dataclass(frozen=True, slots=True, eq=False)
class ModalFit:
    """A modal model at its best fit.

    Attributes
    ----------
    problem
        What was fitted.
    parameters
        The best ones.
    covariance
        Of poles, gains, phases (in this order) and residues, from the stated noise alone.
    chi2, freedom
        Sum of squared normalised residuals, priors included, and degrees of freedom.
    converged
        Whether the iterations ended by themselves.
    """

    problem: ModalProblem
    parameters: ModalParameters
    covariance: BlockCovariance
    chi2: float
    freedom: int
    converged: bool

    @property
    def noise_factor(self) -> float:
        """χ² per degree of freedom: by how much the variances exceed the stated ones."""
        return self.chi2 / self.freedom if self.freedom > 0 else float("nan")

    @property
    def scale(self) -> float:
        """Factor of all variances: the noise factor where it exceeds 1, or where the noise was not known."""
        factor = self.noise_factor
        return factor if factor > 1.0 or (factor > 0 and not self.problem.is_noise_known) else 1.0

    @property
    def modes(self) -> int:
        """Number of modes."""
        return self.parameters.modes

    @property
    def sd_log_frequency(self) -> FloatArray:
        """(M,) relative sd of the natural frequencies."""
        return self._sd_of(0)

    @property
    def sd_log_damping(self) -> FloatArray:
        """(M,) relative sd of the damping ratios."""
        return self._sd_of(self.modes)

    def _sd_of(self, first: int) -> FloatArray:
        variance = np.diag(self.covariance.shared)[first : first + self.modes]
        result: FloatArray = np.sqrt(np.maximum(variance, 0.0) * self.scale)
        return result

    @property
    def parts(self) -> int:
        """Real parameters of one coefficient: 1 or 2."""
        return 1 if self.problem.is_real else 2

    def local_rows(self, column: int, part: int = 0) -> FloatArray:
        """(T·D, T, L) selects real (0) or imaginary (1) part of one column's coefficients of all targets."""
        targets, directions, columns = self.parameters.coefficients.shape
        rows = np.zeros((targets, directions, targets, directions, columns, self.parts))
        for target in range(targets):
            for direction in range(directions):
                rows[target, direction, target, direction, column, part] = 1.0
        return rows.reshape(targets * directions, targets, directions * columns * self.parts)

    def residues(self, mode: int) -> tuple[FloatArray, FloatArray]:
        """Residue of one mode at all targets with its covariance.

        Returns
        -------
        values, covariance
            (T·D·parts,): real parts, then imaginary ones where there are any; mm per mm of the table.
        """
        column = self.problem.basis.residual_terms + mode
        value = self.parameters.coefficients[:, :, column].ravel()
        stacked = value.real if self.parts == 1 else np.concatenate([value.real, value.imag])
        local = np.concatenate([self.local_rows(column, part) for part in range(self.parts)])
        shared = np.zeros((len(local), len(self.covariance.shared)))
        return stacked, self.scale * self.covariance.joint(shared, local)


def response_of(fitted: ModalFit, frequency_hz: FloatArray) -> ComplexArray:
    """(G, T, D) motion of all targets per motion of the table that a fit predicts at frequencies (G,)."""
    at = fitted.parameters
    columns = fitted.problem.basis.columns(np.asarray(frequency_hz, float), at.frequency_hz, at.damping)
    result: ComplexArray = np.einsum("gb,tdb->gtd", columns, at.coefficients)
    return result


def initial_parameters(problem: ModalProblem, frequency_hz: FloatArray, damping: FloatArray) -> ModalParameters:
    """Parameters with these poles and no residues yet."""
    targets, steps, directions = problem.observed.shape
    columns = problem.basis.residual_terms + len(frequency_hz)
    return ModalParameters(
        np.log(np.asarray(frequency_hz, float)),
        np.log(np.asarray(damping, float)),
        np.zeros((targets, directions, columns), complex),
        np.zeros(steps),
        np.zeros(steps),
    )


def fit(problem: ModalProblem, start: ModalParameters, iterations: int = ITERATIONS) -> ModalFit:
    """Improve a start until χ² no longer falls.

    Parameters
    ----------
    start
        For complex data poles are enough: the residues are found in the first iteration. For data without phase the
        residues must be near (see `phase_retrieval`).
    """
    now = start
    chi2, system = _evaluate(problem, now)
    damping, converged = 1e-4, False
    for _ in range(iterations):
        reduced = system.factorise()
        improved = False
        for _ in range(12):
            shared, local = reduced.step(damping)
            trial = _moved(problem, now, shared, local)
            new, trial_system = _evaluate(problem, trial)
            if np.isfinite(new) and new <= chi2:
                converged = chi2 - new <= CONVERGED * (1.0 + chi2)
                now, chi2, system, improved = trial, new, trial_system, True
                damping = max(damping / 10, 1e-12)
                break
            damping = min(max(damping, 1e-8) * 10, 1e8)
        converged = converged or not improved
        if converged:
            break
    covariance = system.factorise().covariance()
    return ModalFit(problem, now, covariance, chi2, _freedom(problem, now), converged)


def _evaluate(problem: ModalProblem, parameters: ModalParameters) -> tuple[float, BlockSystem]:
    system = problem.linearise(parameters)
    chi2 = float(np.sum(system.residual**2) + np.sum(system.prior_weight * system.prior_residual**2))
    return chi2, system


def _moved(problem: ModalProblem, at: ModalParameters, shared: FloatArray, local: FloatArray) -> ModalParameters:
    modes = at.modes
    # A pole moves by at most half a half-bandwidth in frequency and by a factor of two in damping: beyond that the
    # linearisation means nothing.
    step = np.concatenate([shared[:modes] / np.maximum(2 * at.damping, 1e-6), shared[modes : 2 * modes]])
    largest = float(np.max(np.abs(step), initial=0.0))
    factor = min(1.0, 0.7 / largest) if largest > 0 else 1.0
    shared, local = factor * shared, factor * local
    free = problem.free_gains
    count = int(free.sum())
    gain, phase = at.gain.copy(), at.phase_rad.copy()
    gain[free] += shared[2 * modes : 2 * modes + count]
    if problem.has_step_phases:
        phase = phase + shared[2 * modes + count :]
    targets, directions, columns = at.coefficients.shape
    parts = local.reshape(targets, directions, columns, -1)
    change = parts[..., 0] if problem.is_real else parts[..., 0] + 1j * parts[..., 1]
    return replace(
        at,
        log_frequency=at.log_frequency + shared[:modes],
        log_damping=at.log_damping + shared[modes : 2 * modes],
        coefficients=at.coefficients + change,
        gain=gain,
        phase_rad=phase,
    )


def _freedom(problem: ModalProblem, at: ModalParameters) -> int:
    rows = int(np.count_nonzero(problem.weight_real) + np.count_nonzero(problem.counted_imag))
    if problem.series.phase is PhaseReference.TARGET:
        own_phase = problem.counted_imag.any(axis=2) & ~problem.signed[None, :]
        rows -= int(np.count_nonzero(own_phase))
    targets, directions, columns = at.coefficients.shape
    fixed = problem.basis.residual_terms if problem.is_background_real else 0
    linear = targets * directions * (columns if problem.is_real else 2 * columns - fixed)
    return int(rows - linear - 2 * at.modes - problem.unknown_phases)


def refit(fitted: ModalFit, series: ResponseSeries) -> ModalFit:
    """Fit the same modes to a series with more steps behind those of `fitted`."""
    problem = fitted.problem.over(series)
    before = fitted.parameters
    more = np.zeros(series.steps - len(before.gain))
    start = replace(
        before,
        gain=np.concatenate([before.gain, more]),
        phase_rad=np.concatenate([before.phase_rad, more]),
    )
    if problem.has_step_phases:
        is_free = np.isinf(series.sd_phase()) & problem.signed
        start = replace(start, phase_rad=np.where(is_free, _best_phases(problem, start), start.phase_rad))
    return fit(problem, start)


def _best_phases(problem: ModalProblem, parameters: ModalParameters) -> FloatArray:
    """(K,) phases of the steps at which the model fits best."""
    model = problem.predict(replace(parameters, phase_rad=np.zeros(len(parameters.phase_rad))))
    overlap = np.sum(problem.weight_real**2 * problem.observed * model.conj(), axis=(0, 2))
    result: FloatArray = np.angle(overlap)
    return result


def remove_mode(fitted: ModalFit, index: int) -> ModalParameters:
    """Parameters of a fit without one of its modes, as a start."""
    at, column = fitted.parameters, fitted.problem.basis.residual_terms + index
    return replace(
        at,
        log_frequency=np.delete(at.log_frequency, index),
        log_damping=np.delete(at.log_damping, index),
        coefficients=np.delete(at.coefficients, column, axis=2),
    )


def add_residual_term(fitted: ModalFit) -> ModalFit:
    """The same modes on a background of one more term."""
    basis, at = fitted.problem.basis, fitted.parameters
    terms = basis.residual_terms
    coefficients = np.insert(at.coefficients, terms, 0.0, axis=2)
    problem = replace(fitted.problem, basis=replace(basis, residual_terms=terms + 1))
    return fit(problem, replace(at, coefficients=coefficients))
