"""Coded light in a plan: exposures with room for whole cycles, predictions, notes, and every refusal by its key."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur import ExposureWindow, LightCode, nearest_twin
from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.light_plan import ImageScale
from labdaemon.campaign.limits import ShakerLimits
from labdaemon.campaign.plan import PlanRig, make_plan
from labdaemon.campaign.steps import Plan
from labdaemon.capture.exposure import choose_lit_exposure, third_stop_steps_s
from labdaemon.capture.lamp import Lamp
from labdaemon.errors import ConfigError, LimitError

LAMP = Lamp(rise_s=1e-4, ambient=0.05, levels=256)
RIG = PlanRig(
    ShakerLimits(150.0, 1000.0, 20000.0, (0.5, 50.0)), {"left": third_stop_steps_s()}, lamp=LAMP, scale=ImageScale(3.9)
)


def plan(light: str, rig: PlanRig = RIG, *, rest: str = "", frequency: str = "5.0", amplitude: str = "2.0") -> Plan:
    text = f'name = "t"\n[[phase]]\nkind = "sharp"\n[[phase]]\nkind = "steps"\nfrequency_hz = {frequency}\n'
    return make_plan(load_campaign(f"{text}amplitude_mm = {amplitude}\nlight = {light}\n{rest}"), rig)


def test_a_code_is_played_in_whole_cycles_inside_the_open_shutter() -> None:
    [_, step] = plan('"1110100"', rest="captures = 2\nlight_phase_rad = 0.5").steps
    assert not step.grouped
    assert len(step.shots) == 2
    [shot, same] = step.shots
    assert shot == same
    assert shot.light is not None
    assert shot.light.brightness == (1, 1, 1, 0, 1, 0, 0)
    assert shot.light.phase_rad == 0.5
    # 1.26 s has room for six cycles, nearly all of it; 1 s for four of five.
    assert shot.exposure_s == pytest.approx(2 ** (1 / 3))
    assert shot.light.cycles == 6
    known = step.precision
    assert known is not None
    assert known.amplitude_px == pytest.approx(7.8)
    assert 0.02 < math.degrees(known.sd_phase_rad) < 0.4
    assert known.sd_phase_rad < known.worst_sd_phase_rad
    assert known.twin_sd > 10


def test_a_pair_is_one_group_for_each_capture() -> None:
    made = plan('["cos", "sin"]', rest="captures = 2", amplitude="0.5")
    assert [step.grouped for step in made.steps] == [False, True, True]
    assert [len(step.shots) for step in made.steps] == [3, 2, 2]
    first, second = (shot.light for shot in made.steps[1].shots)
    assert first is not None
    assert second is not None
    assert first.brightness != second.brightness
    assert len(first.brightness) == 64
    assert not made.notes


@pytest.mark.parametrize("light", ["[1, 1, 1, 0, 1, 0, 0]", "[[1, 1, 1, 0, 1, 0, 0]]", '["1110100"]'])
def test_codes_may_be_brightnesses(light: str) -> None:
    assert plan(light).steps[1].shots == plan('"1110100"').steps[1].shots


def test_twice_the_same_code_is_a_group() -> None:
    assert plan('["1110100", "1110100"]').steps[1].grouped


@pytest.mark.parametrize(
    ("light", "words"),
    [
        ('"11010"', "twin"),
        ('"10"', "twin"),
        ('"cos"', "twin"),
        ('["cos", "cos"]', "twin"),
        ("[1.0, 0.6, 0.2, 0.6]", "twin"),
        ('"111"', "constant light"),
        ('"1110102"', "is no code"),
        ('"tan"', "is no code"),
        ('["cos", "sun"]', "is no code"),
    ],
)
def test_codes_that_cannot_show_the_phase_are_refused(light: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        plan(light)
    assert caught.value.key == "phase[1].light"


@pytest.mark.parametrize(
    ("light", "rest", "key"),
    [
        ("[1.0]", "", "light"),
        ("[0.0, 1.5]", "", "light"),
        ("[]", "", "light"),
        ('"1110100"', "phase_rad = [0.0]", ""),
        ('"1110100"', "expected_mm = 0.0", "expected_mm"),
    ],
)
def test_what_is_no_light_is_refused_where_it_stands(light: str, rest: str, key: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plan(light, rest=rest)
    assert (caught.value.key or "").startswith(f"phase[1].{key}".rstrip("."))


def test_keys_of_light_without_light_are_refused() -> None:
    text = 'name = "t"\n[[phase]]\nkind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0\nexpected_mm = 2.0\n'
    with pytest.raises(ConfigError, match="light is not given"):
        load_campaign(text)


def test_a_rig_without_lamp_and_a_lamp_that_only_switches() -> None:
    with pytest.raises(ConfigError, match=r"the rig has no \[lamp\]"):
        plan('"1110100"', replace(RIG, lamp=None))
    switch = replace(RIG, lamp=replace(LAMP, levels=2))
    assert plan('"1110100"', switch).steps
    with pytest.raises(ConfigError, match="only switches"):
        plan('["cos", "sin"]', switch)


def test_a_cycle_that_does_not_fit_is_refused() -> None:
    with pytest.raises(LimitError, match="no whole cycle of the code fits") as caught:
        plan('"1110100"', rest="exposure_s = 0.1")
    assert caught.value.key == "phase[1].exposure_s"
    with pytest.raises(ConfigError, match="rise time"):
        plan('"1110100"', replace(RIG, lamp=replace(LAMP, rise_s=0.05)))


def test_small_motion_is_advised_to_take_the_pair() -> None:
    [note] = plan('"1110100"', amplitude="0.3").notes
    assert "phase[1]" in note
    assert '["cos", "sin"]' in note
    assert not plan('"1110100"', amplitude="0.3", rest="expected_mm = 2.0").notes
    [note] = plan('"110100"', amplitude="0.8").notes
    assert "nearest twin" in note


def test_mains_flicker_near_a_harmonic_is_noted() -> None:
    flickering = replace(RIG, lamp=replace(LAMP, flicker_hz=100.0))
    [note] = plan('"1110100"', flickering, frequency="20.0", amplitude="1.0").notes
    assert "harmonic 5" in note
    assert not plan('"1110100"', flickering, frequency="22.0", amplitude="0.9").notes
    dark = replace(RIG, lamp=replace(LAMP, flicker_hz=100.0, ambient=0.0))
    assert not plan('"1110100"', dark, frequency="20.0", amplitude="1.0").notes
    short = "exposure_s = 0.08\nexpected_mm = 1.0"
    [note] = plan('"1110100"', flickering, frequency="42.0", amplitude="0.2", rest=short).notes
    assert "periods of the room's light" in note


def test_the_policy_of_twins_is_their_distance() -> None:
    """What the plan says of a code is what a search over all phases and amplitudes finds."""
    step = plan('"1110100"').steps[1]
    light = step.shots[0].light
    assert light is not None
    assert step.precision is not None
    code = LightCode(light.brightness, 0.0, light.cycles, LAMP.ambient, 2 * math.pi * 5.0 * LAMP.rise_s)
    window = ExposureWindow(5.0, step.shots[0].exposure_s, light=code)
    assert nearest_twin([window], step.precision.amplitude_px).distance_sd == pytest.approx(
        step.precision.twin_sd, rel=0.2
    )


@settings(max_examples=40, deadline=None)
@given(st.floats(0.02, 20.0), st.floats(1.0, 50.0), st.integers(2, 64))
def test_whatever_is_chosen_fits(nominal_s: float, frequency_hz: float, sectors: int) -> None:
    chosen = choose_lit_exposure(
        third_stop_steps_s(), nominal_s, lambda exposure_s: LAMP.cycles_within(exposure_s, frequency_hz, sectors)
    )
    if chosen is None:
        return
    exposure_s, cycles = chosen
    assert cycles >= 1
    assert (cycles + 1 / sectors) / frequency_hz <= exposure_s - LAMP.margin_s + 1e-6
    assert abs(math.log2(exposure_s / nominal_s)) < 0.8
