"""Curves of a fitted modal model: the structure's own response, smooth where it bends."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModalFit, PhaseReference, find_modes
from labdaemon.findings.fitted_response import curve_frequencies, fitted_response

STRUCTURE = ShearStructure(per_column=2)
NATURAL = STRUCTURE.modes()[0]


@pytest.fixture(scope="module")
def fitted() -> ModalFit:
    """A fit to complex responses around the first mode, table known exactly."""
    frequency = NATURAL[0] * np.linspace(0.9, 1.1, 13)
    instrument = Instrument(sd_mm=0.001, sd_table=1e-4, phase=PhaseReference.TABLE)
    found = find_modes(instrument.measure(STRUCTURE, frequency, np.random.default_rng(2)))
    assert found.fit is not None
    return found.fit


def test_the_response_is_the_structures_own_between_the_steps(fitted: ModalFit) -> None:
    frequency = NATURAL[0] * np.linspace(0.91, 1.09, 40)
    modelled, true = fitted_response(fitted, frequency), STRUCTURE.response(frequency)
    assert modelled.shape == true.shape == (40, 4, 3)
    assert np.abs(modelled - true).max() < 0.01 * np.abs(true).max()


def test_curves_are_ascending_inside_the_band_and_dense_at_the_pole(fitted: ModalFit) -> None:
    frequency = curve_frequencies(fitted)
    band = fitted.problem.series.frequency_hz
    assert np.all(np.diff(frequency) > 0)
    assert frequency[0] == pytest.approx(band.min())
    assert frequency[-1] == pytest.approx(band.max())
    half_width = NATURAL[0] * STRUCTURE.damping[0]
    assert np.count_nonzero(np.abs(frequency - NATURAL[0]) < half_width) >= 15


def test_a_curve_misses_little_of_its_peak(fitted: ModalFit) -> None:
    drawn = np.abs(fitted_response(fitted, curve_frequencies(fitted))).max(axis=(0, 2))
    close = np.abs(fitted_response(fitted, NATURAL[0] * np.linspace(0.99, 1.01, 4001))).max(axis=(0, 2))
    assert drawn == pytest.approx(close, rel=2e-3)
