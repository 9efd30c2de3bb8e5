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
