"""Frames that show nothing, or half of it, through the whole chain: said so, row by row, and nothing invented."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray

from labdaemon.processing.envelope import measure_capture
from labdaemon.processing.sharpset import prepare_sharp
from labdrivers.sim.dng import write_dng
from labdrivers.sim.folder import make_folder

TARGETS, WHITE = 12, 4095
Spoil = Callable[[NDArray[np.uint16]], NDArray[np.uint16]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("spoilt") / "set", seed=3, cameras=1, targets=TARGETS)


def left_half(value: int) -> Spoil:
    def spoil(counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
        counts[:, : counts.shape[1] // 2 - 60] = value
        return counts

    return spoil


def noise(counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
    return np.random.default_rng(1).integers(0, WHITE, counts.shape, dtype=np.uint16)


def flat(value: int) -> Spoil:
    return lambda counts: np.full_like(counts, value)


@pytest.mark.parametrize(
    ("spoil", "flags", "lost"),
    [
        (flat(0), {"not_found"}, TARGETS),
        (flat(WHITE), {"not_found", "saturated"}, TARGETS),
        (flat(1800), {"not_found"}, TARGETS),
        (noise, {"not_found"}, TARGETS),
        (left_half(0), {"not_found"}, TARGETS // 2),
        (left_half(WHITE), {"not_found", "saturated"}, TARGETS // 2),
    ],
    ids=["black", "white", "grey", "noise", "half black", "half white"],
)
def test_what_is_not_to_be_seen_has_no_numbers(
    folder: Path, tmp_path: Path, spoil: Spoil, flags: set[str], lost: int
) -> None:
    spoilt = tmp_path / "set"
    shutil.copytree(folder, spoilt)
    file = spoilt / "captures" / "c1" / "front.dng"
    with rawpy.imread(str(file)) as raw:
        counts = raw.raw_image_visible.copy()
    write_dng(file, spoil(counts), "RGGB", 0, WHITE, serial="6000001", exposure_s=1.0)
    measured = measure_capture(spoilt, prepare_sharp(spoilt), ("c1",), "c1")
    rows = measured.envelope_rows
    empty = [row for row in rows if row["ax_mm"] is None]
    assert len(empty) == lost
    is_uniform = lost == TARGETS and spoil is not noise
    assert any("all its pixels are" in note for note in measured.notes) == is_uniform
    assert all(set(row["flags"]) == flags for row in empty)
    assert all(not row["flags"] for row in rows if row["ax_mm"] is not None)


def test_a_sharp_frame_of_a_moving_structure_is_not_believed(folder: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "set"
    shutil.copytree(folder, spoilt)
    shutil.copy(spoilt / "captures" / "c1" / "front.dng", spoilt / "sharp" / "front.dng")
    prepared = prepare_sharp(spoilt)
    assert any("itself blurred" in note for note in prepared.notes)
    rows = measure_capture(spoilt, prepared, ("c1",), "c1").envelope_rows
    assert rows
    assert all("poor_fit" in row["flags"] for row in rows)
    assert not any("itself blurred" in note for note in prepare_sharp(folder).notes)
