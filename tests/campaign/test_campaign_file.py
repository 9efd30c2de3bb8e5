"""The campaign file by itself: what a person may write, and what is refused by its path."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.campaign_file import Campaign, Spacing, SweepPhase, frequencies, load_campaign
from labdaemon.errors import ConfigError

HERTZ = st.floats(0.5, 900.0)


def campaign(phase: str) -> Campaign:
    return load_campaign(f'name = "test"\n[[phase]]\n{phase}')


@settings(max_examples=50, deadline=None, derandomize=True)
@given(start=HERTZ, stop=HERTZ, count=st.integers(1, 200), spacing=st.sampled_from(["linear", "log"]))
def test_a_ladder_has_both_ends_and_rises_or_falls(start: float, stop: float, count: int, spacing: str) -> None:
    values = Spacing.model_validate({"start": start, "stop": stop, "count": count, "spacing": spacing}).values()
    assert len(values) == count
    assert values[0] == start
    if count > 1:
        assert values[-1] == stop, "exactly: a limit of the table may lie there"
    low, high = min(start, stop), max(start, stop)
    assert all(low * (1 - 1e-12) <= value <= high * (1 + 1e-12) for value in values)
    sign = 1 if stop >= start else -1
    assert all(sign * (after - before) >= -1e-9 for before, after in itertools.pairwise(values))


def test_steps_of_a_ladder_are_even() -> None:
    linear = Spacing(start=4.0, stop=14.0, count=6).values()
    assert linear == pytest.approx((4.0, 6.0, 8.0, 10.0, 12.0, 14.0))
    log = Spacing(start=1.0, stop=16.0, count=5, spacing="log").values()
    assert log == pytest.approx((1.0, 2.0, 4.0, 8.0, 16.0))
    assert frequencies(5.0) == (5.0,)
    assert frequencies((5.0, 4.0)) == (5.0, 4.0)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    hz=HERTZ, level=st.floats(0.1, 1000.0), key=st.sampled_from(["velocity_mm_s", "acceleration_mm_s2", "amplitude_mm"])
)
def test_a_sweep_keeps_its_level(hz: float, level: float, key: str) -> None:
    """A, v/(2πf) or a/(2πf)²."""
    sweep = SweepPhase.model_validate(
        {"kind": "sweep", "frequency_hz": {"start": hz, "stop": hz, "count": 1}, key: level}
    )
    power = {"amplitude_mm": 0, "velocity_mm_s": 1, "acceleration_mm_s2": 2}[key]
    assert sweep.level_key == key
    assert sweep.amplitude_at(hz) * (2 * math.pi * hz) ** power == pytest.approx(level)


@pytest.mark.parametrize("level", ["", "amplitude_mm = 1.0\nvelocity_mm_s = 5.0"])
def test_a_sweep_has_exactly_one_level(level: str) -> None:
    with pytest.raises(ConfigError, match="exactly one of amplitude_mm, velocity_mm_s, acceleration_mm_s2"):
        campaign(f'kind = "sweep"\nfrequency_hz = {{ start = 4.0, stop = 8.0, count = 3 }}\n{level}')


@pytest.mark.parametrize(("phase", "words"), [
    ('kind = "sharp"\nframes = 0', "frames"),
    ('kind = "sharp"\nframes = 2.0', "frames"),
    ('kind = "sharp"\nexposure_s = -1.0', "exposure_s"),
    ('kind = "sharpe"', "kind"),
    ('frames = 3', "kind"),
    ('kind = "steps"\nfrequency_hz = 5.0\namplitude_mm = [1.0, 2.0]', "2 values of amplitude_mm for 1 of frequency_hz"),
    ('kind = "steps"\nfrequency_hz = []\namplitude_mm = 1.0', "frequency_hz"),
    ('kind = "steps"\nfrequency_hz = 5.0\namplitude_mm = nan', "amplitude_mm"),
    ('kind = "steps"\nfrequency_hz = true\namplitude_mm = 1.0', "frequency_hz"),
    ('kind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0\nphase_rad = [0.0, 6.283185307]',
     "two of the phases are the same"),
    ('kind = "dwell"\nfrequency_hz = 5.0\namplitude_mm = 1.0', "hold_s"),
    ('kind = "dwell"\nfrequency_hz = 5.0\namplitude_mm = 1.0\nhold_s = 1.0\nlabel = "Ä"', "label"),
    ('kind = "pause"\nnot_before = "24:00"', "not_before"),
    ('kind = "pause"\nnot_before = "22:00"\nnot_after = "22:00"', "could never start"),
    ('kind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0\non_fault = "stop"', "on_fault"),
])  # fmt: skip
def test_a_mistake_is_refused_by_its_key(phase: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        campaign(phase)


def test_a_misspelled_key_is_answered_with_what_was_meant() -> None:
    with pytest.raises(ConfigError, match=r"phase\[0\]\.exposur_s: .*exposure_s"):
        campaign('kind = "sharp"\nexposur_s = 1.0')


def test_phases_that_differ_by_less_than_a_turn_are_two() -> None:
    made = campaign('kind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0\nphase_rad = [0.0, 1.57, 3.14]')
    assert made.section.phase[0].phase_rad == (0.0, 1.57, 3.14)  # type: ignore[union-attr]


def test_defaults_are_those_of_the_manual() -> None:
    [sharp] = campaign('kind = "sharp"').section.phase
    assert (sharp.on_fault, sharp.repeats, sharp.label) == ("retry", 1, None)
    [steps] = campaign('kind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0').section.phase
    rule = steps.settle.value()  # type: ignore[union-attr]
    assert (rule.max_change_per_cycle, rule.timeout_s, rule.damping_ratio) == (0.001, 60.0, 0.01)
