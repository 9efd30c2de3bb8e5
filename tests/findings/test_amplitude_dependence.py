from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModeSearch, PhaseReference, find_modes, refit
from labdaemon.findings.amplitude_dependence import compare_levels
from labdaemon.findings.transient import with_transients


def test_a_linear_structure_has_the_same_poles(swept: ModeSearch, structure: ShearStructure) -> None:
    assert swept.fit is not None
    frequency = swept.fit.problem.series.frequency_hz
    calls = 0
    for seed in range(8):
        high = refit(swept.fit, Instrument().measure(structure, frequency, np.random.default_rng([seed, 31]), 1.5))
        found = compare_levels(swept.fit, high)
        assert len(found.frequency_hz) == 2
        calls += found.is_dependent
    assert calls <= 2


def test_friction_shows_in_the_damping(swept: ModeSearch, structure: ShearStructure) -> None:
    assert swept.fit is not None
    frequency = swept.fit.problem.series.frequency_hz
    softer = replace(structure, damping=(0.016, 0.013, 0.01, 0.009))
    found = compare_levels(
        swept.fit, refit(swept.fit, Instrument().measure(softer, frequency, np.random.default_rng(2)))
    )
    assert found.is_dependent
    assert found.damping_change[0] == pytest.approx(np.log(0.016 / 0.012), rel=0.2)
    assert found.z_damping[0] > 5


def test_no_common_mode_is_no_dependence(swept: ModeSearch, structure: ShearStructure) -> None:
    assert swept.fit is not None
    far = swept.fit.parameters.log_frequency + 3.0
    other = replace(swept.fit, parameters=replace(swept.fit.parameters, log_frequency=far))
    found = compare_levels(swept.fit, other)
    assert not found.is_dependent
    assert found.frequency_hz == ()


def test_a_remaining_transient_is_a_term_of_the_model() -> None:
    """A change of 0.001 a cycle at ζ = 1 % leaves 1.6 %, which biases the frequency unless it is allowed for."""
    structure = ShearStructure(per_column=3, damping=(0.01, 0.01, 0.01, 0.01))
    natural = structure.modes()[0][0]
    frequency = np.concatenate([natural * (1 + 0.01 * np.array([-2, -1.3, -0.8, 0.8, 1.3, 2])), [4.0, 4.6, 6.4, 7.5]])
    instrument = Instrument(sd_table=0.0005, phase=PhaseReference.TARGET)
    series = instrument.measure(structure, frequency, np.random.default_rng(5))
    change = np.where((frequency > natural) & (frequency < 1.025 * natural), 0.001, 0.0)
    left = change / (2 * np.pi * 0.01)
    unsettled = replace(series, amplitude=series.amplitude * (1 - left)[:, None, None])
    settled = find_modes(series, band_hz=(4.0, 7.5), most=1).fit
    assert settled is not None
    naive, allowed = (refit(settled, one) for one in (unsettled, with_transients(unsettled, change, 0.01)))
    errors = [abs(float(one.parameters.log_frequency[0]) - np.log(natural)) for one in (naive, allowed)]
    assert errors[0] > max(1e-4, 3 * settled.sd_log_frequency[0]), "0.01 % and more"
    assert errors[1] < 3 * allowed.sd_log_frequency[0]
    assert allowed.sd_log_frequency[0] < 3e-4
