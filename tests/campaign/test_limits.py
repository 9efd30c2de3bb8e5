"""The table's limits against sampled motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.limits import ShakerLimits, check_amplitude, check_frequency, largest_amplitude_mm

TABLE = ShakerLimits(150.0, 1000.0, 20000.0, (0.5, 50.0))


@settings(max_examples=60, deadline=None)
@given(frequency_hz=st.floats(0.5, 50), amplitude_mm=st.floats(0.01, 200))
def test_a_step_passes_exactly_when_its_sampled_motion_stays_inside(frequency_hz: float, amplitude_mm: float) -> None:
    time_s = np.linspace(0, 1 / frequency_hz, 20001)
    place = amplitude_mm * np.sin(2 * np.pi * frequency_hz * time_s)
    velocity = np.gradient(place, time_s)
    acceleration = np.gradient(velocity, time_s)[2:-2]
    shares = (np.ptp(place) / 150.0, np.abs(velocity).max() / 1000.0, np.abs(acceleration).max() / 20000.0)
    if abs(max(shares) - 1) < 1e-5:
        return
    assert (check_amplitude(TABLE, frequency_hz, amplitude_mm) is None) == (max(shares) < 1)


@pytest.mark.parametrize(
    ("frequency_hz", "amplitude_mm", "word"),
    [(1.0, 80.0, "stroke"), (2.5, 74.0, "velocity"), (20.0, 2.0, "acceleration"), (1.0, 75.0, None), (8.0, 7.9, None)],
)
def test_the_limit_that_is_crossed_is_named(frequency_hz: float, amplitude_mm: float, word: str | None) -> None:
    message = check_amplitude(TABLE, frequency_hz, amplitude_mm)
    assert (message is None) if word is None else (message is not None and word in message)


def test_force_is_mass_times_acceleration() -> None:
    weak = ShakerLimits(150.0, 1000.0, 20000.0, (0.5, 50.0), force_n=100.0, moving_mass_kg=20.0)
    allowed = largest_amplitude_mm(weak, 8.0)
    assert 20.0 * (2 * np.pi * 8.0) ** 2 * allowed / 1000 == pytest.approx(100.0)
    assert "force" in (check_amplitude(weak, 8.0, allowed * 1.01) or "")


def test_what_is_advised_is_allowed() -> None:
    message = check_amplitude(TABLE, 8.0, 9.0)
    assert message is not None
    advised = float(message.rpartition("at most ")[2].split()[0])
    assert check_amplitude(TABLE, 8.0, advised) is None
    assert advised == pytest.approx(largest_amplitude_mm(TABLE, 8.0), rel=0.01)


def test_frequencies_outside_the_range_are_named() -> None:
    assert check_frequency(TABLE, 50.0) is None
    assert "0.5 to 50 Hz" in (check_frequency(TABLE, 50.1) or "")
