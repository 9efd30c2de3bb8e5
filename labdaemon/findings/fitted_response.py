"""Response of a fitted modal model at any frequency, and frequencies that show its resonances."""

from __future__ import annotations

import numpy as np

from labdaemon.findings.modal_fit import ModalFit
from labdaemon.findings.response import ComplexArray, FloatArray

STEADY_POINTS = 120
"""Frequencies over the whole band."""
RESONANCE_POINTS = 41
"""Frequencies around each pole; dense where the curve bends, within 8 half-bandwidths."""


def fitted_response(fitted: ModalFit, frequency_hz: FloatArray) -> ComplexArray:
    """(K, T, D) modelled response per unit of the table's amplitude, at (K,) frequencies, Hz."""
    at = fitted.parameters
    columns = fitted.problem.basis.columns(np.asarray(frequency_hz, float), at.frequency_hz, at.damping)
    result: ComplexArray = np.einsum("kb,tdb->ktd", columns, at.coefficients)
    return result


def curve_frequencies(fitted: ModalFit) -> FloatArray:
    """(K,) ascending frequencies, Hz, over the band of the fitted series, at which its curves look smooth."""
    measured = fitted.problem.series.frequency_hz
    low, high = float(measured.min()), float(measured.max())
    around = np.tan(np.linspace(-1.45, 1.45, RESONANCE_POINTS))
    poles = fitted.parameters.frequency_hz[:, None] * (1.0 + fitted.parameters.damping[:, None] * around)
    every = np.concatenate([np.geomspace(low, high, STEADY_POINTS), poles.ravel()])
    return np.unique(every[(every >= low) & (every <= high)])
