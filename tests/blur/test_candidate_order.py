"""A measurement led by the most likely of its candidates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur import AlternativeMotion, Measurement
from labdaemon.blur.candidate_order import led_by_best, own_motion
from labdaemon.flags import Flag

ONE = Measurement("t", np.zeros(2), np.array([1.0, 0.0]), np.zeros(2), np.eye(6) * 1e-4, True)


def other(excess: float, size: float = 2.0) -> AlternativeMotion:
    return AlternativeMotion(np.ones(2), np.zeros(2), np.array([size, 0.0]), np.eye(6) * 4e-4, excess)


def test_the_best_leads_and_the_others_count_from_it() -> None:
    led = led_by_best(ONE, [replace(own_motion(ONE), excess=5.0), other(1.0), other(60.0)])
    np.testing.assert_array_equal(led.b_px, [2.0, 0.0])
    np.testing.assert_array_equal(led.covariance_px2, np.eye(6) * 4e-4)
    assert [one.excess for one in led.alternatives] == [4.0]  # what is out of the question is not kept
    assert led.flags == {Flag.AMBIGUOUS}


def test_the_flag_follows_the_excess() -> None:
    doubted = replace(ONE, flags=frozenset({Flag.AMBIGUOUS, Flag.SATURATED}))
    assert led_by_best(doubted, [own_motion(ONE), other(12.0)]).flags == {Flag.SATURATED}
    at_rest = replace(ONE, flags=frozenset({Flag.AT_REST}))
    assert led_by_best(at_rest, [own_motion(ONE), other(2.0)]).flags == {Flag.AT_REST}
