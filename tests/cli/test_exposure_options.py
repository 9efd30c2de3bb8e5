"""What is said of exposures on the command line: one frame, several frames alike, and frames of one group."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from labdaemon.blur.light_code import named_code
from labdaemon.cli.exposure_options import exposure_windows
from labdaemon.errors import UsageError

FRAMES = [Path("a.nef"), Path("b.nef")]


def test_without_options_nothing_is_known() -> None:
    stated: dict[str, float | None] = {"frequency_hz": None, "exposure_s": None, "ambient": None}
    assert exposure_windows(FRAMES, (), (), **stated) == ([None, None], False)


def test_one_phase_is_each_frame_s_own_and_two_are_a_group() -> None:
    windows, grouped = exposure_windows(FRAMES, (0.3,), (), frequency_hz=5.0, exposure_s=1.1)
    assert [window.phase_rad for window in windows if window is not None] == [0.3, 0.3]
    assert not grouped
    windows, grouped = exposure_windows(FRAMES, (0.3, 1.9), (), frequency_hz=5.0, exposure_s=1.1)
    assert [window.phase_rad for window in windows if window is not None] == [0.3, 1.9]
    assert grouped


def test_a_code_needs_no_frequency_where_its_cycles_are_given() -> None:
    windows, grouped = exposure_windows(FRAMES, (), ("cos", "sin"), light_cycles=5, light_phase_rad=0.2, ambient=0.1)
    assert grouped
    lights = [window.light for window in windows if window is not None]
    assert [light.brightness for light in lights if light is not None] == [named_code("cos"), named_code("sin")]
    assert all(light is not None and light.is_phase_known and light.ambient == 0.1 for light in lights)
    ((alone, _), grouped) = exposure_windows(FRAMES, (), ("110",), frequency_hz=5.0, exposure_s=2.0)
    assert not grouped
    assert alone is not None
    assert alone.light is not None
    assert alone.light.cycles == 10
    assert not alone.light.is_phase_known


@pytest.mark.parametrize(
    ("phases", "codes", "stated", "said"),
    [
        ((1.0, 2.0, 3.0), (), {"frequency_hz": 5.0, "exposure_s": 1.0}, "3 --phase for 2 blurred frames"),
        ((), (), {"exposure_s": 1.0}, "--frequency is missing"),
        ((), (), {"light_cycles": 3}, "--light-cycles is given, but no code"),
        ((), ("110",), {"light_cycles": 9, "frequency_hz": 5.0, "exposure_s": 1.0}, "--light-cycles = 9 do not fit"),
        ((), ("000",), {"light_cycles": 9}, "--light is zero in every sector"),
    ],
)
def test_options_that_contradict_each_other(
    phases: tuple[float, ...], codes: tuple[str, ...], stated: dict[str, Any], said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        exposure_windows(FRAMES, phases, codes, **stated)
