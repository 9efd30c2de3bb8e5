from __future__ import annotations

import numpy as np
import pytest

from labdaemon.findings import ModalBasis, ModeForm
from labdaemon.findings.modal_basis import squared_columns

FREQUENCY = np.linspace(4.0, 14.0, 50)
NATURAL, DAMPING = np.array([5.4, 8.5]), np.array([0.02, 0.01])


@pytest.mark.parametrize("form", list(ModeForm))
def test_derivatives_match_differences(form: ModeForm) -> None:
    basis = ModalBasis.over(FREQUENCY, form)
    by_frequency, by_damping = basis.mode_derivatives(FREQUENCY, NATURAL, DAMPING)
    step = 1e-6
    moved = [basis.modes(FREQUENCY, NATURAL * np.exp(s * step), DAMPING) for s in (1, -1)]
    assert np.allclose((moved[0] - moved[1]) / (2 * step), by_frequency, rtol=1e-5, atol=1e-6)
    moved = [basis.modes(FREQUENCY, NATURAL, DAMPING * np.exp(s * step)) for s in (1, -1)]
    assert np.allclose((moved[0] - moved[1]) / (2 * step), by_damping, rtol=1e-5, atol=1e-6)


def test_squares_are_linear_in_the_squared_columns() -> None:
    """Partial fractions: the square of any response with real residues is a polynomial of f² and two columns a mode."""
    basis = ModalBasis.over(FREQUENCY, ModeForm.BASE_EXCITATION)
    rng = np.random.default_rng(1)
    square = np.abs(basis.columns(FREQUENCY, NATURAL, DAMPING) @ rng.normal(size=4)) ** 2
    x = (FREQUENCY / 9.0) ** 2
    columns = np.hstack([np.stack([x**k for k in range(3)], axis=1), squared_columns(FREQUENCY, NATURAL, DAMPING)])
    solution = np.linalg.lstsq(columns, square, rcond=None)[0]
    assert np.allclose(columns @ solution, square, rtol=1e-8)


def test_amplitude_at_resonance() -> None:
    column = ModalBasis().modes(np.array([5.4]), np.array([5.4]), np.array([0.02]))
    assert abs(column[0, 0]) == pytest.approx(25.0)
    assert column[0, 0].real == pytest.approx(0.0, abs=1e-12)


def test_far_below_a_mode_nothing_moves_against_the_table() -> None:
    assert abs(ModalBasis().modes(np.array([0.01]), NATURAL, DAMPING)).max() < 1e-5


def test_no_residual_terms() -> None:
    assert ModalBasis(residual_terms=0).columns(FREQUENCY, NATURAL, DAMPING).shape == (50, 2)
