"""Twins of light codes: symmetric codes have exact ones, and the distance grows with the motion."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.blur import DotImage, ExposureWindow, LightCode, mirror_axes, named_code, nearest_twin
from labdaemon.errors import UsageError


def group(*names: str, phase_rad: float = 0.4) -> list[ExposureWindow]:
    return [ExposureWindow(5.0, 1.0, light=LightCode(named_code(name), phase_rad, 5)) for name in names]


@pytest.mark.parametrize("code", ["11010", "10", "1100", "11100", "cos", "1111000"])
def test_a_symmetric_code_alone_has_an_exact_twin(code: str) -> None:
    twin = nearest_twin(group(code), 5.0, phases=3)
    assert twin.distance_sd < 0.2
    assert twin.twin_amplitude_px == pytest.approx(5.0, rel=0.02)


def test_the_twin_is_the_motion_run_backwards_from_the_codes_axis() -> None:
    windows = group("11010")
    assert windows[0].light is not None
    axis = mirror_axes(windows[0].light)[0]
    twin = nearest_twin(windows, 5.0, phases=4)
    expected = np.pi - 2 * axis - twin.phase_rad
    assert abs(np.angle(np.exp(1j * (twin.twin_phase_rad - expected)))) < 0.02


def test_pairs_without_a_common_axis_have_none() -> None:
    assert nearest_twin(group("cos", "sin"), 3.0, phases=4).distance_sd > 30
    assert nearest_twin(group("11010", "1110100"), 3.0, phases=4).distance_sd > 2
    # Twice the same symmetric code is as blind as once.
    assert nearest_twin(group("11010", "11010"), 5.0, phases=3).distance_sd < 0.2


def test_the_seven_sector_code_is_apart_from_its_twins_and_a_six_sector_code_is_too_close() -> None:
    seven, six = (nearest_twin(group(code), 3.0).distance_sd for code in ("1110100", "110100"))
    assert seven > 3 > six


def test_the_distance_grows_with_the_motion() -> None:
    distances = [nearest_twin(group("1110100"), amplitude, phases=3).distance_sd for amplitude in (1.0, 2.0, 4.0)]
    assert distances[0] < 1 < distances[2]
    assert distances == sorted(distances)


def test_constant_light_over_whole_cycles_shows_no_phase_at_all() -> None:
    assert nearest_twin([ExposureWindow(5.0, 1.0)], 3.0, phases=2).distance_sd < 0.2
    part = [ExposureWindow(5.0, 1.1, phase) for phase in (0.0, np.pi / 2)]
    assert nearest_twin(part, 5.0, DotImage(radius_px=12.0), phases=2).distance_sd > 5


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(UsageError):
        nearest_twin([], 1.0)


def test_diffraction_brings_twins_nearer() -> None:
    window = ExposureWindow(5.0, 1.0, light=LightCode(named_code("1110100"), cycles=5))
    sharp, diffracted = (
        nearest_twin([window], 3.0, DotImage(lens_sigma_px=0.3, diffraction_px=px)) for px in (0.0, 2.8)
    )
    assert diffracted.distance_sd < 0.8 * sharp.distance_sd
