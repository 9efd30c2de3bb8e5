"""Matching reports with the truth, and the errors that come of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.bench.pairs import MotionComparison, axes, pair_up, sign_is_right

vectors = st.lists(st.floats(-5, 5), min_size=3, max_size=3).map(np.array)


def a_truth(capture: str = "c1", x: float = 0.0, **more: float) -> dict[str, object]:
    row: dict[str, object] = {"capture": capture, "target": "T", "x_mm": x, "y_mm": 0.0, "z_mm": 300.0}
    row |= {"ax": 1.0, "ay": 0.0, "az": 0.0, "bx": 0.0, "by": 0.0, "bz": 0.0, "diameter_mm": 8.0}
    return row | more


def a_report(
    capture: str = "c1", x: float = 0.1, a: float | None = 1.004, flags: tuple[str, ...] = ()
) -> dict[str, object]:
    row: dict[str, object] = {"capture": capture, "target": "A1", "x_mm": x, "y_mm": 0.0, "z_mm": 300.2}
    row |= {"ax_mm": a, "ay_mm": 0.0, "az_mm": 0.0, "bx_mm": 0.0, "by_mm": None, "bz_mm": 0.0}
    row |= {"sd_ax_mm": 0.003, "sd_ay_mm": None, "sd_az_mm": 0.002, "flags": list(flags)}
    if a is None:
        row |= {"ay_mm": None, "az_mm": None}
    return row


@settings(max_examples=50, deadline=None, derandomize=True)
@given(a=vectors, b=vectors, turn=st.floats(0, 6.3))
def test_axes_belong_to_the_orbit_whatever_its_phase(a: np.ndarray, b: np.ndarray, turn: float) -> None:
    turned = math.cos(turn) * a + math.sin(turn) * b, math.cos(turn) * b - math.sin(turn) * a
    for one, other in (axes(a, b), axes(*turned)):
        assert abs(float(one @ other)) < 1e-7 * (1.0 + float(one @ one))
        np.testing.assert_allclose(
            np.outer(one, one) + np.outer(other, other), np.outer(a, a) + np.outer(b, b), atol=1e-9
        )
        assert one @ one >= other @ other


def test_each_target_meets_the_nearest_report_of_its_own_capture() -> None:
    truth = [a_truth(), a_truth(x=60.0), a_truth("c2")]
    rows = [a_report(x=60.2, a=0.5), a_report(), a_report("c3")]
    near, other, missing = pair_up(truth, rows)
    assert near.error_mm == pytest.approx(0.004)
    assert near.sd_mm == pytest.approx(0.003)
    assert near.pulls == pytest.approx((0.004 / 0.003, 0.0))
    assert near.direction_error_deg == pytest.approx(0.0)
    assert other.error_mm == pytest.approx(-0.5)
    assert not missing.compared
    assert missing.pulls == ()
    assert missing.flags == {"not_found"}


def test_flags_that_take_a_number_back_keep_it_out() -> None:
    kept, dropped, empty = (
        pair_up([a_truth()], [row])[0]
        for row in (a_report(flags=("at_rest",)), a_report(flags=("occluded",)), a_report(a=None, flags=("saturated",)))
    )
    assert kept.compared
    assert not dropped.compared
    assert not empty.compared
    assert math.isnan(empty.sd_mm)


def test_phase_error_is_the_turn_of_the_phasor() -> None:
    a, b = np.array([1.0, 0.5, 0.0]), np.array([0.0, 0.2, -0.3])
    turn = math.radians(7.0)
    phasor = (a + 1j * b) * np.exp(1j * turn)
    pair = MotionComparison(8.0, a, b, phasor.real, phasor.imag, 0.01, frozenset())
    assert pair.phase_error_deg == pytest.approx(7.0)
    assert pair.error_mm == pytest.approx(0.0, abs=1e-12)
    assert pair.minor_error_mm == pytest.approx(0.0, abs=1e-12)


def test_a_sign_is_the_side_at_the_middle_of_the_exposure() -> None:
    """After 5.5 cycles the middle is 2.75 on: sine −1, cosine 0."""
    truth = a_truth(bx=0.3)
    right, wrong, none = (pair_up([truth], [a_report() | {"sign": sign}])[0] for sign in (-1, 1, None))
    assert sign_is_right(right, 5.5)
    assert not sign_is_right(wrong, 5.5)
    assert none.sign == 0
