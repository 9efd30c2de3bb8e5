"""The flag `light_mismatch`: said of all targets of a frame, by all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur import Measurement
from labdaemon.blur.motion import LightScore, empty_measurement
from labdaemon.flags import Flag
from labdaemon.processing.lamp_light import flag_light_mismatch

RIGHT = LightScore(1e4 * np.eye(3), 1e4 * np.array([0.004, 0.0, -0.003]), 80.0)
WRONG = LightScore(1e4 * np.eye(3), 1e4 * np.array([0.2, -0.2, 0.1]), 80.0)
UNWIRED = LightScore(np.eye(3), np.zeros(3), -9.0)


def measured(name: str, *scores: LightScore) -> Measurement:
    zero = np.ones(2)
    return Measurement(name, zero, zero, zero, np.eye(6), True, light_scores=scores)


def flagged(found: list[Measurement]) -> list[bool]:
    return [Flag.LIGHT_MISMATCH in one.flags for one in found]


def test_a_code_that_was_played_is_not_flagged() -> None:
    assert not any(flagged(flag_light_mismatch([measured("a", RIGHT), measured("b", RIGHT)], 1)))


def test_all_measured_targets_are_flagged_together() -> None:
    lost = empty_measurement("lost", {Flag.NOT_FOUND})
    found = flag_light_mismatch([measured("a", RIGHT), measured("b", WRONG), measured("at rest"), lost], 1)
    assert flagged(found) == [True, True, True, False]


def test_a_lamp_that_is_not_wired_shows_in_several_targets() -> None:
    assert not any(flagged(flag_light_mismatch([measured("a", UNWIRED), measured("b", RIGHT)], 1)))
    assert all(flagged(flag_light_mismatch([measured("a", UNWIRED), measured("b", UNWIRED)], 1)))


def test_one_wrong_capture_of_a_group_is_enough() -> None:
    found = flag_light_mismatch([measured("a", RIGHT, WRONG), measured("b", RIGHT, WRONG)], 2)
    assert all(flagged(found))
    # A target that was not found in one of the captures has no say.
    assert not any(flagged(flag_light_mismatch([measured("a", RIGHT, RIGHT), replace(measured("b", WRONG))], 2)))
