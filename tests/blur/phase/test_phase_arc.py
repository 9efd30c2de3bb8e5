"""An arc of phases as a row of motions: it has the circle's moments, and gives way to a minor axis."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.phase.phase_arc import PhaseTable, across_path, mixture_moments, phase_arc

V = np.array([0.8, -0.3])
HELD = np.diag([1e-4, 1e-4, 9e-4, 9e-4, 0.0, 0.0])
PHASES = np.linspace(0.0, 2 * np.pi, 257)[:-1]


def circle(excess: np.ndarray) -> PhaseTable:
    motions = np.column_stack((np.zeros((256, 2)), np.outer(np.cos(PHASES), V), np.outer(np.sin(PHASES), V)))
    return PhaseTable(PHASES, excess, motions, HELD, 0.0)


def test_a_phase_that_does_not_show_leaves_the_whole_circle() -> None:
    arc = phase_arc([circle(np.zeros(256))])
    covariance, axis, axis_covariance = mixture_moments(arc, np.zeros(6))
    expected = np.kron(np.eye(2), np.outer(V, V) / 2 + np.eye(2) * 9e-4 / 2)
    np.testing.assert_allclose(covariance[2:, 2:], expected, atol=0.01)
    np.testing.assert_allclose(np.abs(axis[2:]), np.abs(V), atol=1e-6)
    np.testing.assert_allclose(axis_covariance[2:, 2:], np.eye(2) * 9e-4, atol=1e-6)


def test_an_arc_is_as_wide_as_its_phase() -> None:
    sd = 0.3
    arc = phase_arc([circle(((PHASES - np.pi) / sd) ** 2)])
    about = np.concatenate((np.zeros(2), -V, np.zeros(2)))
    covariance, _, _ = mixture_moments(arc, about)
    assert abs(np.sqrt(covariance[4, 4]) / V[0] - sd) < 0.04
    assert arc[0].excess == 0.0
    assert [one.excess for one in arc] == sorted(one.excess for one in arc)


def test_a_minor_axis_moves_the_mean_position_against_its_shift() -> None:
    sine, cosine = 0.3, -0.1
    for phase in (0.2, 1.9):
        across = across_path(V, phase, (sine, cosine))
        a, b = across[2:4], across[4:]
        assert abs(a @ V) + abs(b @ V) < 1e-12
        assert np.isclose(a @ a + b @ b, 1.0)
        np.testing.assert_allclose(across[:2], -(sine * a + cosine * b))
        n = a / -np.sin(phase)
        np.testing.assert_allclose(b, np.cos(phase) * n)  # a quarter of a cycle later than the path
