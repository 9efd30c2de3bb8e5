from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModalBasis, PhaseReference, ResponseSeries, find_modes, joined, refit
from labdaemon.findings.mode_shape import ModeShape, mpc

SWEEP = np.geomspace(4.0, 18.0, 26)
DWELLS = np.array([5.35, 5.45, 15.4, 15.7])


def mixed(structure: ShearStructure, seed: int = 1, twist: float = 0.0) -> tuple[ResponseSeries, np.ndarray]:
    """Amplitudes of a sweep, and signed vectors of four dwells whose phases are unknown; with the true residues.

    Parameters
    ----------
    twist
        Phase of the residues from target to target, rad: damping that is not proportional.
    """
    rng = np.random.default_rng(seed)
    first = Instrument().measure(structure, SWEEP, rng)
    second = Instrument(phase=PhaseReference.STEP).measure(structure, DWELLS, rng)
    true = structure.residues().astype(complex)
    if twist:
        true[:, :, :2] *= np.exp(1j * twist * np.arange(len(true)))[:, None, None]
        natural, _ = structure.modes()
        both = np.concatenate([SWEEP, DWELLS])
        columns = ModalBasis(residual_terms=1).columns(both, natural, np.array(structure.damping))
        table = np.zeros((*true.shape[:2], 1))
        table[:, 0] = 1.0
        response = np.einsum("kb,tdb->ktd", columns, np.concatenate([table, true], axis=2))
        noise = 0.005 * (rng.normal(size=response.shape) + 1j * rng.normal(size=response.shape))
        gain = 1 + 0.002 * rng.normal(size=len(both))
        value = response * (np.concatenate([first.table_mm, second.table_mm]) * gain)[:, None, None] + noise
        axes = value * np.exp(-0.5j * np.angle(np.sum(value**2, axis=2, keepdims=True)))
        turn = np.exp(2j * np.pi * rng.uniform(size=len(DWELLS)))[:, None, None]
        first = replace(first, amplitude=axes[: len(SWEEP)])
        second = replace(second, amplitude=value[len(SWEEP) :] * turn)
    signed = np.arange(len(SWEEP) + len(DWELLS)) >= len(SWEEP)
    return replace(joined(first, second), signed=signed, sd_phase_rad=None), true


def test_dwells_with_phase_settle_the_signs_of_targets(structure: ShearStructure) -> None:
    series, true = mixed(structure)
    found = find_modes(series)
    assert found.fit is not None
    assert found.fit.problem.signed.sum() == 4
    assert 0.8 < found.fit.noise_factor < 1.25
    for mode, hz in zip(found.modes, structure.modes()[0], strict=False):
        assert abs(mode.frequency_hz - hz) < 4 * mode.sd_frequency_hz
        residues, covariance = found.fit.residues(mode.index)
        shape = residues[: len(residues) // found.fit.parts].reshape(-1, 3)[:, 0]
        expected = true[:, 0, int(np.argmin(np.abs(structure.modes()[0] - hz)))].real
        sd = np.sqrt(np.diag(covariance)[: true[..., 0].size : 3])
        assert np.abs(shape * np.sign(shape @ expected) - expected).max() < 5 * sd.max()


def test_dwells_with_phase_show_complex_shapes(structure: ShearStructure) -> None:
    series, true = mixed(structure, twist=0.02)
    found = find_modes(series)
    assert found.fit is not None
    assert found.fit.parts == 2
    assert found.fit.noise_factor < 1.3
    shape = ModeShape.of(found.fit, found.modes[0].index, structure.positions_mm())
    collinearity = mpc(shape)
    assert collinearity.value < 1 - 5 * collinearity.sd
    vector, expected = shape.vectors[:, 0], true[:, 0, 0]
    turn = np.vdot(vector, expected)
    assert vector * turn / abs(turn) == pytest.approx(expected, abs=0.02)


def test_phases_that_contradict_the_amplitudes_are_left_out(structure: ShearStructure) -> None:
    series, _ = mixed(structure)
    wrong = series.amplitude.copy()
    wrong[-4:] *= np.exp(2j * np.pi * np.random.default_rng(2).uniform(size=(4, 8)))[:, :, None]
    found = find_modes(replace(series, amplitude=wrong))
    assert len(found.modes) == 2
    assert "phases are not used" in found.reasons[-1]


def test_a_series_of_amplitudes_alone_is_as_before(structure: ShearStructure) -> None:
    first = Instrument().measure(structure, SWEEP, np.random.default_rng(1))
    plain, marked = find_modes(first), find_modes(replace(first, signed=np.zeros(len(SWEEP), bool)))
    assert [one.frequency_hz for one in plain.modes] == [one.frequency_hz for one in marked.modes]


def test_more_steps_with_phase_are_fitted_from_where_the_model_stands(structure: ShearStructure) -> None:
    series, _ = mixed(structure)
    found = find_modes(series)
    assert found.fit is not None
    more = Instrument(phase=PhaseReference.STEP).measure(structure, np.array([5.4, 15.5]), np.random.default_rng(5))
    longer = replace(joined(series, more), signed=np.append(series.signed_steps(), [True, True]))
    assert refit(found.fit, longer).noise_factor < 1.3


def test_a_gauge_on_the_table_shows_its_phase_with_an_error(structure: ShearStructure) -> None:
    """Phases 0.05 rad off at random cost little: they are parameters of the steps."""
    rng = np.random.default_rng(7)
    exact = Instrument(phase=PhaseReference.TABLE).measure(structure, SWEEP, rng)
    wrong = np.exp(0.05j * rng.normal(size=len(SWEEP)))[:, None, None]
    series = replace(exact, amplitude=exact.amplitude * wrong, sd_phase_rad=np.full(len(SWEEP), 0.05))
    found = find_modes(series)
    assert found.fit is not None
    assert 0.8 < found.fit.noise_factor < 1.25
    for mode, hz, damping in zip(found.modes, structure.modes()[0], structure.damping, strict=False):
        assert abs(mode.frequency_hz - hz) < 4 * mode.sd_frequency_hz < 4e-4 * hz
        assert abs(mode.damping - damping) < 4 * mode.sd_damping
    blind = find_modes(replace(series, sd_phase_rad=None))
    assert blind.fit is None or blind.fit.noise_factor > 10
