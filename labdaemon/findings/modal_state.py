"""A structure's state as a vector with a covariance: frequencies, dampings and shapes of its modes, to be compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from labdaemon.findings.modal_fit import ModalFit
from labdaemon.findings.mode_shape import mac_value
from labdaemon.findings.response import FloatArray

SAME_MODE_MAC = 0.3
SAME_MODE_LOG_HZ = 0.35
"""Modes of two states are paired if their shapes are at least so similar and their frequencies at most so far apart."""


@dataclass(frozen=True, slots=True, eq=False)
class ModalState:
    """Modes of one state of a structure.

    Attributes
    ----------
    log_frequency, log_damping
        (M,) natural logarithms, ascending in frequency.
    shapes
        (M, T, D) real shapes, mm per mm of the table.
    covariance
        Of (log_frequency, log_damping, shapes) in this order, (2 M + M·T·D) squared.
    positions_mm
        (T, 3).
    targets
        (T,) names.
    """

    log_frequency: FloatArray
    log_damping: FloatArray
    shapes: FloatArray
    covariance: FloatArray
    positions_mm: FloatArray
    targets: tuple[str, ...]

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.log_frequency)

    @property
    def frequency_hz(self) -> FloatArray:
        """(M,)."""
        return np.asarray(np.exp(self.log_frequency))

    def vector(self) -> FloatArray:
        """All numbers, in the order of the covariance."""
        return np.concatenate([self.log_frequency, self.log_damping, self.shapes.ravel()])

    def subset(self, modes: NDArray[np.intp], targets: NDArray[np.intp]) -> ModalState:
        """Some modes at some targets, in the order given."""
        count = self.modes
        places = np.arange(self.shapes.size).reshape(self.shapes.shape)[np.ix_(modes, targets)].ravel()
        index = np.concatenate([modes, count + modes, 2 * count + places])
        return ModalState(
            self.log_frequency[modes],
            self.log_damping[modes],
            self.shapes[np.ix_(modes, targets)],
            self.covariance[np.ix_(index, index)],
            self.positions_mm[targets],
            tuple(self.targets[i] for i in targets),
        )

    def flipped(self, mode_signs: FloatArray, target_signs: FloatArray) -> ModalState:
        """Shapes with other signs of modes and of targets."""
        sign = (mode_signs[:, None, None] * target_signs[None, :, None]) * np.ones(self.shapes.shape)
        factor = np.concatenate([np.ones(2 * self.modes), sign.ravel()])
        return replace(self, shapes=self.shapes * sign, covariance=self.covariance * np.outer(factor, factor))

    def rotated(self, rotation: FloatArray) -> ModalState:
        """Shapes in other axes, (3, 3) rotation (and scale); positions stay."""
        count = self.modes
        jacobian = np.eye(len(self.covariance))
        jacobian[2 * count :, 2 * count :] = np.kron(np.eye(count * len(self.targets)), rotation)
        return replace(self, shapes=self.shapes @ rotation.T, covariance=jacobian @ self.covariance @ jacobian.T)


def state_of(fitted: ModalFit, positions_mm: FloatArray, targets: tuple[str, ...]) -> ModalState:
    """The state that a modal fit describes.

    Complex residues of a mode are turned by the phase at which most of them is real, and their real part is taken: what
    is left out shows in the modal phase collinearity.
    """
    order = np.argsort(fitted.parameters.log_frequency)
    count, (number, dimension) = fitted.modes, fitted.parameters.coefficients.shape[:2]
    shared = np.zeros((2 * count, len(fitted.covariance.shared)))
    shared[np.arange(count), order] = 1.0
    shared[count + np.arange(count), count + order] = 1.0
    signs = _target_signs(fitted)
    shapes, rows = np.zeros((count, number, dimension)), []
    for place, mode in enumerate(order):
        column = fitted.problem.basis.residual_terms + int(mode)
        residues = fitted.parameters.coefficients[:, :, column]
        angle = 0.5 * np.angle(np.sum(residues**2)) if fitted.parts == 2 else 0.0
        turn = np.exp(-1j * angle)
        shapes[place] = (residues * turn).real * signs[:, None]
        local = fitted.local_rows(column) * turn.real
        if fitted.parts == 2:
            local = local - fitted.local_rows(column, 1) * turn.imag
        rows.append(local * np.repeat(signs, dimension)[:, None, None])
    local_rows = np.concatenate([np.zeros((2 * count, *rows[0].shape[1:])), *rows])
    shared_rows = np.vstack([shared, np.zeros((len(local_rows) - 2 * count, shared.shape[1]))])
    at = fitted.parameters
    return ModalState(
        at.log_frequency[order],
        at.log_damping[order],
        shapes,
        fitted.scale * fitted.covariance.joint(shared_rows, local_rows),
        np.asarray(positions_mm, float),
        targets,
    )


def _target_signs(fitted: ModalFit) -> FloatArray:
    """(T,) signs that let all targets ride the table the same way, where amplitudes alone leave each its own sign."""
    coefficients = fitted.parameters.coefficients
    if fitted.problem.signed.any() or not fitted.problem.basis.residual_terms:
        return np.ones(len(coefficients))
    constant = coefficients[:, :, 0].real
    vector = np.linalg.eigh(constant.T @ constant)[1][:, -1]
    vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
    return np.where(constant @ vector < 0, -1.0, 1.0)


def pair_modes(baseline: ModalState, other: ModalState) -> list[tuple[int, int]]:
    """Pairs of modes of two states with the same targets: the same shape and about the same frequency."""
    cost = np.zeros((baseline.modes, other.modes))
    likeness = np.zeros_like(cost)
    for i in range(baseline.modes):
        for j in range(other.modes):
            # Without a reference each target has its own sign, so magnitudes are compared.
            one, two = np.abs(baseline.shapes[i]).ravel(), np.abs(other.shapes[j]).ravel()
            likeness[i, j] = mac_value(one.astype(complex), two.astype(complex))
            away = abs(baseline.log_frequency[i] - other.log_frequency[j])
            cost[i, j] = 1 - likeness[i, j] + away / SAME_MODE_LOG_HZ
    return [
        (int(i), int(j))
        for i, j in zip(*linear_sum_assignment(cost), strict=True)
        if likeness[i, j] >= SAME_MODE_MAC
        and abs(baseline.log_frequency[i] - other.log_frequency[j]) <= SAME_MODE_LOG_HZ
    ]


def align_signs(baseline: ModalState, other: ModalState, *, targets_too: bool) -> ModalState:
    """The other state with the signs of modes, and of targets where they are free, that agree best."""
    product = np.sum(baseline.shapes * other.shapes, axis=2)
    modes, targets = np.ones(baseline.modes), np.ones(len(baseline.targets))
    for _ in range(6):
        modes = np.where(product @ targets < 0, -1.0, 1.0)
        if targets_too:
            targets = np.where(modes @ product < 0, -1.0, 1.0)
    return other.flipped(modes, targets)
