"""The flag `light_mismatch`: said of all targets of a frame, by all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labdaemon.blur import ExposureWindow, LightCode, Measurement
from labdaemon.blur.motion import AmbientEstimate, LightScore, empty_measurement
from labdaemon.flags import Flag
from labdaemon.processing.common_light import check_common_light
from labdaemon.processing.frame import FrameResult
from labdaemon.processing.lamp_light import apply_lamp_light, describe_ambient, describe_light, measure_under_code

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


WINDOW = ExposureWindow(5.0, 1.0, light=LightCode((1.0, 0.0, 1.0), ambient=0.05, sd_ambient=0.003))


def through(
    windows: Sequence[ExposureWindow], *, is_free_right: bool, correction: float, held: LightScore
) -> list[Measurement]:
    """Two targets whose images show another ambient light, and fit once that is free."""
    light = windows[0].light
    assert light is not None
    is_free = light.sd_ambient > 0.1
    prior = light.sd_ambient**2
    variance = 1 / (1 / prior + 1 / 0.005**2)
    ambient = AmbientEstimate(correction * variance / 0.005**2, variance, np.zeros(6), prior)
    score = RIGHT if is_free and is_free_right else held
    return [replace(measured(name, score), ambient=ambient) for name in "ab"]


@pytest.mark.parametrize("held", [RIGHT, WRONG], ids=["seen in the estimate", "seen in the residuals"])
def test_ambient_light_that_was_stated_wrongly_is_replaced_by_what_the_images_show(held: LightScore) -> None:
    found = measure_under_code(partial(through, is_free_right=True, correction=0.45, held=held), [WINDOW])
    assert found.faults == [None]
    assert found.ambient is not None
    assert abs(found.ambient.correction - 0.45) < 1e-9
    assert not any(one.flags for one in found.measured)
    assert "0.500 of the lamp's, with a standard deviation of 0.004, where 0.05" in describe_ambient(
        WINDOW, found.ambient
    )


def test_right_ambient_light_stays_and_another_code_is_not_put_down_to_it() -> None:
    right = measure_under_code(partial(through, is_free_right=True, correction=0.01, held=RIGHT), [WINDOW])
    assert right.ambient is None
    for correction in (0.0, 0.45):
        wrong = measure_under_code(partial(through, is_free_right=False, correction=correction, held=WRONG), [WINDOW])
        assert wrong.ambient is None
        assert all(Flag.LIGHT_MISMATCH in one.flags for one in wrong.measured)


def test_cameras_together_see_what_none_sees_alone() -> None:
    faint = LightScore(550.0 * np.eye(3), 550.0 * np.array([0.12, -0.1, 0.0]), 80.0)
    frames = [FrameResult(camera, (measured("a", faint),), ()) for camera in ("left", "right")]
    assert not any(flagged([measured("a", faint)], 1))
    joined = check_common_light(frames)
    assert all(Flag.LIGHT_MISMATCH in one.flags for frame in joined for one in frame.measurements)
    assert [len(frame.notes) for frame in joined] == [1, 0]
    assert check_common_light(frames[:1]) == frames[:1]
