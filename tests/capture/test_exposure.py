"""Exposure steps: names against true times, and the choice of one."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.capture.exposure import (
    WINDOW_STOPS,
    choose_exposure,
    common_steps_s,
    part_cycle,
    third_stop_steps_s,
    true_steps_s,
)

D80_NAMES_S = (
    [1 / n for n in (4000, 3200, 2500, 2000, 1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200, 160, 125, 100, 80)]
    + [1 / n for n in (60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3, 2.5, 2, 1.6, 1.3)]
    + [1, 1.3, 1.6, 2, 2.5, 3, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30]
)


def test_names_in_thirds_are_powers_of_the_cube_root_of_two() -> None:
    true_s = true_steps_s(D80_NAMES_S)
    assert true_s == pytest.approx([2 ** (k / 3) for k in range(-36, 16)], rel=1e-12)


def test_names_in_half_stops_are_powers_of_the_root_of_two() -> None:
    names = [1 / 90, 1 / 60, 1 / 45, 1 / 30, 1 / 2, 1 / 1.5, 1, 1.5, 2, 3, 4]
    assert true_steps_s(names) == pytest.approx([2 ** (k / 2) for k in (-13, -12, -11, -10, -2, -1, 0, 1, 2, 3, 4)])


def test_names_rounded_to_a_tenth_of_a_millisecond_are_still_names() -> None:
    assert true_steps_s([0.0005, 0.0008, 0.3333, 0.7692, 1.3]) == pytest.approx(
        [2 ** (-33 / 3), 2 ** (-31 / 3), 2 ** (-5 / 3), 2 ** (-1 / 3), 2 ** (1 / 3)]
    )


def test_a_figure_that_is_no_name_is_kept() -> None:
    assert true_steps_s([0.11, 0.9, 45.0]) == (0.11, 0.9, 45.0)


def test_cameras_share_only_what_all_offer() -> None:
    assert common_steps_s([(0.5, 1.0, 2.0), (1.004, 2.0, 4.0)]) == (1.0, 2.0)
    assert common_steps_s([(0.5,), (1.0,)]) == ()
    assert common_steps_s([]) == ()


@pytest.mark.parametrize(
    ("frequency_hz", "exposure_s", "cycles"),
    [(5.0, 1.0, 5.0), (8.0, 1.0, 8.0), (12.0, 1.0, 12.0), (2.0, 1.0, 2.0), (7.94, 2 ** (1 / 3), 10.004)],
)
def test_the_step_nearest_to_whole_cycles_is_taken(frequency_hz: float, exposure_s: float, cycles: float) -> None:
    chosen = choose_exposure(third_stop_steps_s(), 1.0, frequency_hz)
    assert chosen is not None
    assert chosen.exposure_s == pytest.approx(exposure_s)
    assert chosen.cycles == pytest.approx(cycles, abs=1e-3)


def test_at_rest_the_nominal_exposure_is_taken() -> None:
    chosen = choose_exposure(third_stop_steps_s(), 0.35, None)
    assert chosen is not None
    assert (chosen.exposure_s, chosen.cycles) == (pytest.approx(2 ** (-5 / 3)), None)


def test_captures_at_known_phases_want_half_a_cycle_more() -> None:
    chosen = choose_exposure((0.9, 1.0, 1.1), 1.0, 5.0, half_cycles=True)
    assert chosen is not None
    assert part_cycle(chosen.cycles or 0.0) == pytest.approx(0.5)


def test_nothing_near_is_nothing() -> None:
    assert choose_exposure((0.01,), 1.0, 5.0) is None
    assert choose_exposure((), 1.0, None) is None


@settings(max_examples=60, deadline=None)
@given(frequency_hz=st.floats(0.5, 50), nominal_s=st.floats(0.05, 8))
def test_the_choice_is_the_best_of_its_window(frequency_hz: float, nominal_s: float) -> None:
    steps_s = third_stop_steps_s()
    chosen = choose_exposure(steps_s, nominal_s, frequency_hz)
    assert chosen is not None
    assert abs(math.log2(chosen.exposure_s / nominal_s)) <= WINDOW_STOPS + 0.1
    near = [step for step in steps_s if abs(math.log2(step / nominal_s)) <= WINDOW_STOPS]
    best = min(abs(step * frequency_hz - round(step * frequency_hz)) for step in near)
    assert chosen.cycles == pytest.approx(chosen.exposure_s * frequency_hz)
    assert part_cycle(chosen.cycles or 0.0) <= best + 0.011
