"""The scatter of phases by the whole likelihood."""

import numpy as np
import pytest

from labdaemon.blur import DotImage, ExposureWindow, LightCode, named_code, predict_scatter, predict_sd

DOT = DotImage()
CODE = ExposureWindow(5.0, 1.0, light=LightCode(named_code("1110100"), cycles=5))
OPENINGS = [ExposureWindow(5.0, 1.1, phase) for phase in (0.0, np.pi / 2)]
PHASES = (np.arange(6) + 0.5) * np.pi / 6


def bounds(windows: list[ExposureWindow], size_px: float) -> np.ndarray:
    return np.array([predict_sd(windows, size_px, phase, DOT).phase_rad for phase in PHASES])


def test_a_large_motion_scatters_as_its_bound_has_it() -> None:
    bound = np.full(len(PHASES), 0.03)
    found = predict_scatter(OPENINGS, 6.0, PHASES, bound, DOT)
    assert found.phase_rad == pytest.approx(bound, rel=0.1)
    assert not found.ambiguous.any()


def test_a_small_motion_under_a_code_has_twins_and_one_of_any_phase_no_more_than_the_circle() -> None:
    own = bounds([CODE], 1.5)
    found = predict_scatter([CODE], 1.5, PHASES, own, DOT)
    assert found.ambiguous.mean() > 0.1
    rest = predict_scatter(OPENINGS, 0.3, PHASES, np.full(len(PHASES), 30.0), DOT)
    assert np.all(rest.phase_rad < 1.2 * np.pi / np.sqrt(3))
    assert not rest.ambiguous.any()
