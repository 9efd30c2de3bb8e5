"""What others state of an excitation, against what the table gauge saw."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.table_motion import CALIBRATION_SD, CLOCK_SD, SIGMAS, TableMotion, contradiction


def seen(frequency_hz: float | None = 5.0, amplitude_mm: float | None = 2.0, sd_mm: float = 0.0) -> TableMotion:
    return TableMotion("laser", frequency_hz, 0.0, amplitude_mm, sd_mm)


def test_nothing_stated_contradicts_nothing() -> None:
    assert contradiction(seen(), None, None) is None
    assert contradiction(seen(None, None), 5.0, 2.0) is None, "a gauge that saw nothing cannot object"


@pytest.mark.parametrize(("stated_hz", "stated_mm", "expected"), [
    (8.0, None, "5 Hz where 8 Hz was stated"),
    (None, 3.0, "2 mm where 3 mm was stated"),
    (8.0, 3.0, "5 Hz where 8 Hz was stated and 2 mm where 3 mm was stated"),
])  # fmt: skip
def test_what_differs_is_named(stated_hz: float | None, stated_mm: float | None, expected: str) -> None:
    error = contradiction(seen(), stated_hz, stated_mm)
    assert error is not None
    assert str(error).startswith(f"laser: sees {expected}")
    assert error.device == "laser"


def test_a_table_at_rest_contradicts_a_stated_frequency() -> None:
    still = seen(None, 0.001, sd_mm=0.001)
    assert "no motion where 5 Hz was stated" in str(contradiction(still, 5.0, None))
    assert contradiction(seen(None, 0.01, sd_mm=0.001), 5.0, None) is None, "something does move"


@settings(max_examples=30, deadline=None, derandomize=True)
@given(hz=st.floats(0.1, 200.0), mm=st.floats(0.01, 20.0), part=st.floats(-0.95, 0.95), beyond=st.floats(1.1, 5.0))
def test_the_bound_is_three_standard_deviations(hz: float, mm: float, part: float, beyond: float) -> None:
    motion = seen(hz, mm)
    inside_hz, inside_mm = hz * (1 + SIGMAS * CLOCK_SD * part), mm * (1 + SIGMAS * CALIBRATION_SD * part)
    assert contradiction(motion, inside_hz, inside_mm) is None
    assert contradiction(motion, hz * (1 + SIGMAS * CLOCK_SD * beyond), None) is not None
    assert contradiction(motion, None, mm * (1 - SIGMAS * CALIBRATION_SD * beyond)) is not None


def test_a_noisy_gauge_objects_to_less() -> None:
    assert contradiction(seen(amplitude_mm=2.0, sd_mm=0.0), None, 2.5) is not None
    assert contradiction(seen(amplitude_mm=2.0, sd_mm=0.3), None, 2.5) is None
