from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModeSearch, PhaseReference, joined, refit


def test_pulls_of_repeated_sweeps(swept: ModeSearch, structure: ShearStructure) -> None:
    """Errors of frequency, damping and residues over their stated sd, from new noise each time."""
    assert swept.fit is not None
    frequency = swept.fit.problem.series.frequency_hz
    natural, damping = structure.modes()[0][:2], np.array(structure.damping[:2])
    order = np.argsort(swept.fit.parameters.frequency_hz)
    poles, shapes = [], []
    for seed in range(15):
        series = Instrument().measure(structure, frequency, np.random.default_rng([seed, 7]))
        again = refit(swept.fit, series)
        poles += ((np.log(again.parameters.frequency_hz[order] / natural)) / again.sd_log_frequency[order]).tolist()
        poles += ((np.log(again.parameters.damping[order] / damping)) / again.sd_log_damping[order]).tolist()
        residues, covariance = again.residues(int(order[0]))
        along = np.arange(0, len(residues), 3)
        true = structure.residues()[:, 0, 0] * np.sign(again.parameters.coefficients[:, 0, 0].real)
        shapes += ((residues[along] - true) / np.sqrt(np.diag(covariance)[along])).tolist()
    assert 0.75 < np.sqrt(np.mean(np.square(poles))) < 1.3
    assert 0.75 < np.sqrt(np.mean(np.square(shapes))) < 1.6


def test_table_amplitude_is_the_limit(structure: ShearStructure, swept: ModeSearch) -> None:
    assert swept.fit is not None
    worse = replace(swept.fit.problem.series, sd_table=np.full(26, 0.02))
    assert np.all(refit(swept.fit, worse).sd_log_damping > swept.fit.sd_log_damping)


def test_larger_residuals_than_stated_enlarge_the_sd(structure: ShearStructure, swept: ModeSearch) -> None:
    assert swept.fit is not None
    series = swept.fit.problem.series
    small = replace(series, sd_real=series.sd_real / 3, sd_imag=series.sd_imag / 3)
    fitted = refit(swept.fit, small)
    assert fitted.noise_factor > 3
    assert np.all(fitted.sd_log_frequency > 0.8 * swept.fit.sd_log_frequency)


@pytest.mark.parametrize("phase", [PhaseReference.STEP, PhaseReference.TARGET])
def test_refit_takes_more_steps(structure: ShearStructure, phase: PhaseReference) -> None:
    from labdaemon.findings import find_modes

    instrument, rng = Instrument(phase=phase), np.random.default_rng(11)
    first = find_modes(instrument.measure(structure, np.geomspace(4.0, 18.0, 22), rng), is_real=True)
    assert first.fit is not None
    more = instrument.measure(structure, np.array([5.3, 5.5]), rng)
    again = refit(first.fit, joined(first.fit.problem.series, more))
    assert again.converged
    assert 0.75 < again.noise_factor < 1.3
    assert np.all(again.sd_log_damping <= first.fit.sd_log_damping * 1.01)
