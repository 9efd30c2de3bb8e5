from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModalBasis, ModalParameters, ModalProblem, PhaseReference, find_modes
from labdaemon.findings.linearise import MINOR_AXIS_SDS

FREQUENCY = np.geomspace(4.0, 18.0, 12)


def _problem(structure: ShearStructure, phase: PhaseReference, is_real: bool) -> tuple[ModalProblem, ModalParameters]:
    series = Instrument(phase=phase).measure(structure, FREQUENCY, np.random.default_rng(1))
    series = replace(series, at_rest=np.linalg.norm(series.amplitude, axis=2) < 0.3)
    problem = ModalProblem.of(series, ModalBasis.over(FREQUENCY, ModalBasis().form), is_real)
    rng = np.random.default_rng(2)
    targets = len(structure.positions_mm())
    coefficients = 0.3 * rng.normal(size=(targets, 3, 4)) + (0 if is_real else 0.1j) * rng.normal(size=(targets, 3, 4))
    return problem, ModalParameters(
        np.log([5.5, 15.8]),
        np.log([0.012, 0.011]),
        coefficients.astype(complex),
        0.001 * rng.normal(size=12),
        0.1 * rng.normal(size=12) if phase is PhaseReference.STEP else np.zeros(12),
    )


@pytest.mark.parametrize(
    ("phase", "is_real"), [(p, r) for p in (PhaseReference.TABLE, PhaseReference.STEP) for r in (True, False)]
)
def test_derivatives_are_those_of_the_chi_square(
    structure: ShearStructure, phase: PhaseReference, is_real: bool
) -> None:
    """The gradient of half χ² by differences equals −Jᵀr."""
    problem, at = _problem(structure, phase, is_real)

    def half_chi2(parameters: ModalParameters) -> float:
        return 0.5 * float(np.sum(problem.linearise(parameters).residual ** 2))

    system = problem.linearise(at)
    gradient = -np.einsum("trn,tr->n", system.shared, system.residual)
    step = 1e-6
    for index in range(2):
        for name, place in (("log_frequency", index), ("log_damping", index + 2)):
            moved = []
            for sign in (1, -1):
                values = getattr(at, name).copy()
                values[index] += sign * step
                moved.append(half_chi2(replace(at, **{name: values})))
            assert (moved[0] - moved[1]) / (2 * step) == pytest.approx(gradient[place], rel=2e-4, abs=1.0)
    local = -np.einsum("trl,tr->tl", system.local, system.residual)
    values = [at.coefficients.copy() for _ in range(2)]
    values[0][1, 0, 3] += step
    values[1][1, 0, 3] -= step
    slope = (half_chi2(replace(at, coefficients=values[0])) - half_chi2(replace(at, coefficients=values[1]))) / (
        2 * step
    )
    assert slope == pytest.approx(local[1, 3 if is_real else 6], rel=2e-4, abs=1.0)


def test_gains_have_a_prior(structure: ShearStructure) -> None:
    problem, at = _problem(structure, PhaseReference.TABLE, True)
    system = problem.linearise(at)
    assert np.allclose(system.prior_weight[4:], 1 / 0.002**2)
    assert np.allclose(system.prior_residual[4:], -at.gain)


def test_exact_tables_have_no_gains(structure: ShearStructure) -> None:
    problem, at = _problem(structure, PhaseReference.TABLE, True)
    exact = replace(problem, series=replace(problem.series, sd_table=np.zeros(12)))
    assert exact.linearise(at).shared.shape[2] == 4


def test_small_minor_axes_are_noise(structure: ShearStructure) -> None:
    problem, _ = _problem(structure, PhaseReference.TARGET, True)
    series = problem.series
    small = (np.abs(series.amplitude.imag) < MINOR_AXIS_SDS * series.sd_imag).transpose(1, 0, 2)
    small &= ~problem.squared[:, :, None]
    assert small.any()
    assert np.all(problem.observed[small].imag == 0)
    assert np.all(problem.weight_imag[small] <= 1 / series.sd_imag.transpose(1, 0, 2)[small])


def test_direction_of_rotation_does_not_matter(structure: ShearStructure) -> None:
    """An orbit and its reverse are the same data where phases are unknown."""
    series = Instrument().measure(structure, FREQUENCY, np.random.default_rng(4))
    mirrored = replace(series, amplitude=np.conj(series.amplitude))
    one, other = (find_modes(each).modes for each in (series, mirrored))
    assert [m.frequency_hz for m in one] == pytest.approx([m.frequency_hz for m in other], rel=1e-6)
