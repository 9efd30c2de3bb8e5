from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModeForm, ModeSearch, PhaseReference, ResponseSeries, find_modes, frequency_response
from labdaemon.findings.find_modes import unusable_pole

BAND = np.geomspace(4.0, 18.0, 26)


@pytest.mark.parametrize("phase", list(PhaseReference))
def test_blind_search_finds_each_mode_of_the_band(structure: ShearStructure, phase: PhaseReference) -> None:
    series = Instrument(phase=phase).measure(structure, BAND, np.random.default_rng(2))
    found = find_modes(series, is_real=True)
    natural, _ = structure.modes()
    assert len(found.modes) == 2
    for mode, true_hz, true_damping in zip(found.modes, natural, structure.damping, strict=False):
        assert abs(mode.frequency_hz - true_hz) < 4 * mode.sd_frequency_hz
        assert abs(mode.damping - true_damping) < 4 * mode.sd_damping
        assert mode.sd_frequency_hz < 2e-4 * true_hz
        assert mode.p_value < 1e-3


def test_residual_terms_take_the_modes_outside_the_band(swept: ModeSearch) -> None:
    assert swept.fit is not None
    assert 0.8 < swept.fit.noise_factor < 1.25


def test_signs_come_from_amplitudes_alone(swept: ModeSearch, structure: ShearStructure) -> None:
    """The table's motion, which is in all amplitudes, is the reference of the signs."""
    assert swept.fit is not None
    coefficients = swept.fit.parameters.coefficients
    sign = np.sign(coefficients[:, 0, 0].real)
    true = structure.residues()
    for mode in swept.modes:
        column = swept.fit.problem.basis.residual_terms + mode.index
        shape = coefficients[:, 0, column].real * sign
        nearest = int(np.argmin(np.abs(structure.modes()[0] - mode.frequency_hz)))
        assert np.allclose(shape, true[:, 0, nearest], atol=0.02)


def test_complex_residues_are_found_with_a_phase_reference(structure: ShearStructure) -> None:
    series = Instrument(phase=PhaseReference.TABLE).measure(structure, BAND, np.random.default_rng(3))
    turned = replace(series, amplitude=series.amplitude * np.exp(0.3j))
    found = find_modes(turned, is_real=False)
    assert [round(mode.frequency_hz, 1) for mode in found.modes] == [round(f, 1) for f in structure.modes()[0][:2]]


def test_noise_has_no_modes() -> None:
    rng = np.random.default_rng(4)
    frequency = np.linspace(4.0, 14.0, 30)
    for phase in PhaseReference:
        noise = rng.normal(size=(30, 5, 2)) + 1j * rng.normal(size=(30, 5, 2))
        if phase is PhaseReference.TARGET:
            noise = noise * np.exp(-0.5j * np.angle(np.sum(noise**2, axis=2, keepdims=True)))
        amplitude = noise * 0.005 + (0.0 if phase is PhaseReference.TARGET else 1.0)
        sd = np.full((30, 5, 2), 0.005)
        series = ResponseSeries(frequency, amplitude, sd, sd, np.ones(30), np.full(30, 0.002), phase)
        found = find_modes(series, is_real=True)
        assert found.modes == ()
        assert found.reasons


def test_false_alarms_of_complex_noise_stay_below_their_rate() -> None:
    rng = np.random.default_rng(5)
    frequency = np.linspace(100.0, 120.0, 40)
    alarms = 0
    for _ in range(60):
        noise = rng.normal(size=(40, 2)) + 1j * rng.normal(size=(40, 2))
        found = find_modes(
            frequency_response(frequency, noise), form=ModeForm.LOCAL, is_noise_known=False, most=1, is_real=False
        )
        alarms += bool(found.modes)
    assert alarms <= 2


def test_negative_damping_is_no_mode() -> None:
    frequency = np.linspace(100.0, 120.0, 60)
    unstable = 110.0**2 / (110.0**2 - frequency**2 - 2j * 0.005 * 110.0 * frequency)
    noise = np.random.default_rng(6).normal(size=(2, 60)) * 0.1
    found = find_modes(
        frequency_response(frequency, (unstable + noise[0] + 1j * noise[1])[:, None]),
        form=ModeForm.LOCAL,
        is_noise_known=False,
    )
    assert found.modes == ()
    assert "negative damping" in found.reasons[0]


def test_too_few_steps_are_said(structure: ShearStructure) -> None:
    series = Instrument().measure(structure, np.array([5.0, 5.3, 5.6]), np.random.default_rng(1))
    found = find_modes(series)
    assert found.fit is None
    assert "at least 5" in found.reasons[0]


def test_one_frequency_is_no_sweep(structure: ShearStructure) -> None:
    series = Instrument().measure(structure, np.full(8, 5.0), np.random.default_rng(1))
    assert find_modes(series).reasons == ("all steps have the same frequency",)


def test_a_mode_beyond_the_band_is_not_reported(structure: ShearStructure) -> None:
    """Only the flank of the first mode, at 5.4 Hz, is in the data."""
    series = Instrument().measure(structure, np.linspace(2.0, 4.5, 12), np.random.default_rng(8))
    assert all(2.0 <= mode.frequency_hz <= 4.5 for mode in find_modes(series, most=3).modes)


def test_missing_targets_are_left_out(structure: ShearStructure) -> None:
    series = Instrument().measure(structure, BAND, np.random.default_rng(9))
    amplitude = series.amplitude.copy()
    amplitude[::3, 2] = np.nan
    amplitude[:, 5, 1] = np.nan
    found = find_modes(replace(series, amplitude=amplitude))
    natural, _ = structure.modes()
    assert [round(mode.frequency_hz, 2) for mode in found.modes] == [round(f, 2) for f in natural[:2]]


def test_amplitudes_at_rest_are_compared_in_their_squares(structure: ShearStructure) -> None:
    series = Instrument().measure(structure, BAND, np.random.default_rng(10))
    size = np.linalg.norm(series.amplitude, axis=2)
    resting = replace(series, at_rest=size < 0.5)
    assert resting.resting().any()
    found = find_modes(resting)
    natural, _ = structure.modes()
    for mode, true_hz in zip(found.modes, natural, strict=False):
        assert abs(mode.frequency_hz - true_hz) < 4 * mode.sd_frequency_hz


@pytest.mark.parametrize(
    ("frequency", "damping", "text"),
    [(30.0, 0.01, "outside the band"), (5.4, 0.5, "damping ratio"), (5.4, 1e-7, "damping ratio")],
)
def test_absurd_poles_are_named(swept: ModeSearch, frequency: float, damping: float, text: str) -> None:
    assert swept.fit is not None
    parameters = replace(swept.fit.parameters, log_frequency=np.log([frequency] * 2), log_damping=np.log([damping] * 2))
    assert text in unusable_pole(replace(swept.fit, parameters=parameters), 0, (4.0, 18.0))


def test_undetermined_poles_are_named(swept: ModeSearch) -> None:
    assert swept.fit is not None
    loose = replace(
        swept.fit, covariance=replace(swept.fit.covariance, shared=np.eye(len(swept.fit.covariance.shared)))
    )
    assert "not determined" in unusable_pole(loose, 0, (4.0, 18.0))
