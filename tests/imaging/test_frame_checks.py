from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.imaging.frame_checks import empty_note, empty_rows, refuse_mosaic

BAYER = np.array([[0, 1], [1, 2]])
QUAD = np.kron(BAYER, np.ones((2, 2), int))
XTRANS = np.array(
    [
        [1, 1, 0, 1, 1, 2],
        [1, 1, 2, 1, 1, 0],
        [2, 0, 1, 0, 2, 1],
        [1, 1, 2, 1, 1, 0],
        [1, 1, 0, 1, 1, 2],
        [0, 2, 1, 2, 0, 1],
    ]
)
SHAPE = (420, 640)


def scene(seed: int = 0, filters: np.ndarray | float = 1.0, level: float = 2900.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    dark = np.hypot(xx % 115 - 57, yy % 115 - 57) < 14
    light = np.where(dark, 0.08, 1.0) * level * (1 - 0.3 * xx / SHAPE[1]) * filters
    return np.clip(np.rint(light + rng.normal(size=SHAPE) * np.sqrt(light / 8.5 + 0.6)), 0, 4095).astype(np.uint16)


def tiled(cell: np.ndarray) -> np.ndarray:
    return cell[np.arange(SHAPE[0])[:, None] % len(cell), np.arange(SHAPE[1]) % len(cell[0])]


@pytest.mark.parametrize("pattern", [BAYER, BAYER[::-1], QUAD, XTRANS], ids=["RGGB", "GBRG", "quad", "X-Trans"])
@pytest.mark.parametrize("rgb", [(0.55, 1, 0.45), (0.93, 1, 0.9), (1.3, 1, 0.7), (1.2, 1, 1.1)])
@pytest.mark.parametrize("level", [2900, 4300])
def test_a_mosaic_saved_as_grey_is_refused(pattern: np.ndarray, rgb: tuple[float, ...], level: float) -> None:
    with pytest.raises(DataError, match=r"g\.tif: is the mosaic of a colour sensor"):
        refuse_mosaic(Path("g.tif"), scene(1, np.array(rgb)[tiled(pattern)], level))


def test_a_grey_sensor_is_none() -> None:
    xx = np.arange(SHAPE[1])
    for seed in range(3):
        refuse_mosaic(Path("g.tif"), scene(seed))
        refuse_mosaic(Path("g.tif"), scene(seed, np.where(xx % 2, 1.0, 1.04)))  # two outputs of unequal gain
        refuse_mosaic(Path("g.tif"), np.random.default_rng(seed).integers(0, 4095, (60, 80)))
    refuse_mosaic(Path("g.tif"), np.zeros(SHAPE, np.uint16))
    refuse_mosaic(Path("g.tif"), np.zeros((3, 3), np.uint16))


@pytest.mark.parametrize("part", [slice(200, None), slice(418, None), slice(0, 50), slice(100, 140)])
def test_rows_of_zeros_were_never_written(part: slice) -> None:
    values = scene()
    values[part] = 0
    expected = np.zeros(SHAPE[0], bool)
    expected[part] = True
    empty = empty_rows(values)
    np.testing.assert_array_equal(empty, expected)
    first, last = np.flatnonzero(expected)[[0, -1]]
    assert f"f.dng: {expected.sum()} of 420 rows are zero ({first} to {last})" in empty_note(Path("f.dng"), empty)


def test_a_dark_frame_or_a_dark_part_is_none() -> None:
    rng = np.random.default_rng(1)
    assert not empty_rows(np.zeros(SHAPE, np.uint16)).any()
    assert not empty_rows(np.maximum(np.rint(rng.normal(0, 0.8, SHAPE)), 0).astype(np.uint16)).any()
    half = scene()
    half[:, :300] = 0
    assert not empty_rows(half).any()
