"""The amplifier: what comes of a voltage, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from labdrivers.sim.structure import DEFAULT_MODES
from labdrivers.sim.table import TableSpec, rest_before


def test_millimetres_per_volt_fall_with_frequency_as_the_calibration_says() -> None:
    spec = TableSpec()
    table = dict(spec.calibration())
    assert table[5.0] > table[8.0] > table[12.0]
    for frequency in (5.0, 8.0, 12.0):
        history = rest_before(DEFAULT_MODES).then(0.0, spec, frequency_hz=frequency, level_v=0.5, phase_rad=1.0)
        x = history.evaluate(5.0 + np.linspace(0.0, 1.0, 2000, endpoint=False))[0]
        assert np.ptp(x) / 2 == pytest.approx(0.5 * table[frequency], rel=1e-3)


@pytest.mark.parametrize(
    ("frequency_hz", "amplitude_mm", "word"),
    [(1.0, 76.0, "stroke"), (10.0, 20.0, "velocity"), (40.0, 3.5, "acceleration")],
)
def test_refuses_what_it_cannot_do(frequency_hz: float, amplitude_mm: float, word: str) -> None:
    refusal = TableSpec().refuses(frequency_hz, amplitude_mm)
    assert refusal is not None
    assert word in refusal
    assert TableSpec().refuses(5.0, 2.0) is None


def test_a_window_of_history_answers_as_the_whole() -> None:
    spec, history = TableSpec(), rest_before(DEFAULT_MODES)
    for k in range(40):
        history = history.then(0.1 * k, spec, frequency_hz=5.0, level_v=0.02 * k, phase_rad=np.pi * k)
    t = np.linspace(2.31, 2.94, 300)
    part = history.window(2.3, 3.0)
    assert len(part.intervals) < 10
    for whole, cut in zip(history.evaluate(t), part.evaluate(t), strict=True):
        np.testing.assert_allclose(cut, whole, atol=1e-12)


def test_commands_come_in_order() -> None:
    history = rest_before(DEFAULT_MODES).then(1.0, TableSpec(), frequency_hz=5.0, level_v=1.0, phase_rad=0.0)
    with pytest.raises(ValueError, match="before the last one"):
        history.then(0.5, TableSpec(), frequency_hz=5.0, level_v=1.0, phase_rad=0.0)


def test_harmonics_of_the_table_reach_the_structure_each_at_its_own_frequency() -> None:
    spec = TableSpec(harmonics=((3, 0.05, 0.4),))
    history = rest_before(DEFAULT_MODES).then(0.0, spec, frequency_hz=4.0, level_v=0.5, phase_rad=0.3)
    t = 40.0 + np.linspace(0.0, 1.0, 4000, endpoint=False)
    table, q = history.evaluate(t)

    def part(values: np.ndarray, order: int) -> complex:
        return complex(2j * np.mean(values * np.exp(-2j * np.pi * order * 4.0 * t)))

    first, third = part(table, 1), part(table, 3)
    assert abs(third) / abs(first) == pytest.approx(0.05, rel=1e-6)
    assert np.angle(third * np.conj(first) ** 3) == pytest.approx(0.4, abs=1e-6)
    # The third mode lies at 12.7 Hz: it amplifies the third harmonic of 4 Hz far more than the fundamental.
    assert abs(part(q[2], 3)) / abs(third) > 10 * abs(part(q[2], 1)) / abs(first)


def test_a_table_with_harmonics_starts_and_stops_smoothly() -> None:
    spec = TableSpec(harmonics=((2, 0.03, 0.0), (3, 0.05, 1.0)))
    history = rest_before(DEFAULT_MODES).then(0.0, spec, frequency_hz=5.0, level_v=0.5, phase_rad=0.0)
    history = history.then(3.0, spec, frequency_hz=5.0, level_v=0.0, phase_rad=0.0)
    t = np.linspace(0.0, 6.0, 60001)
    table = history.evaluate(t)[0]
    assert np.abs(np.diff(table)).max() < 0.02
    assert np.abs(table[t > 5.0]).max() < 1e-6
