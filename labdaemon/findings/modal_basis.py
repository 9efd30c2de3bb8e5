"""Modes and residual terms as functions of frequency.

A point of a structure on a table that moves as x(t) has, per unit of the table's amplitude, the response

    U(f) = c0 + c1·(f/fc)² + Σ_r R_r · f² / (f_r² − f² + 2i ζ_r f_r f)

c0 is the table's own motion and the modes below the band, c1 the modes above it (the residual terms), f_r natural
frequency, ζ_r damping ratio and R_r the residue: mode shape times participation factor, so that R_r/(2ζ_r) is the
amplitude at resonance. Only f_r and ζ_r enter nonlinearly. For spectra of a free decay or of a receptance the mode has
1 instead of f², and the residual terms are f0/f-free: see `ModeForm`.

Ewins, Modal Testing (2nd ed., 2000), section 4; residual terms there are the lower and upper residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from labdaemon.findings.response import ComplexArray, FloatArray


class ModeForm(Enum):
    """Numerator of a mode, and the residual terms that belong to it."""

    BASE_EXCITATION = "base"
    """f²: displacement per table displacement, or accelerance."""
    LOCAL = "local"
    """f_r²: any spectrum within a narrow window, with a polynomial of frequency as residual."""


@dataclass(frozen=True, slots=True, eq=False)
class ModalBasis:
    """Functions of frequency whose linear combinations are the responses.

    Attributes
    ----------
    form
        Of modes and residual terms.
    residual_terms
        0: none; 1: constant; 2: constant and f² (constant and slope for `ModeForm.LOCAL`); 3: one power more.
    centre_hz, width_hz
        Scale of the residual terms.
    """

    form: ModeForm = ModeForm.BASE_EXCITATION
    residual_terms: int = 2
    centre_hz: float = 1.0
    width_hz: float = 1.0

    @classmethod
    def over(cls, frequency_hz: FloatArray, form: ModeForm, residual_terms: int = 2) -> ModalBasis:
        """Basis scaled to a band."""
        low, high = float(np.min(frequency_hz)), float(np.max(frequency_hz))
        return cls(form, residual_terms, 0.5 * (low + high), max(0.5 * (high - low), 1e-9))

    def residuals(self, frequency_hz: FloatArray) -> ComplexArray:
        """(K, residual_terms) columns of the residual terms."""
        if self.form is ModeForm.BASE_EXCITATION:
            powers = [(frequency_hz / self.centre_hz) ** (2 * k) for k in range(self.residual_terms)]
        else:
            powers = [((frequency_hz - self.centre_hz) / self.width_hz) ** k for k in range(self.residual_terms)]
        return np.stack(powers, axis=1).astype(complex) if powers else np.zeros((len(frequency_hz), 0), complex)

    def modes(self, frequency_hz: FloatArray, natural_hz: FloatArray, damping: FloatArray) -> ComplexArray:
        """(K, M) columns of the modes."""
        f, f0 = frequency_hz[:, None], natural_hz[None, :]
        numerator = f**2 if self.form is ModeForm.BASE_EXCITATION else f0**2
        result: ComplexArray = numerator / self._denominator(frequency_hz, natural_hz, damping)
        return result

    @staticmethod
    def _denominator(frequency_hz: FloatArray, natural_hz: FloatArray, damping: FloatArray) -> ComplexArray:
        f, f0 = frequency_hz[:, None], natural_hz[None, :]
        return np.asarray(f0**2 - f**2 + 2j * damping[None, :] * f0 * f, np.complex128)

    def mode_derivatives(
        self, frequency_hz: FloatArray, natural_hz: FloatArray, damping: FloatArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """(K, M) derivatives of `modes` by ln f_r and by ln ζ_r."""
        f, f0, zeta = frequency_hz[:, None], natural_hz[None, :], damping[None, :]
        column = self.modes(frequency_hz, natural_hz, damping)
        denominator = self._denominator(frequency_hz, natural_hz, damping)
        by_frequency = -column * (2 * f0**2 + 2j * zeta * f0 * f) / denominator
        if self.form is ModeForm.LOCAL:
            by_frequency = by_frequency + 2 * column
        return by_frequency, np.asarray(-column * (2j * zeta * f0 * f) / denominator, np.complex128)

    def columns(self, frequency_hz: FloatArray, natural_hz: FloatArray, damping: FloatArray) -> ComplexArray:
        """(K, residual_terms + M) all columns."""
        return np.hstack([self.residuals(frequency_hz), self.modes(frequency_hz, natural_hz, damping)])


def squared_columns(frequency_hz: FloatArray, natural_hz: FloatArray, damping: FloatArray) -> FloatArray:
    """(K, 2 M) columns that span a mode's part of a squared amplitude.

    |U|² is a rational function of x = f² with the denominators |D_r|² = (f_r² − x)² + 4ζ_r² f_r² x, so by partial
    fractions it is a polynomial of x plus Σ (α_r + β_r x)/|D_r|²: linear in all but the poles, without any phase.
    """
    x, x0 = frequency_hz[:, None] ** 2, natural_hz[None, :] ** 2
    denominator = (x0 - x) ** 2 + 4 * damping[None, :] ** 2 * x0 * x
    return np.hstack([x0**2 / denominator, (x - x0) * x0 / denominator])
