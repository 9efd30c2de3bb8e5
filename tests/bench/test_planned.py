"""Designs simulated as planned: the harness itself; `labdaemon bench planned` prints the figures."""

import math

import numpy as np
import pytest

from labdaemon.bench.planned import PlannedTrials, _angles, plan_case, run_planned
from labdaemon.blur import ExposureWindow, LightCode


def test_the_amplitude_scatters_as_predicted() -> None:
    planned = plan_case("amplitude", "", None, 0.4)
    precision = planned.own.precision
    found = run_planned(planned.own.windows, (precision.sd_amplitude_mm, math.inf), 0.4, 6)
    assert found.flagged == 0
    # Six trials know their own scatter to a third; the bench takes more.
    assert 0.3 < found.amplitude_ratio < 2.2
    assert math.isnan(found.phase_ratio)


def test_light_comes_in_over_the_phases_of_the_code() -> None:
    share = (np.arange(2000) + 0.5) / 2000
    code = LightCode((1.0, 0.0, 0.0, 0.0), 0.5)
    angles = _angles(ExposureWindow(1.0, 1.0, light=code))(share)
    assert angles.min() == pytest.approx(0.5, abs=0.01)
    assert angles.max() == pytest.approx(0.5 + math.pi / 2, abs=0.01)
    plain = _angles(ExposureWindow(5.5, 1.0, 0.3))(np.array([0.0, 1.0]))
    assert plain == pytest.approx((0.3, 0.3 + 11 * math.pi))


def test_ratios_are_of_what_is_not_flagged_and_a_phase_that_does_not_show_has_none() -> None:
    trials = PlannedTrials(0.002, 0.01, np.array([0.001, -0.003]), np.zeros(0), np.zeros(0), flagged=3)
    assert trials.amplitude_ratio == pytest.approx(math.sqrt(5) / 2)
    assert math.isnan(trials.phase_ratio)
