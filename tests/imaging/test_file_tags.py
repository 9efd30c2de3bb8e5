"""What is worth knowing of a TIFF-like file before its pixels are read."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.imaging.file_tags import BlackTags, check_pixel_bytes, read_tags
from labdaemon.imaging.tiff_directories import read_directories
from labdrivers.sim import dng as simulated

VALUES = np.random.default_rng(1).integers(200, 3000, (48, 64)).astype(np.uint16)


def test_a_dng_is_raw_and_knows_its_body(tmp_path: Path, write_dng: Callable[..., Path]) -> None:
    tags = read_tags(write_dng(tmp_path / "a.dng", VALUES, serial="3001234", black=(100,)))
    assert (tags.is_raw, tags.serial, tags.images) == (True, "3001234", ())
    assert tags.black is not None
    np.testing.assert_array_equal(tags.black.pattern_dn, [[100.0]])


def test_an_ordinary_tiff_is_not(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    tifffile.imwrite(path, VALUES, datetime=datetime(2026, 5, 4, 10, 11, 12))
    tags = read_tags(path)
    assert not tags.is_raw
    assert len(tags.images) == 1
    assert tags.taken_at == datetime(2026, 5, 4, 10, 11, 12)
    assert tags.exposure_s is None


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n" + b"\0" * 40, b"FUJIFILMCCD-RAW " + b"\0" * 100])
def test_of_another_kind_of_file_nothing_is_known(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.raf"
    path.write_bytes(content)
    assert read_tags(path).is_raw
    assert read_tags(path).black is None


@pytest.mark.parametrize("cut", [1, 500, 3000])
def test_a_file_that_was_cut_short_says_so(tmp_path: Path, write_dng: Callable[..., Path], cut: int) -> None:
    path = write_dng(tmp_path / "a.dng", VALUES)
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(DataError, match=r"truncated: it has \d+ bytes"):
        read_tags(path)


@pytest.mark.parametrize(("repeat", "words"), [((6, 6), "X-Trans"), ((4, 4), "Quad Bayer"), ((3, 3), "every 3 x 3")])
def test_other_colour_filters_than_bayers_are_named(
    tmp_path: Path, write_dng: Callable[..., Path], repeat: tuple[int, int], words: str
) -> None:
    cfa = tuple(k % 3 for k in range(repeat[0] * repeat[1]))
    with pytest.raises(DataError, match=words):
        read_tags(write_dng(tmp_path / "a.dng", VALUES, cfa=cfa, repeat=repeat))


def test_processed_values_are_no_sensors(tmp_path: Path, write_dng: Callable[..., Path]) -> None:
    with pytest.raises(DataError, match="floating-point DNG"):
        read_tags(write_dng(tmp_path / "a.dng", VALUES.astype(np.float32)))
    with pytest.raises(DataError, match="32 bits a value"):
        read_tags(write_dng(tmp_path / "b.dng", VALUES.astype(np.uint32)))


def test_our_own_simulators_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    with path.open("wb") as file:
        simulated.write_dng(file, VALUES, "RGGB")
    tags = read_tags(path)
    assert tags.is_raw


def black(**changes: Any) -> BlackTags:
    options: dict[str, Any] = {
        "pattern_dn": np.array([[1.0, 2.0], [3.0, 4.0]]),
        "column_dn": np.empty(0),
        "row_dn": np.empty(0),
        "origin_yx": (0, 0),
    }
    return BlackTags(**options | changes)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(top=st.integers(0, 9), left=st.integers(0, 9), origin=st.tuples(st.integers(0, 5), st.integers(0, 5)))
def test_a_window_has_the_levels_of_its_own_pixels(top: int, left: int, origin: tuple[int, int]) -> None:
    """Against the rule of the specification, pixel by pixel."""
    rows, columns = np.arange(20) * 10.0, np.arange(30) * 1000.0
    tags = black(column_dn=columns, row_dn=rows, origin_yx=origin)
    got = tags.over(top, left, 6, 7)
    for y in range(6):
        for x in range(7):
            v, u = top + y - origin[0], left + x - origin[1]
            expected = tags.pattern_dn[v % 2, u % 2] + rows[min(max(v, 0), 19)] + columns[min(max(u, 0), 29)]
            assert got[y, x] == expected


def test_without_further_levels_the_pattern_alone_is_enough() -> None:
    np.testing.assert_array_equal(black().over(1, 0, 100, 100), [[3.0, 4.0], [1.0, 2.0]])
    np.testing.assert_array_equal(black(origin_yx=(0, 1)).over(0, 0, 100, 100), [[2.0, 1.0], [4.0, 3.0]])


@pytest.mark.parametrize("levels", [(100, 200, 300), (100, 200, 300, 400, 500)])
def test_levels_that_do_not_fit_their_pattern_are_left_to_libraw(
    tmp_path: Path, write_dng: Callable[..., Path], levels: tuple[int, ...]
) -> None:
    assert read_tags(write_dng(tmp_path / "a.dng", VALUES, black=levels, black_repeat=(2, 2))).black is None


def test_a_tiff_has_as_many_bytes_as_its_pixels_take(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    tifffile.imwrite(path, VALUES)
    [directory] = read_directories(path)
    check_pixel_bytes(path, directory)
    tifffile.imwrite(path, VALUES, rowsperstrip=8)
    data = bytearray(path.read_bytes())
    place = data.find(np.array([8 * 64 * 2] * 6, "<u2").tobytes())
    if place < 0:
        place = data.find(np.array([8 * 64 * 2] * 6, "<u4").tobytes())
    assert place > 0
    data[place] = data[place + 1] = 0
    path.write_bytes(bytes(data))
    with pytest.raises(DataError, match="StripByteCounts is absent or 0"):
        check_pixel_bytes(path, read_directories(path)[0])
