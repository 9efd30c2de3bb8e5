from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from labdaemon.errors import DataError
from labdaemon.imaging.raw import read_frame

Writer = Callable[..., Path]
LAYOUTS = {"RGGB": (0, 1, 1, 2), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1), "GBRG": (1, 2, 0, 1)}


def counts(height: int = 60, width: int = 80, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 4095, (height, width)).astype(np.uint16)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("size", [(60, 80), (61, 79)])
def test_every_bayer_layout_keeps_its_colours_apart(
    tmp_path: Path, write_dng: Writer, layout: str, size: tuple[int, int]
) -> None:
    values = counts(*size)
    frame = read_frame(write_dng(tmp_path / "a.dng", values, cfa=LAYOUTS[layout]))
    assert frame.size == (size[1], size[0])
    np.testing.assert_array_equal(frame.values, values)
    colours = np.array(LAYOUTS[layout]).reshape(2, 2)
    # The two greens are channels of their own; red and blue are the same two everywhere.
    for channel in range(4):
        assert (frame.pattern == channel).sum() == 1
    assert set(frame.pattern[colours == 0]) == {0}
    assert set(frame.pattern[colours == 2]) == {2}


@pytest.mark.parametrize("corner", [(0, 0), (1, 3), (2, 4), (3, 2)])
def test_black_pattern_and_colours_follow_the_active_area(
    tmp_path: Path, write_dng: Writer, corner: tuple[int, int]
) -> None:
    """The specification counts both from the active area's corner, odd or not, wherever the visible area begins."""
    top, left = corner
    values = np.full((64, 90), 500, dtype=np.uint16)
    yy, xx = np.mgrid[:64, :90]
    black = np.array([[10, 20], [30, 40]])
    values += black[(yy - top) % 2, (xx - left) % 2].astype(np.uint16)
    path = write_dng(
        tmp_path / "a.dng", values, active=(top, left, 64, 90), black=(10, 20, 30, 40), black_repeat=(2, 2)
    )
    frame = read_frame(path)
    assert set(np.unique(frame.whole().values)) == {500.0}
    # Red is where the pattern's 10 is subtracted.
    assert frame.black[frame.pattern == 0] == 10
    assert frame.black[frame.pattern == 2] == 40


def test_black_levels_of_rows_columns_and_larger_patterns(tmp_path: Path, write_dng: Writer) -> None:
    yy, xx = np.mgrid[:60, :80]
    rng = np.random.default_rng(3)
    rows, columns, cell = rng.integers(0, 9, 60), rng.integers(0, 9, 80), rng.integers(50, 99, (4, 4))
    values = (1000 + cell[yy % 4, xx % 4] + rows[:, None] + columns).astype(np.uint16)
    path = write_dng(
        tmp_path / "a.dng",
        values,
        black=tuple(int(v) for v in cell.ravel()),
        black_repeat=(4, 4),
        delta_v=rows,
        delta_h=columns,
    )
    frame = read_frame(path)
    np.testing.assert_allclose(frame.whole().values, 1000.0)
    np.testing.assert_allclose(frame.patch(-3, 7, 20, 9).values[:, 3:], 1000.0)


def test_monochrome_has_one_channel(tmp_path: Path, write_dng: Writer) -> None:
    values = counts()
    frame = read_frame(write_dng(tmp_path / "m.dng", values, cfa=None, white=16383))
    assert frame.channels == 1
    assert frame.white_level == 16383
    np.testing.assert_array_equal(frame.values, values)


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_pictures_are_taken_as_linear(tmp_path: Path, suffix: str, dtype: type) -> None:
    values = counts().astype(dtype)
    path = tmp_path / f"g.{suffix}"
    if suffix == "png":
        cv2.imwrite(str(path), values)
    else:
        tifffile.imwrite(path, values)
    frame = read_frame(path)
    np.testing.assert_array_equal(frame.values, values)
    assert frame.white_level == np.iinfo(dtype).max
    assert frame.black.sum() == 0


def test_metadata_is_read_where_it_is_cheap(tmp_path: Path, write_dng: Writer) -> None:
    assert read_frame(write_dng(tmp_path / "a.dng", counts(), serial="2601234")).serial == "2601234"


XTRANS = (1, 1, 0, 1, 1, 2, 1, 1, 2, 1, 1, 0, 2, 0, 1, 0, 2, 1, 1, 1, 2, 1, 1, 0, 1, 1, 0, 1, 1, 2, 0, 2, 1, 2, 0, 1)


