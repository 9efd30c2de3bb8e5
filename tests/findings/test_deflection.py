"""The paper's own comparison: envelopes at 5, 8 and 12 Hz before and after each modification of the frame."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.findings import PhaseReference, ResponseSeries
from labdaemon.findings.deflection import common_steps, compare_deflections
from labdrivers.sim.modification import MODIFICATIONS, modified_modes
from labdrivers.sim.spec import frame_targets
from labdrivers.sim.structure import particular

FREQUENCY, TABLE = np.array([5.0, 8.0, 12.0]), np.array([2.0, 1.0, 0.5])
TARGETS = frame_targets()


def envelopes(name: str, seed: int, sd: float = 0.005, scale: float = 1.0) -> ResponseSeries:
    """Steady motion of the simulated frame's targets, with noise, as whole cycles show it."""
    points = np.array([target.centre_mm for target in TARGETS])
    amplitude = np.zeros((3, len(points), 3), complex)
    for step, (frequency, table) in enumerate(zip(FREQUENCY, TABLE, strict=True)):
        amplitude[step, :, 0] = table
        for mode in modified_modes(MODIFICATIONS[name]):
            amplitude[step] += mode.shape(points) * particular(mode, 2j * np.pi * frequency, complex(table))
    noise = np.random.default_rng(seed).normal(size=(2, *amplitude.shape)) * sd
    amplitude = scale * amplitude + noise[0] + 1j * noise[1]
    amplitude *= np.exp(-0.5j * np.angle(np.sum(amplitude**2, axis=2, keepdims=True)))
    sds = np.full(amplitude.shape, sd)
    names = tuple(target.name for target in TARGETS)
    return ResponseSeries(FREQUENCY, amplitude, sds, sds, TABLE, np.full(3, 0.002), PhaseReference.TARGET, None, names)


@pytest.mark.parametrize("name", ["mass", "thinned", "thinned-only"])
def test_each_modification_changes_the_envelopes(name: str) -> None:
    found = compare_deflections(envelopes("none", 1), envelopes(name, 2))
    assert found is not None
    assert found.changed
    assert abs(found.differences[0].z) > 6
    assert len(found.macs) == 3


def test_the_same_frame_twice() -> None:
    calls = [compare_deflections(envelopes("none", 2 * k), envelopes("none", 2 * k + 1)) for k in range(10)]
    assert sum(one.changed for one in calls if one is not None) <= 2


def test_another_amplitude_is_a_scale() -> None:
    found = compare_deflections(envelopes("none", 1), envelopes("none", 2, scale=1.3))
    assert found is not None
    assert not found.changed
    assert [factor for _, factor, _ in found.scales] == pytest.approx([1.3] * 3, abs=0.03)


def test_steps_are_paired_once() -> None:
    one = envelopes("none", 1)
    assert common_steps(one, one) == [(0, 0), (1, 1), (2, 2)]
    assert common_steps(one, one.subset(np.array([1]))) == [(1, 0)]


def test_no_common_frequency() -> None:
    one = envelopes("none", 1)
    assert compare_deflections(one.subset(np.array([0])), one.subset(np.array([2]))) is None
