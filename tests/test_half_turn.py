"""Phases within half a turn."""

from __future__ import annotations

import numpy as np

from labdaemon.half_turn import major_phase_rad, within_half_turn


def test_half_a_turn_is_nothing() -> None:
    angles = np.linspace(-7.0, 7.0, 57)
    inside = within_half_turn(angles)
    assert np.all(np.abs(inside) <= np.pi / 2)
    np.testing.assert_allclose(np.sin(inside - angles), 0.0, atol=1e-12)


def test_an_orbits_phase_is_that_of_its_major_axis_whatever_its_sign() -> None:
    major, minor = np.array([1.0, -0.5, 0.2]), 0.2 * np.array([0.5, 1.0, 0.0])
    for phase in (-1.2, 0.3, 1.4):
        a, b = major * np.cos(phase) - minor * np.sin(phase), major * np.sin(phase) + minor * np.cos(phase)
        assert abs(within_half_turn(np.array(major_phase_rad(a, b) - phase))) < 1e-9
        assert abs(within_half_turn(np.array(major_phase_rad(-a, -b) - phase))) < 1e-9
