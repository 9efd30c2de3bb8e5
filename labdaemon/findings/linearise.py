"""Predictions of a modal model and their derivatives, for complex, signed and amplitude-only data in one form.

Where the phase of a target at a step is unknown, the prediction is first turned by the phase at which it fits best,
and what a change of that phase would do is projected out of all derivatives. A scalar then leaves |a + ib| − |U|; a
vector keeps the relative signs of its components. An orbit whose direction of rotation is unknown is compared with
both.

Below the detection limit the amplitude has a Rice-like error (Rice 1944, doi:10.1002/j.1538-7305.1944.tb00874.x), but
its square, which is what a blurred image shows, has a normal one: there the squares are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labdaemon.findings.bordered import BlockSystem
from labdaemon.findings.modal_basis import ModalBasis
from labdaemon.findings.response import BoolArray, ComplexArray, FloatArray, PhaseReference, ResponseSeries

MINOR_AXIS_SDS = 4.0
"""Minor semi-axes below so many sd are magnitudes of noise: their sign is not known, and their mean is 0."""

LEAST_PHASE_SD = 1e-6
"""Radians; an exact phase among others that are not."""
FIXED = 1e12
"""Weight of a phase that does not move."""


@dataclass(frozen=True, slots=True, eq=False)
class ModalParameters:
    """All parameters of a modal model.

    Attributes
    ----------
    log_frequency, log_damping
        (M,) natural logarithms of Hz and of ζ.
    coefficients
        (T, D, P) of the residual terms and, last, of the M modes: the residues.
    gain, phase_rad
        (K,) error of the table's amplitude (relative) and phase of a step.
    """

    log_frequency: FloatArray
    log_damping: FloatArray
    coefficients: ComplexArray
    gain: FloatArray
    phase_rad: FloatArray

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.log_frequency)

    @property
    def frequency_hz(self) -> FloatArray:
        """(M,) natural frequencies."""
        return np.asarray(np.exp(self.log_frequency))

    @property
    def damping(self) -> FloatArray:
        """(M,) damping ratios."""
        return np.asarray(np.exp(self.log_damping))


@dataclass(frozen=True, slots=True, eq=False)
class ModalProblem:
    """Data in the order of the fit, and which parameters are free.

    Attributes
    ----------
    observed
        (T, K, D) complex; 0 where invalid.
    weight_real, weight_imag
        (T, K, D) inverse standard deviations; 0 where invalid.
    squared
        (T, K) where squares are compared.
    counted_imag
        (T, K, D) where the imaginary part is an observation of its own: not where it is a magnitude of noise.
    is_real
        Whether residues and residual terms are real (proportional damping), as amplitudes alone require.
    is_noise_known
        False where the standard deviations are estimates from the residuals.
    is_background_real
        Whether residual terms are real where residues are complex: few steps show phase.
    """

    series: ResponseSeries
    basis: ModalBasis
    observed: ComplexArray
    weight_real: FloatArray
    weight_imag: FloatArray
    squared: BoolArray
    counted_imag: BoolArray
    is_real: bool
    is_noise_known: bool = True
    is_background_real: bool = False

    def scaled(self, factor: float) -> ModalProblem:
        """The problem with all standard deviations multiplied by an estimate of the noise."""
        return replace(
            self,
            weight_real=self.weight_real / factor,
            weight_imag=self.weight_imag / factor,
            is_noise_known=False,
        )

    def over(self, series: ResponseSeries) -> ModalProblem:
        """The same question, asked of another series."""
        problem = ModalProblem.of(series, self.basis, self.is_real)
        return replace(problem, is_background_real=self.is_background_real)

    @classmethod
    def of(cls, series: ResponseSeries, basis: ModalBasis, is_real: bool) -> ModalProblem:
        """Prepare a series."""
        valid = series.valid()
        order = (1, 0, 2)
        value = np.where(valid, series.amplitude, 0)
        sd_imag = np.where(valid, series.sd_imag, 1.0)
        squared, counted = np.zeros(series.amplitude.shape[:2], bool), valid
        if series.phase is PhaseReference.TARGET:
            axes = ~series.signed_steps()[:, None]  # steps whose vectors are semi-axes
            squared = series.resting() & axes
            small = (np.abs(value.imag) < MINOR_AXIS_SDS * sd_imag) & axes[:, :, None]
            sd_imag = np.where(small, np.hypot(sd_imag, value.imag), sd_imag)
            value = np.where(small & ~squared[:, :, None], value.real.astype(complex), value)
            counted = valid & ~small & ~squared[:, :, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            real = np.where(valid, 1.0 / series.sd_real, 0.0)
        imag = np.where(valid, 1.0 / sd_imag, 0.0)
        return cls(
            series,
            basis,
            value.transpose(order),
            real.transpose(order),
            imag.transpose(order),
            squared.T.copy(),
            counted.transpose(order),
            is_real,
        )

    @property
    def free_gains(self) -> BoolArray:
        """(K,) steps whose table amplitude has an error."""
        return np.asarray(self.series.sd_table > 0)

    @property
    def has_step_phases(self) -> bool:
        """Whether the steps' phases are parameters: unknown, or known with an error."""
        return bool(np.any(self.signed & (self.series.sd_phase() > 0)))

    @property
    def signed(self) -> BoolArray:
        """(K,) steps whose targets have phases relative to each other."""
        if self.series.phase is not PhaseReference.TARGET:
            return np.ones(self.series.steps, bool)
        return self.series.signed_steps()

    @property
    def unknown_phases(self) -> int:
        """Number of steps whose phase nothing determines beforehand."""
        return int(np.count_nonzero(np.isinf(self.series.sd_phase()) & self.signed)) if self.has_step_phases else 0

    def predict(self, parameters: ModalParameters) -> ComplexArray:
        """(T, K, D) responses, mm, without an unknown phase."""
        columns = self.basis.columns(self.series.frequency_hz, parameters.frequency_hz, parameters.damping)
        gain = self.series.table_mm * (1 + parameters.gain) * np.exp(1j * parameters.phase_rad)
        result: ComplexArray = gain[None, :, None] * np.einsum("kb,tdb->tkd", columns, parameters.coefficients)
        return result

    def linearise(self, parameters: ModalParameters) -> BlockSystem:
        """Residuals and derivatives at these parameters."""
        series, basis = self.series, self.basis
        f0, zeta = parameters.frequency_hz, parameters.damping
        columns = basis.columns(series.frequency_hz, f0, zeta)
        gain = series.table_mm * (1 + parameters.gain) * np.exp(1j * parameters.phase_rad)
        predicted = gain[None, :, None] * np.einsum("kb,tdb->tkd", columns, parameters.coefficients)
        local = self._local_columns(gain[:, None] * columns)
        shared = self._shared_columns(parameters, gain, predicted)
        observed, turned = self._match_phase(predicted)
        return self._weigh(
            observed, turned * predicted, turned[..., None] * local, turned[..., None] * shared, parameters
        )

    def _local_columns(self, columns: ComplexArray) -> ComplexArray:
        """(T, K, D, L) derivatives by the linear parameters, in the order direction, column, part."""
        targets, steps, directions = self.observed.shape
        parts = np.array([1.0]) if self.is_real else np.array([1.0, 1j])
        split = columns[:, :, None] * parts
        if self.is_background_real:
            split[:, : self.basis.residual_terms, 1:] = 0.0
        each = split.reshape(steps, -1)
        local = np.zeros((steps, directions, directions, each.shape[1]), complex)
        for direction in range(directions):
            local[:, direction, direction] = each
        flat = local.reshape(steps, directions, -1)
        return np.asarray(np.broadcast_to(flat[None], (targets, *flat.shape)))

    def _shared_columns(self, parameters: ModalParameters, gain: FloatArray, predicted: ComplexArray) -> ComplexArray:
        """(T, K, D, n) derivatives by ln f, ln ζ, gains and step phases."""
        basis, modes = self.basis, parameters.modes
        derivatives = basis.mode_derivatives(self.series.frequency_hz, parameters.frequency_hz, parameters.damping)
        residues = parameters.coefficients[:, :, basis.residual_terms :]
        parts = [gain[None, :, None, None] * np.einsum("kr,tdr->tkdr", one, residues) for one in derivatives]
        if not modes:
            parts = []
        for is_wanted, factor in ((True, 1 / (1 + parameters.gain)), (self.has_step_phases, 1j * np.ones(len(gain)))):
            index = np.flatnonzero(self.free_gains) if factor.dtype == float else np.arange(len(gain))
            if is_wanted and index.size:
                block = np.zeros((*predicted.shape, index.size), complex)
                block[:, index, :, np.arange(index.size)] = (predicted * factor[None, :, None])[:, index].transpose(
                    1, 0, 2
                )
                parts.append(block)
        return np.concatenate(parts, axis=3) if parts else np.zeros((*predicted.shape, 0), complex)

    def _match_phase(self, predicted: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Observations in the direction of rotation, and (T, K, 1) the phase factor, that match the prediction best."""
        observed = self.observed
        if self.series.phase is not PhaseReference.TARGET:
            return observed, np.ones((*observed.shape[:2], 1), complex)
        weight = 0.5 * (self.weight_real**2 + self.weight_imag**2)
        forward = np.sum(weight * np.conj(predicted) * observed, axis=2, keepdims=True)
        backward = np.sum(weight * np.conj(predicted) * np.conj(observed), axis=2, keepdims=True)
        is_back = np.abs(backward) > np.abs(forward)
        is_back &= ~self.signed[None, :, None]
        best = np.where(is_back, np.conj(backward), forward)
        # The principal axes keep their sd when the orbit runs backwards, so the prediction is mirrored, not the data.
        is_turned = (np.abs(best) > 0) & ~self.signed[None, :, None]
        return np.where(is_back, np.conj(observed), observed), np.where(
            is_turned, np.where(is_back, backward, forward) / np.maximum(np.abs(best), 1e-300), 1.0
        )

    def _weigh(
        self,
        observed: ComplexArray,
        predicted: ComplexArray,
        local: ComplexArray,
        shared: ComplexArray,
        parameters: ModalParameters,
    ) -> BlockSystem:
        """To real rows of unit variance, with the unknown phase projected out."""
        weights = np.stack([self.weight_real, self.weight_imag], axis=3)
        residual = _rows(observed - predicted, weights)
        jacobians = [_rows(local, weights[..., None]), _rows(shared, weights[..., None])]
        if self.series.phase is PhaseReference.TARGET:
            normal = _rows(1j * predicted, weights) * ~self.signed[None, :, None]
            length2 = np.maximum(np.sum(normal**2, axis=2), 1e-300)
            residual = residual - normal * (np.sum(normal * residual, axis=2) / length2)[..., None]
            jacobians = [
                one - normal[..., None] * (np.einsum("tkr,tkrn->tkn", normal, one) / length2[..., None])[:, :, None]
                for one in jacobians
            ]
            residual, jacobians = self._compare_squares(residual, jacobians, predicted, (local, shared))
        targets, steps, rows = residual.shape
        weight, prior = self._priors(parameters)
        return BlockSystem(
            jacobians[0].reshape(targets, steps * rows, -1),
            jacobians[1].reshape(targets, steps * rows, -1),
            residual.reshape(targets, -1),
            weight,
            prior,
        )

    def _compare_squares(
        self,
        residual: FloatArray,
        jacobians: list[FloatArray],
        predicted: ComplexArray,
        derivatives: tuple[ComplexArray, ComplexArray],
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Put squared amplitudes where the amplitude is below the detection limit."""
        where = np.nonzero(self.squared)
        if not where[0].size:
            return residual, jacobians
        observed, weight, value = self.observed[where], self.weight_real[where], predicted[where]
        sd = np.where(weight > 0, 1 / np.maximum(weight, 1e-300), 1.0)
        sd2 = np.sqrt(4 * np.abs(observed) ** 2 * sd**2 + 2 * sd**4)
        each = np.where(weight > 0, 1 / sd2, 0.0)
        directions = observed.shape[1]
        first = (where[0], where[1], slice(0, directions))
        residual = residual.copy()
        residual[where] = 0.0
        residual[first] = (np.abs(observed) ** 2 - np.abs(value) ** 2) * each
        for one, derivative in zip(jacobians, derivatives, strict=True):
            one[where] = 0.0
            one[first] = 2 * (np.conj(value)[..., None] * derivative[where]).real * each[..., None]
        return residual, jacobians

    def _priors(self, parameters: ModalParameters) -> tuple[FloatArray, FloatArray]:
        """Weights (n,) of what is known of the shared parameters, and the known minus the present values."""
        modes = parameters.modes
        free = self.free_gains
        weight = [np.zeros(2 * modes), 1.0 / self.series.sd_table[free] ** 2]
        known = [np.zeros(2 * modes), -parameters.gain[free]]
        if self.has_step_phases:
            sd = np.maximum(self.series.sd_phase(), LEAST_PHASE_SD)
            is_known = np.isfinite(sd)
            each = np.where(is_known, 1.0 / sd**2, 0.0)
            if not (self.is_real or self.is_background_real or is_known[self.signed].any()):
                # One step's phase is the reference: a turn of all phases and all residues together changes nothing.
                each[int(np.argmax(self.signed))] = FIXED
            each[~self.signed] = FIXED
            weight.append(each)
            known.append(np.where(is_known, -parameters.phase_rad, 0.0))
        return np.concatenate(weight), np.concatenate(known)


def _rows(values: ComplexArray, weights: FloatArray) -> FloatArray:
    """Real and imaginary part of (T, K, D, …) as weighted rows (T, K, 2 D, …): all real parts first."""
    extra = values.shape[3:]
    real = values.real * weights[:, :, :, 0].reshape(*values.shape[:3], *(1 for _ in extra))
    imag = values.imag * weights[:, :, :, 1].reshape(*values.shape[:3], *(1 for _ in extra))
    return np.concatenate([real, imag], axis=2)
