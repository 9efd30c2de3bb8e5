"""How a controller is spelled: templates of the rig file, and the levels they may name."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from labdrivers.scpi_commands import DIALECTS, LEVELS, ScpiCommands


@pytest.mark.parametrize("name", LEVELS)
def test_every_level_may_be_in_a_template(name: str) -> None:
    commands = ScpiCommands(set_level=f"LEV {{{name}:.4f}}")
    assert commands.level_name == name
    assert commands.in_volts is name.startswith("level_")


@pytest.mark.parametrize(("template", "words"), [
    ("VOLT 1", "must hold exactly one"),
    ("VOLT {level_vpp} {level_v}", "must hold exactly one"),
    ("VOLT {volts}", "no template"),
    ("VOLT {0}", "no template"),
    ("VOLT {level_vpp:.4q}", "no template"),
    ("VOLT {level_vpp", "no template"),
    ("VOLT {level_vpp.real.x}", "no template"),
])  # fmt: skip
def test_a_wrong_template_is_refused_with_the_names_that_would_be_right(template: str, words: str) -> None:
    with pytest.raises(ValidationError, match=words) as caught:
        ScpiCommands(set_level=template)
    assert "amplitude_mm" in str(caught.value)


def test_a_frequency_template_takes_the_frequency_only() -> None:
    assert ScpiCommands(set_frequency="F{frequency_hz:.1f}").set_frequency == "F{frequency_hz:.1f}"
    with pytest.raises(ValidationError, match="frequency_hz"):
        ScpiCommands(set_frequency="F {level_vpp}")


@settings(max_examples=30, deadline=None, derandomize=True)
@given(hz=st.floats(0.5, 200.0), mm=st.floats(0.01, 20.0), mm_per_v=st.floats(0.01, 100.0))
def test_levels_are_the_same_motion_in_other_units(hz: float, mm: float, mm_per_v: float) -> None:
    """Of a sine of amplitude A: velocity ωA, acceleration ω²A, and a generator's volts by its calibration."""
    level = {name: per_mm(hz, mm_per_v) * mm for name, per_mm in LEVELS.items()}
    omega = 2 * math.pi * hz
    assert level["peak_to_peak_mm"] == pytest.approx(2 * mm)
    assert level["velocity_mm_s"] == pytest.approx(omega * mm)
    assert level["acceleration_m_s2"] == pytest.approx(omega**2 * mm / 1000)
    assert level["acceleration_g"] == pytest.approx(level["acceleration_m_s2"] / 9.80665)
    assert level["level_vpp"] == pytest.approx(2 * level["level_v"])
    assert level["level_vrms"] == pytest.approx(level["level_v"] / math.sqrt(2))
    assert level["level_v"] * mm_per_v == pytest.approx(mm)


def test_the_built_in_dialects_stop_as_far_as_they_can() -> None:
    assert DIALECTS["keysight"].can_switch_off
    assert not DIALECTS["33120a"].can_switch_off, "it has no OUTPut subsystem"
    for commands in DIALECTS.values():
        assert commands.in_volts


def test_a_misspelled_command_is_refused() -> None:
    with pytest.raises(ValidationError, match="set_freqency"):
        ScpiCommands.model_validate({"set_freqency": "F {frequency_hz}"})
