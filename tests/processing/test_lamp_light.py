"""The flag `light_mismatch`: said of all targets of a frame, by all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur import Measurement
from labdaemon.blur.motion import LightScore, empty_measurement
from labdaemon.flags import Flag
from labdaemon.processing.lamp_light import apply_lamp_light, describe_light

RIGHT = LightScore(1e4 * np.eye(3), 1e4 * np.array([0.004, 0.0, -0.003]), 80.0)
WRONG = LightScore(1e4 * np.eye(3), 1e4 * np.array([0.2, -0.2, 0.1]), 80.0)
UNWIRED = LightScore(np.eye(3), np.zeros(3), -9.0)


def measured(name: str, *scores: LightScore) -> Measurement:
    zero = np.ones(2)
    return Measurement(name, zero, zero, zero, np.eye(6), True, light_scores=scores)


def flagged(measured: list[Measurement], coded_frames: int) -> list[bool]:
    found, faults = apply_lamp_light(measured, coded_frames)
    assert len(faults) == coded_frames
    return [Flag.LIGHT_MISMATCH in one.flags for one in found]


def test_a_code_that_was_played_is_not_flagged() -> None:
    assert not any(flagged([measured("a", RIGHT), measured("b", RIGHT)], 1))


def test_all_measured_targets_are_flagged_together() -> None:
    lost = empty_measurement("lost", {Flag.NOT_FOUND})
    found = [measured("a", RIGHT), measured("b", WRONG), measured("at rest"), lost]
    assert flagged(found, 1) == [True, True, True, False]


def test_a_lamp_that_is_not_wired_shows_in_several_targets() -> None:
    assert not any(flagged([measured("a", UNWIRED), measured("b", RIGHT)], 1))
    assert all(flagged([measured("a", UNWIRED), measured("b", UNWIRED)], 1))


def test_one_wrong_capture_of_a_group_is_enough() -> None:
    assert all(flagged([measured("a", RIGHT, WRONG), measured("b", RIGHT, WRONG)], 2))
    # A target that was not found in one of the captures has no say.
    assert not any(flagged([measured("a", RIGHT, RIGHT), replace(measured("b", WRONG))], 2))


def test_the_light_is_described_frame_by_frame() -> None:
    _, faults = apply_lamp_light([measured("a", RIGHT, WRONG), measured("b", RIGHT, WRONG)], 2)
    assert faults[0] is None
    assert faults[1] is not None
    assert "by 17 % of the lamp's brightness" in describe_light(faults[1])
    _, faults = apply_lamp_light([measured("a", UNWIRED), measured("b", UNWIRED)], 1)
    assert faults[0] is not None
    assert describe_light(faults[0]).startswith("shows constant light, not the code")
