"""Phases in [0, 2π), whatever the number."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from labdaemon.journal.light_record import LightRecord
from labdaemon.phase_angle import TURN, wrap_phase


@settings(max_examples=60, deadline=None, derandomize=True)
@example(-1e-300)
@example(-0.0)
@example(TURN)
@example(math.nextafter(TURN, 0.0))
@given(st.floats(-1e6, 1e6))
def test_a_phase_is_wrapped_and_stays_the_same_angle(phase: float) -> None:
    wrapped = wrap_phase(phase)
    assert 0.0 <= wrapped < TURN
    assert math.cos(wrapped) == pytest.approx(math.cos(phase), abs=1e-6)
    assert math.sin(wrapped) == pytest.approx(math.sin(phase), abs=1e-6)
    assert wrap_phase(wrapped) == wrapped


def test_a_light_code_that_begins_at_zero_by_a_rounding_error_says_zero() -> None:
    keys = LightRecord((0.0, 1.0), 5, -1e-20).capture_keys
    assert keys["light_phase_rad"] == 0.0
    assert keys["light"] == [0.0, 1.0]
