from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import PhaseReference, ResponseSeries
from labdaemon.findings.transmissibility import transmissibility_of

FREQUENCY = np.array([8.0, 5.3, 12.0])


def series(structure: ShearStructure, seed: int = 1, phase: PhaseReference = PhaseReference.TARGET) -> ResponseSeries:
    measured = Instrument(phase=phase).measure(structure, FREQUENCY, np.random.default_rng(seed))
    return replace(measured, targets=tuple(f"T{i}" for i in range(8)))


@pytest.mark.parametrize("phase", list(PhaseReference))
def test_it_is_the_size_of_the_frequency_response(structure: ShearStructure, phase: PhaseReference) -> None:
    found = transmissibility_of(series(structure, phase=phase))
    assert found.frequency_hz.tolist() == [5.3, 8.0, 12.0]
    expected = np.abs(structure.response(found.frequency_hz)[:, :, 0])
    assert np.all(np.abs(found.value - expected) < 5 * found.sd)
    assert np.all(found.sd < 0.02 * expected + 0.02)


def test_its_sd_is_that_of_repeated_sweeps(structure: ShearStructure) -> None:
    draws = [transmissibility_of(series(structure, seed)) for seed in range(120)]
    spread = np.std([one.value for one in draws], axis=0)
    assert np.sqrt(np.mean((spread / draws[0].sd) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert draws[0].sd_common == pytest.approx([0.002] * 3)


def test_an_orbit_has_the_size_of_its_major_axis(structure: ShearStructure) -> None:
    """A circle of 3 mm that one vector does not show: a = (3, 0, 0), b = (0, 3, 0)."""
    one = series(structure)
    circle = replace(one, amplitude=np.broadcast_to(np.array([3.0, 3.0j, 0.0]), one.amplitude.shape).copy())
    expected = (3.0 / one.table_mm[[1, 0, 2]])[:, None] * np.ones((1, 8))
    assert transmissibility_of(circle).value == pytest.approx(expected)


def test_what_is_not_known_has_no_number(structure: ShearStructure) -> None:
    one = series(structure)
    amplitude, sd_table = one.amplitude.copy(), one.sd_table.copy()
    amplitude[0, 2] = np.nan
    amplitude[:, 3, 1] = np.nan  # one camera: a direction that it does not see
    sd_table[2] = 1.0
    found = transmissibility_of(replace(one, amplitude=amplitude, sd_table=sd_table))
    assert np.isnan(found.value[1, 2])
    assert np.isfinite(found.value[:2, 3]).all()
    assert np.isnan(found.value[2]).all()
    content = found.to_json()
    assert content["targets"]["T2"]["value"][1] is None
    assert content["sd_common"][2] is None


def test_the_peak_is_named(structure: ShearStructure) -> None:
    found = transmissibility_of(series(structure))
    peak = found.peak()
    assert peak is not None
    assert (peak[0], peak[1]) == (found.targets[int(np.argmax(found.value[0]))], 5.3)
    assert transmissibility_of(replace(series(structure), sd_table=np.ones(3))).peak() is None
