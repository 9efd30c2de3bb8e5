"""A response that bends shows in noise that falls while the light rises; nothing else looks like it."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.imaging.compression import find_knees

RGGB = np.array([[0, 1], [3, 2]], dtype=np.uint8)
GREY = np.zeros((1, 1), dtype=np.uint8)
SHAPE = (360, 480)
WHITE = 4095.0
GAINS = np.array([0.58, 1.0, 0.72, 1.0])


def counts(
    cell: np.ndarray,
    level: float,
    seed: int,
    *,
    knee: float = WHITE,
    slope: float = 1.0,
    bent: tuple[int, ...] = (0, 1, 2, 3),
    gamma: float = 1.0,
) -> np.ndarray:
    """Labels with blurred dots before a dark ground: photon noise, fixed pattern, and a response that bends."""
    rng = np.random.default_rng(seed)
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    away = np.hypot(xx % 120 - 60, yy % 120 - 60)
    label = np.where(np.maximum(abs(xx % 120 - 60), abs(yy % 120 - 60)) < 52, 0.3 + 0.7 * np.clip(away / 30, 0, 1), 0.4)
    channel = cell[np.arange(SHAPE[0])[:, None] % len(cell), np.arange(SHAPE[1]) % len(cell)]
    light = level * label * (1 - 0.1 * xx / SHAPE[1]) * (GAINS[channel] if len(cell) > 1 else 1.0)
    light = light * (1 + 0.004 * rng.normal(size=SHAPE)) + np.sqrt(light / 8.5) * rng.normal(size=SHAPE)
    light = WHITE * (np.clip(light, 0, None) / WHITE) ** gamma
    over = (light > knee) & np.isin(channel, bent)
    light = np.where(over, knee + slope * (light - knee), light) + 0.8 * rng.normal(size=SHAPE)
    return np.clip(np.rint(light), 0, WHITE).astype(np.uint16)


@pytest.mark.parametrize("cell", [RGGB, GREY])
@pytest.mark.parametrize("level", [2000.0, 2900.0, 3700.0, 4300.0])
def test_a_linear_sensor_has_no_knee(cell: np.ndarray, level: float) -> None:
    tops = np.full(int(cell.max()) + 1, WHITE)
    assert np.all(find_knees(counts(cell, level, 1), cell, 0.0, tops) == np.inf)


@pytest.mark.parametrize("slope", [0.2, 0.5])
def test_the_knee_is_found_in_the_channels_that_bend(slope: float) -> None:
    values = counts(RGGB, 4100.0, 2, knee=0.88 * WHITE, slope=slope)
    knees = find_knees(values, RGGB, 0.0, np.full(4, WHITE))
    assert np.all(np.isinf(knees[[0, 2]]))
    assert np.all((knees[[1, 3]] > 0.8 * WHITE) & (knees[[1, 3]] < 0.9 * WHITE))


def test_one_green_alone_may_bend() -> None:
    knees = find_knees(counts(RGGB, 4000.0, 3, knee=0.85 * WHITE, slope=0.4, bent=(3,)), RGGB, 0.0, np.full(4, WHITE))
    assert np.isfinite(knees).tolist() == [False, False, False, True]


def test_a_grey_sensor_is_compared_with_its_own_shades() -> None:
    knees = find_knees(counts(GREY, 4100.0, 4, knee=0.88 * WHITE, slope=0.4), GREY, 0.0, np.array([WHITE]))
    assert 0.8 * WHITE < knees[0] < 0.9 * WHITE
