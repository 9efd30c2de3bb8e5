"""Closed-form response against numerical integration of the same equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labdrivers.sim.structure import DEFAULT_MODES, HEIGHT_MM, VibrationMode
from labdrivers.sim.table import TableSpec, rest_before

COMMANDS = ((0.3, 5.0, 0.5), (1.1, 5.0, 0.9), (2.05, 8.3, 0.4), (3.0, 8.3, 0.0))


def a_history():  # type: ignore[no-untyped-def]
    spec, history, phase = TableSpec(), rest_before(DEFAULT_MODES), 0.2
    for start, frequency, level in COMMANDS:
        last = history.at(start)
        now = phase if last is None else float(last.phase(start))
        history = history.then(start, spec, frequency_hz=frequency, level_v=level, phase_rad=now)
    return history


def test_modes_follow_their_equation_through_changes_of_command() -> None:
    history = a_history()
    t = np.arange(0.0, 4.5, 1.0 / 4000.0)
    table, q = history.evaluate(t)
    assert np.abs(np.diff(table)).max() < 0.1, "the table never jumps"
    for mode, closed in zip(DEFAULT_MODES, q, strict=True):
        omega, zeta = 2 * np.pi * mode.frequency_hz, mode.damping_ratio

        # in p = q + x the table's own jumps of velocity drop out: p'' = -2 zeta omega q' - omega² q
        def rate(now: float, state, omega=omega, zeta=zeta):  # type: ignore[no-untyped-def]
            x = np.interp(now, t, table)
            dx = np.interp(now, t[:-1] + 0.5 / 4000.0, np.diff(table) * 4000.0)
            absolute, velocity = state
            return [velocity, -2 * zeta * omega * (velocity - dx) - omega**2 * (absolute - x)]

        solved = solve_ivp(rate, (0.0, 4.4), [0.0, 0.0], t_eval=t[:17_600:40], max_step=1e-3, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(solved.y[0] - table[:17_600:40], closed[:17_600:40], atol=4e-3)


def test_steady_response_has_the_textbook_magnification() -> None:
    mode, spec = VibrationMode(8.0, 0.02, 1, (1.0, 0.0)), TableSpec()
    history = rest_before((mode,)).then(0.0, spec, frequency_hz=7.0, level_v=1.0, phase_rad=0.0)
    t = 60.0 + np.linspace(0.0, 1.0, 700, endpoint=False)
    table, q = history.evaluate(t)
    r = 7.0 / 8.0
    gain = r**2 / np.hypot(1 - r**2, 2 * 0.02 * r)
    assert np.ptp(q[0]) / np.ptp(table) == pytest.approx(gain, rel=1e-3)


def test_ring_down_takes_as_long_as_damping_says() -> None:
    mode, spec = VibrationMode(5.0, 0.01, 1, (1.0, 0.0)), TableSpec()
    history = rest_before((mode,)).then(0.0, spec, frequency_hz=5.0, level_v=1.0, phase_rad=0.0)
    history = history.then(60.0, spec, frequency_hz=5.0, level_v=0.0, phase_rad=0.0)
    after = np.log(1000.0) / (0.01 * 2 * np.pi * 5.0)
    early = np.ptp(history.evaluate(61.0 + np.linspace(0, 0.2, 100))[1])
    late = np.ptp(history.evaluate(61.0 + after + np.linspace(0, 0.2, 100))[1])
    assert late / early == pytest.approx(1e-3, rel=0.02)


def test_shapes_start_at_the_table_and_torsion_turns_the_top() -> None:
    mode = VibrationMode(8.0, 0.01, 1, (0.0, 0.0), 1e-3)
    top = mode.shape(np.array([[150.0, -100.0, HEIGHT_MM], [-150.0, 100.0, HEIGHT_MM], [150.0, -100.0, 0.0]]))
    np.testing.assert_allclose(top, [[0.1, 0.15, 0.0], [-0.1, -0.15, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)
