"""What a shaker's driver refuses to set, whatever the caller checked before."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.limits import ShakerLimits
from labdaemon.errors import LimitError
from labdrivers.drive_table import DrivePoint
from labdrivers.scpi_limits import check_excitation, check_level
from labdrivers.scpi_settings import STOPPING, ShakerSettings

LIMITS = ShakerLimits(stroke_mm=10.0, velocity_mm_s=500.0, acceleration_mm_s2=20000.0, frequency_hz=(1.0, 100.0))


@pytest.fixture
def settings_() -> ShakerSettings:
    return ShakerSettings(
        port="/dev/ttyUSB0", limits=LIMITS, drive=(DrivePoint(frequency_hz=5.0, mm_per_v=2.0),), highest_level_v=5.0
    )


@pytest.mark.parametrize(("hz", "mm"), [
    (math.nan, 1.0), (5.0, math.inf), (0.0, 1.0), (-5.0, 1.0), (5.0, -0.1),
])  # fmt: skip
def test_what_is_no_excitation_is_refused(settings_: ShakerSettings, hz: float, mm: float) -> None:
    with pytest.raises(LimitError, match="is no excitation"):
        check_excitation("shaker", settings_, hz, mm)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(hz=st.floats(0.1, 300.0), mm=st.floats(0.0, 30.0))
def test_what_is_let_through_is_within_every_limit(hz: float, mm: float) -> None:
    section = ShakerSettings(port="/dev/ttyUSB0", limits=LIMITS)
    omega = 2 * math.pi * hz
    inside = (
        1.0 <= hz <= 100.0 and 2 * mm <= LIMITS.stroke_mm and omega * mm <= LIMITS.velocity_mm_s
        and omega**2 * mm <= LIMITS.acceleration_mm_s2
    )  # fmt: skip
    try:
        check_excitation("shaker", section, hz, mm)
    except LimitError as exc:
        refusal: LimitError | None = exc
    else:
        refusal = None
    if refusal is None:
        assert 1.0 <= hz <= 100.0
        assert omega * mm <= LIMITS.velocity_mm_s * (1 + 1e-9)
        assert omega**2 * mm <= LIMITS.acceleration_mm_s2 * (1 + 1e-9)
    else:
        assert not inside or mm > LIMITS.stroke_mm / 2
        assert refusal.key == "shaker.limits"


def test_a_level_that_the_generator_cannot_put_out_is_refused(settings_: ShakerSettings) -> None:
    check_level("shaker", settings_, 5.0, 2.0, level_v=1.0, lowest_mm=0.02)
    check_level("shaker", settings_, 5.0, 0.0, level_v=0.0, lowest_mm=0.02)
    with pytest.raises(LimitError, match=r"at least 0\.02 mm is possible") as caught:
        check_level("shaker", settings_, 5.0, 0.01, level_v=0.005, lowest_mm=0.02)
    assert caught.value.key == "shaker.lowest_level_v"
    with pytest.raises(LimitError, match="limit 5 V; lower the amplitude") as caught:
        check_level("shaker", settings_, 5.0, 12.0, level_v=6.0, lowest_mm=0.02)
    assert caught.value.key == "shaker.highest_level_v"


def test_a_section_for_stopping_only_needs_a_port() -> None:
    """A stop must not fail for a calibration file that is gone."""
    section = ShakerSettings.model_validate({"port": "/dev/ttyUSB0", **STOPPING})
    assert section.calibration is None
    assert section.enable_line
