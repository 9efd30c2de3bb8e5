"""The captures that know most in a given time, by the information of their modelled images."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from labdaemon.blur import DotImage, NoiseModel, light_fraction, predict_sd
from labdaemon.campaign.campaign_file import Campaign, load_campaign
from labdaemon.campaign.capture_design import Expectation, Goal, StepDesign
from labdaemon.campaign.fisher_plan import (
    FIT_OVER_BOUND,
    LEAST_WHITE,
    MOST_WHITE,
    MOTION_PHASES,
    DesignSearch,
    default_goal,
    excitations,
    spread_amplitudes,
)
from labdaemon.campaign.light_plan import ImageScale
from labdaemon.campaign.limits import ShakerLimits
from labdaemon.campaign.plan import PlanRig
from labdaemon.capture.exposure import third_stop_steps_s
from labdaemon.capture.lamp import Lamp
from labdaemon.errors import LimitError

LIMITS = ShakerLimits(150.0, 1000.0, 20_000.0, (0.5, 50.0))
QUIET = DotImage(noise=NoiseModel(0.8, 0.12))
SMALL = ImageScale(1.6, 5.0)


def rig(lamp: Lamp | None = None) -> PlanRig:
    return PlanRig(LIMITS, {"left": third_stop_steps_s(), "right": third_stop_steps_s()}, lamp=lamp)


def campaign(extra: str = "", frequency_hz: str = "5.0") -> Campaign:
    return load_campaign(
        f'name = "x"\n[[phase]]\nkind = "steps"\nfrequency_hz = {frequency_hz}\namplitude_mm = 1.0\n'
        f"exposure_s = 1.0\n{extra}"
    )


def search(
    goal: Goal, extra: str = "", lamp: Lamp | None = None, amplitude_mm: float = 1.5
) -> tuple[StepDesign, Expectation]:
    expected = Expectation((amplitude_mm,), SMALL, QUIET, sd_opening_s=0.0)
    phase: Any = campaign(extra).section.phase[0]
    return DesignSearch(rig(lamp), expected, goal).best(phase, 5.0, 1.0), expected


PHASES = "phase_rad = [0.0, 1.5708]\n"


@pytest.fixture(scope="module")
def by_openings() -> tuple[StepDesign, Expectation]:
    return search("phase", PHASES)


@pytest.fixture(scope="module")
def with_lamp() -> StepDesign:
    return search("phase", PHASES, Lamp(levels=2), amplitude_mm=2.5)[0]


@pytest.mark.parametrize("which", ["own", "best"])
def test_the_prediction_is_that_of_predict_sd(by_openings: tuple[StepDesign, Expectation], which: str) -> None:
    design, expected = by_openings
    one = getattr(design, which)
    dot = expected.image(one.windows[0].exposure_s)
    found = [predict_sd(one.windows, 1.5 * SMALL.px_per_mm, phase, dot) for phase in MOTION_PHASES]
    rms = math.sqrt(float(np.mean([sd.phase_rad**2 for sd in found])))
    assert one.precision.sd_phase_rad == pytest.approx(FIT_OVER_BOUND * rms, rel=2e-3)
    rms = math.sqrt(float(np.mean([sd.amplitude_px**2 for sd in found]))) / SMALL.px_per_mm
    assert one.precision.sd_amplitude_mm == pytest.approx(FIT_OVER_BOUND * rms, rel=2e-3)


def test_few_cycles_show_the_phase_better_than_many(by_openings: tuple[StepDesign, Expectation]) -> None:
    design, _ = by_openings
    assert design.best.windows[0].cycles < design.own.windows[0].cycles
    assert design.best.precision.per_root_time("phase") < 0.7 * design.own.precision.per_root_time("phase")
    assert design.best_precision.seconds <= 1.3 * design.own_precision.seconds


def test_the_paper_stays_between_dark_and_white_level(
    by_openings: tuple[StepDesign, Expectation], with_lamp: StepDesign
) -> None:
    for design in (by_openings[0], with_lamp):
        for window in design.best.windows:
            assert LEAST_WHITE <= window.exposure_s * light_fraction(window) <= MOST_WHITE


def test_a_lamp_is_used_where_it_knows_more_and_only_where_there_is_one(
    by_openings: tuple[StepDesign, Expectation], with_lamp: StepDesign
) -> None:
    assert by_openings[0].best.phase.light is None
    assert with_lamp.best.phase.light == "1110100"
    assert with_lamp.best.phase.phase_rad is None
    assert with_lamp.best.precision.per_root_time("phase") < 0.8 * with_lamp.own.precision.per_root_time("phase")
    assert with_lamp.best.precision.ambiguous < 0.05


def test_a_code_whose_twins_the_image_does_not_exclude_is_not_chosen() -> None:
    design, _ = search("phase", 'light = "1110100"\n', Lamp(levels=2))
    assert design.own.precision.ambiguous > 0.2
    assert design.best.phase.light is None


def test_for_the_amplitude_alone_whole_cycles_need_no_phase() -> None:
    design, expected = search("amplitude")
    assert design.own.precision.sd_phase_rad == math.inf
    assert design.best.precision.per_root_time("amplitude") <= design.own.precision.per_root_time("amplitude")
    dot = expected.image(design.own.windows[0].exposure_s)
    direct = predict_sd(design.own.windows, 1.5 * SMALL.px_per_mm, 0.3, dot).amplitude_px / SMALL.px_per_mm
    assert design.own.precision.sd_amplitude_mm == pytest.approx(FIT_OVER_BOUND * direct, rel=1e-6)


def test_repeated_groups_fill_the_campaigns_time() -> None:
    design, _ = search("amplitude", "captures = 4\n")
    assert design.own_groups == 4
    assert design.own_precision.seconds == pytest.approx(4 * design.own.precision.seconds)
    assert design.own_precision.sd_amplitude_mm == pytest.approx(design.own.precision.sd_amplitude_mm / 2)
    spare = design.own_precision.seconds - design.best_precision.seconds
    assert 0 <= spare < design.best.precision.seconds


def test_goals_follow_from_what_a_phase_asks_for() -> None:
    plain, phased = campaign().section.phase[0], campaign(PHASES).section.phase[0]
    lit = campaign('light = "1110100"\n').section.phase[0]
    goals = [default_goal(phase) for phase in (plain, phased, lit)]  # type: ignore[arg-type]
    assert goals == ["amplitude", "phase", "phase"]


def test_each_excitation_comes_once() -> None:
    found = excitations(campaign(PHASES + "captures = 2\nboth_directions = true\n", "[5.0, 8.0]"), rig())
    assert found == [(0, 5.0, 1.0), (0, 8.0, 1.0)]
    with pytest.raises(LimitError):
        excitations(campaign("", "[5.0, 80.0]"), rig())


def test_amplitudes_stand_for_a_range() -> None:
    assert spread_amplitudes(1.0, 1.0) == pytest.approx((1.0,))
    low, high = spread_amplitudes(0.1, 10.0)
    assert 0.1 < low < 1.0 < high < 10.0
    assert low * high == pytest.approx(1.0)
