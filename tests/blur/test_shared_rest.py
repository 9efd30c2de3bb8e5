"""Places of rest: twins and arcs of phase weighed by how far the targets of a frame drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import AlternativeMotion, Measurement, share_rest
from labdaemon.blur.phase.phase_arc import PhaseTable, phase_arc
from labdaemon.flags import Flag

NOISE = np.diag([1e-4, 1e-4, 4e-4, 4e-4, 4e-4, 4e-4])
V = np.array([0.6, 0.3])
SHIFT = 0.35
"""Mean of sin ωt over the window of a code, by which it shifts an image."""


def settled(count: int, rng: np.random.Generator, drift_px: float = 0.0) -> tuple[list[Measurement], list[np.ndarray]]:
    rest = [rng.uniform(100, 900, 2) for _ in range(count)]
    found = [
        Measurement(f"s{i}", at + rng.normal(0, np.hypot(0.01, drift_px), 2), V, -V, NOISE, True)
        for i, at in enumerate(rest)
    ]
    return found, rest


def twin(centre_px: np.ndarray, off_px: float, excess: float) -> Measurement:
    """A target whose twin is at rest, and is the true one; the better one by its image is not."""
    other = AlternativeMotion(centre_px, V, V, NOISE, excess)
    wrong = centre_px + np.array([off_px, 0.0])
    return Measurement("t", wrong, -V, V, NOISE, True, frozenset({Flag.AMBIGUOUS}), alternatives=(other,))


@pytest.mark.parametrize(
    ("count", "drift_px", "off_px", "decided"),
    [(8, 0.0, 0.3, True), (4, 0.0, 0.3, False), (8, 0.4, 0.3, False), (8, 0.0, 0.02, False)],
)
def test_a_twin_that_is_at_rest_wins_where_targets_do_not_drift(count, drift_px, off_px, decided: bool) -> None:
    found, rest = settled(count, np.random.default_rng(2), drift_px)
    place = np.array([500.0, 400.0])
    one = share_rest([*found, twin(place, off_px, 3.0)], np.array([*rest, place]))[-1]
    assert (not one.flags) == decided
    np.testing.assert_array_equal(one.b_px, V)
    np.testing.assert_array_equal(one.a_px, V if decided else -V)
    assert np.array_equal(one.centre_px, place) == decided  # no candidate's mean position is touched


def test_a_target_that_drifts_alone_keeps_what_its_image_says() -> None:
    found, rest = settled(8, np.random.default_rng(4))
    place = np.array([500.0, 400.0])
    one = share_rest([*found, twin(place + 0.5, 0.3, 20.0)], np.array([*rest, place]))[-1]
    np.testing.assert_array_equal(one.a_px, -V)
    assert one.alternatives[0].excess == pytest.approx(20.0, abs=0.1)


def test_an_arc_keeps_the_phases_that_leave_the_target_at_rest() -> None:
    found, rest = settled(8, np.random.default_rng(7))
    place, true = np.array([500.0, 400.0]), 0.8
    phases = np.linspace(0, 2 * np.pi, 257)[:-1]
    centres = place + SHIFT * np.outer(np.cos(true) - np.cos(phases), V)
    motions = np.column_stack((centres, np.outer(np.cos(phases), V), np.outer(np.sin(phases), V)))
    arc = phase_arc([PhaseTable(phases, np.zeros(256), motions, NOISE, 0.0, 0.01, (SHIFT, 0.0))])
    axes = Measurement("t", place, V, np.zeros(2), np.eye(6) * 1e-3)
    first = arc[0]
    unsure = Measurement("t", first.centre_px, first.a_px, first.b_px, np.eye(6) * 0.2, True, axes=axes, arc=arc)
    one = share_rest([*found, unsure], np.array([*rest, place]))[-1]
    best = np.arctan2(one.b_px @ V, one.a_px @ V)
    assert abs(abs(best) - true) < 0.25  # the shift is the cosine of the phase, so its sign stays open
    assert one.axes is not None
    assert np.linalg.norm(one.axes.centre_px - place) < 0.02
    np.testing.assert_allclose(one.axes.a_px, V, atol=0.02)
    assert float(np.sqrt(one.axes.covariance_px2[0, 0])) < 0.3 * SHIFT * V[0]
    opposite = [part for part in one.arc if part.a_px @ V < 0]
    assert all(part.excess > 9.0 for part in opposite if part.a_px @ V < -0.3 * V @ V)


def test_a_motion_without_a_rival_far_from_rest_is_ambiguous() -> None:
    found, rest = settled(8, np.random.default_rng(5))
    moved = [replace(found[2], centre_px=found[2].centre_px + np.array([x, 0.0])) for x in (0.3, 0.06)]
    far, near = (share_rest([*found[:2], one, *found[3:]], np.array(rest))[2] for one in moved)
    assert far.flags == {Flag.AMBIGUOUS}
    assert not near.flags


def test_others_stay_as_they_are() -> None:
    found, rest = settled(8, np.random.default_rng(9))
    found[3] = replace(found[3], flags=frozenset({Flag.POOR_FIT}))
    for before, after in zip(found, share_rest(found, np.array(rest)), strict=True):
        assert after is before
