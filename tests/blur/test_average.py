"""The mean of a target's measurements in several frames."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.average import average_measurements
from labdaemon.blur.motion import Measurement
from labdaemon.flags import Flag

TRUE = np.array([100.0, 50.0, 4.0, 1.0, -0.3, 1.2])


def measurement(values: np.ndarray, sd: float = 0.01, flags: Iterable[Flag] = ()) -> Measurement:
    return Measurement("T01", values[:2], values[2:4], values[4:], sd**2 * np.eye(6), flags=frozenset(flags))


def values_of(one: Measurement) -> np.ndarray:
    return np.concatenate((one.centre_px, one.a_px, one.b_px))


def test_the_mean_of_equal_weights_halves_the_variance() -> None:
    noise = np.random.default_rng(1).normal(0, 0.01, (4, 6))
    mean = average_measurements([measurement(TRUE + one) for one in noise])
    np.testing.assert_allclose(values_of(mean), TRUE + noise.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(np.diag(mean.covariance_px2), 0.01**2 / 4, rtol=0.05)
    assert mean.flags == frozenset()


def test_the_better_frame_counts_more() -> None:
    shift = np.full(6, 0.02)
    mean = average_measurements([measurement(TRUE, 0.01), measurement(TRUE + shift, 0.1)])
    assert np.all(np.abs(values_of(mean) - TRUE) < 0.05 * shift)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=5))
def test_an_axis_has_no_sign(turns: list[tuple[bool, bool]]) -> None:
    """Whole cycles show an orbit's axes, and an axis and its opposite are one."""
    turned = []
    for a, b in turns:
        one = TRUE.copy()
        one[2:4] *= -1 if a else 1
        one[4:] *= -1 if b else 1
        turned.append(measurement(one))
    mean = average_measurements(turned)
    assert abs(mean.a_px @ TRUE[2:4]) == pytest.approx(TRUE[2:4] @ TRUE[2:4], rel=1e-5)
    assert abs(mean.b_px @ TRUE[4:]) == pytest.approx(TRUE[4:] @ TRUE[4:], rel=1e-5)


def test_frames_that_differ_beyond_noise_are_flagged_and_widened() -> None:
    other = TRUE + np.array([0, 0, 0.5, 0, 0, 0])
    mean = average_measurements([measurement(TRUE), measurement(other), measurement(TRUE)])
    assert Flag.CONTRADICTS_GROUP in mean.flags
    assert np.sqrt(mean.covariance_px2[2, 2]) > 0.2


def test_rest_in_one_frame_is_no_rest_of_the_group() -> None:
    resting = measurement(TRUE, flags=[Flag.AT_REST, Flag.PAPER_EDGE])
    assert average_measurements([resting, measurement(TRUE)]).flags == {Flag.PAPER_EDGE}
    assert average_measurements([resting, resting]).flags == {Flag.AT_REST, Flag.PAPER_EDGE}


def test_frames_without_numbers_are_left_out() -> None:
    lost = Measurement("T01", *(np.full(2, np.nan),) * 3, np.full((6, 6), np.nan), flags=frozenset({Flag.NOT_FOUND}))
    mean = average_measurements([lost, measurement(TRUE)])
    np.testing.assert_allclose(values_of(mean), TRUE, atol=1e-6)
    assert Flag.NOT_FOUND not in mean.flags
    assert average_measurements([lost, lost]) is lost


def test_an_amplitude_is_the_major_semi_axis_and_its_deviation_first_order() -> None:
    one = measurement(np.array([0, 0, 3.0, 4.0, 0, 0.0]), sd=0.02)
    assert one.amplitude_px == pytest.approx(5.0)
    assert one.sd_px == pytest.approx(0.02)
    assert repr(one) == "<Measurement T01: 5.000 ± 0.020 px>"
    lost = Measurement("T02", *(np.full(2, np.nan),) * 3, np.full((6, 6), np.nan), flags=frozenset({Flag.NOT_FOUND}))
    assert np.isnan([lost.amplitude_px, lost.sd_px]).all()
