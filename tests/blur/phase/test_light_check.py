"""The lamp's code checked by all targets of a frame: played, another code, and a lamp that is not wired."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.blur import (
    Defocus,
    Dot,
    ExposureWindow,
    InitialGuess,
    LightCode,
    find_light_fault,
    fit_sharp,
    measure_group,
    named_code,
)
from labdaemon.blur.motion import LightScore
from labdaemon.flags import Flag

SEVEN = named_code("1110100")
RADIUS, SIZE = 10.0, 55
MOTIONS = [np.array([2.6, 1.5, 1.2, 0.7]), np.array([-1.2, 2.2, 1.7, -3.1])]


@pytest.fixture(scope="module")
def sharp(area):
    scene = area.Scene(radius_px=RADIUS)
    frame = area.render(scene, (SIZE, SIZE), (27.2, 26.7), seed=1)
    return fit_sharp(Dot(27, 27, RADIUS, RADIUS, 0.0, name="t", paper_px=200), [frame], noise=scene.noise)


FLICKER = tuple(np.repeat(SEVEN, 40) + 0.4 * (1 + np.cos(4 * (np.arange(280) + 0.5) / 280 * 2 * np.pi + 0.5)))
"""The code, and room light at 40 % that flickers at the fourth harmonic of the excitation: 100 Hz at 25 Hz."""


def scores(area, sharp, played: tuple[float, ...], ambient: float = 0.0) -> list[LightScore]:
    """What two targets say of the code 1110100 when another one was played."""
    theta = (np.arange(4000) + 0.5) / 4000 * 2 * np.pi
    light = np.asarray(played)[(theta / (2 * np.pi) * len(played)).astype(int)]
    share = np.concatenate(([0.0], np.cumsum(light) / light.sum()))
    window = ExposureWindow(5.0, 1.0, light=LightCode(SEVEN, 0.0, 5, ambient, sd_ambient=0.02))
    found = []
    for seed, (ax, ay, bx, by) in enumerate(MOTIONS):

        def path(t, ax=ax, ay=ay, bx=bx, by=by):
            angle = np.interp(t, share, np.linspace(0, 2 * np.pi, 4001))
            return ax * np.sin(angle) + bx * np.cos(angle), ay * np.sin(angle) + by * np.cos(angle)

        frame = area.render(area.Scene(radius_px=RADIUS), (SIZE, SIZE), (27.0, 27.0), path, seed=50 + seed, samples=250)
        guess = [InitialGuess(np.array([27.0, 27.0]))]
        one = measure_group(sharp, [frame], [window], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
        assert len(one.light_scores) == 1
        found.append(one.light_scores[0])
    return found


def test_the_code_that_was_stated_is_believed(area, sharp) -> None:
    assert find_light_fault(scores(area, sharp, SEVEN)) is None


@pytest.mark.parametrize(
    ("played", "ambient", "is_constant"),
    [((1.0, 1.0), 0.0, True), (named_code("1101000"), 0.0, False), (FLICKER, 0.4, False)],
    ids=["not wired", "another code", "flicker"],
)
def test_light_that_was_not_stated_is_seen_for_what_it_is(area, sharp, played, ambient, is_constant) -> None:
    fault = find_light_fault(scores(area, sharp, played, ambient))
    assert fault is not None
    assert fault.is_constant is is_constant


def test_a_correction_counts_when_it_is_certain_and_changes_the_motions() -> None:
    information = np.diag([1e6, 1e6, 1.0])
    assert find_light_fault([LightScore(information, information @ [0.2, 0.0, 0.0])]) is not None
    for response, is_fault in [(500.0, True), (50.0, False)]:  # 1.5 and 0.15 sd
        effect = response * np.eye(4, 3)
        small = LightScore(information, information @ [0.006, 0.0, 0.0], response_sd=effect)
        assert (find_light_fault([small] * 4) is not None) is is_fault
    assert find_light_fault([LightScore(information, information @ [0.002, 0.0, 0.0])]) is None  # noise
    assert find_light_fault([LightScore(information, information @ [0.0, 0.0, 0.9])]) is None  # large, and not seen
    assert find_light_fault([]) is None


def test_targets_add_up() -> None:
    """What one target does not show, many do."""
    information = np.diag([500.0, 500.0, 1.0])
    one = LightScore(information, information @ [0.1, 0.0, 0.0])
    assert find_light_fault([one]) is None
    assert find_light_fault([one] * 10) is not None


def test_single_targets_with_a_wrong_fit_do_not_speak_for_all() -> None:
    right = LightScore(1e4 * np.eye(3), 1e4 * np.array([0.004, 0.0, -0.003]), 80.0)
    wrong = LightScore(1e4 * np.eye(3), 1e4 * np.array([0.9, -0.9, 0.4]), -5e3)
    assert find_light_fault([right] * 7 + [wrong]) is None
    assert find_light_fault([right] * 3 + [wrong] * 5) is not None
    resting = LightScore(1e-3 * np.eye(3), np.zeros(3), -0.2)
    assert find_light_fault([resting] * 20 + [wrong] * 4) is not None


def test_targets_near_rest_are_measured_under_coded_light(area, sharp) -> None:
    """The phase does not show there, and the last step of the fit has no bound: it must not leave the model's paths."""
    window = ExposureWindow(5.0, 1.0, light=LightCode(SEVEN, 0.0, 5, sd_ambient=0.02))
    for seed, (ax, ay) in enumerate([(0.0, 0.0), (0.1, -0.05)]):

        def path(t, ax=ax, ay=ay):
            return ax * np.sin(2 * np.pi * t), ay * np.sin(2 * np.pi * t)

        noise = 90 + 2 * seed
        frame = area.render(area.Scene(radius_px=RADIUS), (SIZE, SIZE), (27.0, 27.0), path, seed=noise, samples=20)
        guess = [InitialGuess(np.array([27.0, 27.0]))]
        one = measure_group(sharp, [frame], [window], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
        assert one.flags == {Flag.AT_REST}
        assert one.amplitude_px < 1.0
        assert np.isfinite(one.covariance_px2).all()
