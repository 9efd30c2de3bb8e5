"""Scatter at rest against the stated sd, on synthetic readings of known noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from labdaemon.analysis.noise_floor import noise_floor
from labdaemon.errors import UsageError


def readings(
    *, captures: int = 12, targets: int = 10, sd: float = 0.01, stated: float = 0.01, seed: int = 0, shift: float = 0.5
) -> list[dict[str, Any]]:
    """Rows of `envelope.csv` at rest: positions with noise `sd`, all shifted together from capture to capture."""
    random = np.random.default_rng(seed)
    rows = []
    for capture in range(captures):
        common = random.normal(0.0, shift, 3)
        for target in range(targets):
            place = np.array([10.0 * target, 5.0, 2.0]) + common + random.normal(0.0, sd, 3)
            amplitude = abs(random.normal(0.0, 0.02))
            row: dict[str, Any] = {"capture": f"c{capture}", "target": f"T{target}", "flags": ["at_rest"]}
            row |= {f"{axis}_mm": float(value) for axis, value in zip("xyz", place, strict=True)}
            row |= {f"sd_{axis}_mm": stated for axis in "xyz"}
            row |= {"ax_mm": amplitude, "ay_mm": 0.0, "az_mm": 0.0, "bx_mm": 0.0, "by_mm": 0.0, "bz_mm": 0.0}
            rows.append(row)
    return rows


@pytest.mark.parametrize("seed", range(4))
def test_a_true_sd_gives_a_ratio_of_one_whatever_the_camera_does(seed: int):
    floor = noise_floor(readings(seed=seed), "mm", "envelope")
    assert floor.position_ratio == pytest.approx(1.0, abs=0.12)
    assert floor.stated_position_sd == pytest.approx(0.01)


def test_an_sd_that_is_stated_too_small_is_seen():
    assert noise_floor(readings(sd=0.03), "mm", "envelope").position_ratio == pytest.approx(3.0, abs=0.4)


def test_the_detection_limit_is_the_amplitude_that_few_readings_exceed():
    floor = noise_floor(readings(captures=60), "mm", "envelope")
    assert floor.detection_limit == pytest.approx(1.96 * 0.02, rel=0.12)
    assert floor.amplitude_median == pytest.approx(0.674 * 0.02, rel=0.15)
    assert floor.at_rest_share == 1.0


def test_motion_that_is_not_there_is_listed():
    rows = readings()
    rows[13]["flags"] = []
    floor = noise_floor(rows, "mm", "envelope")
    assert floor.false_motion == ("c1 T3",)
    assert floor.at_rest_share == pytest.approx(119 / 120)


def test_readings_without_a_number_or_behind_something_do_not_count():
    rows = readings()
    rows[0]["ax_mm"] = None
    rows[1]["flags"] = ["occluded"]
    floor = noise_floor(rows, "mm", "envelope")
    assert floor.readings == 118


def test_one_camera_has_no_scatter_along_the_normal():
    rows = readings(shift=0.0)
    for row in rows:
        row["y_mm"], row["sd_y_mm"] = 0.0, None
    assert noise_floor(rows, "mm", "envelope").position_ratio == pytest.approx(1.0, abs=0.15)


def test_too_few_captures_and_no_common_target_are_refused():
    with pytest.raises(UsageError, match="needs 2 captures"):
        noise_floor(readings(captures=1), "mm", "envelope")
    rows = [row for row in readings(captures=2, targets=2) if row["capture"][1] == row["target"][1]]
    with pytest.raises(UsageError, match="in all 2 captures"):
        noise_floor(rows, "mm", "envelope")