def bad_file(kind: str, folder: Path, write_dng: Writer) -> Path:
    whole = write_dng(folder / "whole.dng", counts())
    path = folder / f"{kind}.dng"
    data = whole.read_bytes()
    match kind:
        case "missing":
            pass
        case "empty":
            path.write_bytes(b"")
        case "head only":
            path.write_bytes(data[:60])
        case "half":
            path.write_bytes(data[: len(data) // 2])
        case "one byte short":
            path.write_bytes(data[:-1])
        case "text":
            path.write_text("not a picture at all")
        case "jpeg":
            cv2.imwrite(str(folder / "j.jpg"), counts().astype(np.uint8))
            path.write_bytes((folder / "j.jpg").read_bytes())
        case "png cut":
            cv2.imwrite(str(folder / "p.png"), counts())
            path.write_bytes((folder / "p.png").read_bytes()[:-40])
        case "colour image":
            cv2.imwrite(str(folder / "c.png"), np.dstack([counts()] * 3))
            path.write_bytes((folder / "c.png").read_bytes())
        case "float picture":
            tifffile.imwrite(path, counts().astype(np.float32))
        case "X-Trans":
            write_dng(path, counts(), cfa=XTRANS, repeat=(6, 6))
        case "Quad Bayer":
            write_dng(path, counts(), cfa=tuple(np.kron([[0, 1], [1, 2]], np.ones((2, 2), int)).ravel()), repeat=(4, 4))
        case "floating-point DNG":
            write_dng(path, counts().astype(np.float32))
        case "mosaic saved as grey":
            light = 3000 * np.tile([[0.6, 1.0], [1.0, 0.5]], (60, 80)) * np.linspace(0.7, 1, 160)
            tifffile.imwrite(path, np.random.default_rng(1).poisson(light).astype(np.uint16), metadata=None)
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "JPEG XL" | "Nikon":
            write_dng(path, counts())
            data = path.read_bytes()
            place = data.find(struct.pack("<HHI", 259, 3, 1))
            number = struct.pack("<H", {"JPEG XL": 52546, "Nikon": 34713}[kind])
            path.write_bytes(data[: place + 8] + number + data[place + 10 :])
        case "pixel shift":
            write_dng(path, np.dstack([counts()] * 4))
        case "four exposures":
            write_dng(path, counts(), exposures=4)
        case _:
            raise AssertionError(kind)
    return path


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("missing", "no such file"),
        ("empty", "empty"),
        ("head only", "damaged|truncated"),
        ("half", "truncated"),
        ("one byte short", "truncated"),
        ("text", "not a RAW"),
        ("jpeg", "JPEG"),
        ("png cut", "truncated"),
        ("colour image", "colour image"),
        ("float picture", "8 or 16 bits"),
        ("X-Trans", "X-Trans"),
        ("Quad Bayer", "Quad Bayer"),
        ("floating-point DNG", "floating-point"),
        ("mosaic saved as grey", "mosaic of a colour sensor"),
        ("folder", "it is no file"),
        ("pipe", "it is no file"),
        ("JPEG XL", "compressed by JPEG XL"),
        ("Nikon", "High Efficiency"),
        ("pixel shift", "4 values for each pixel"),
        ("four exposures", "4 exposures"),
    ],
)
def test_unusable_files_are_refused_in_one_line_that_names_them(
    tmp_path: Path, write_dng: Writer, capfd: pytest.CaptureFixture[str], kind: str, says: str
) -> None:
    path = bad_file(kind, tmp_path, write_dng)
    with pytest.raises(DataError, match=says) as caught:
        read_frame(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert caught.value.exit_status == 2
    assert capfd.readouterr().err == ""


def test_three_values_a_pixel_are_refused(tmp_path: Path, write_dng: Writer) -> None:
    data = np.dstack([counts()] * 3)
    tifffile.imwrite(
        tmp_path / "f.dng",
        data,
        photometric=34892,
        metadata=None,
        extratags=[(50706, "B", 4, (1, 4, 0, 0), True), (50708, "s", 0, "Test", True), (50717, "I", 1, 4095, True)],
    )
    with pytest.raises(DataError, match="Foveon"):
        read_frame(tmp_path / "f.dng")


def test_another_size_is_refused_with_both(tmp_path: Path, write_dng: Writer) -> None:
    path = write_dng(tmp_path / "a.dng", counts())
    assert read_frame(path, expect_size=(80, 60)).size == (80, 60)
    with pytest.raises(DataError, match=r"80x60.*3872x2592"):
        read_frame(path, expect_size=(3872, 2592))


def test_third_party_raw_file_reads_as_libraw_says(shared_data: Path) -> None:
    frame = read_frame(shared_data / "planar_example" / "sharp" / "front.dng", expect_size=(1936, 1296))
    assert frame.taken_at is not None
    assert frame.channels == 4
    gains = frame.gains()
    assert gains.min() == 1.0
    # Paper is neutral in this rendering up to its white balance: the two greens agree.
    assert gains[1] == pytest.approx(gains[3], rel=0.01)


def test_levels_and_orientation_as_cameras_write_them(tmp_path: Path, write_dng: Writer) -> None:
    """A linearisation table of an 8-bit file is applied, and a camera held upright does not turn the frame."""
    table = (np.arange(256) ** 2 // 16).astype(np.uint16)
    coded = np.searchsorted(table, counts()).clip(0, 255).astype(np.uint8)
    tags = ((50712, "H", 256, table.tolist(), True), (274, "H", 1, 6, True))
    path = write_dng(tmp_path / "f.dng", coded, more=tags)
    np.testing.assert_array_equal(read_frame(path).values, table[coded])
