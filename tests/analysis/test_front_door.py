"""`import labdaemon as ld`: paths, frames and arrays give the same motions as the command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import labdaemon as ld
from labdaemon.errors import DataError, UsageError

CENTRES = np.array([(60.3, 58.2), (180.7, 61.1), (62.2, 170.4), (181.5, 169.6)])
MOTION = np.array([(3.0, 0.0), (0.0, 5.0), (2.0, 2.0), (6.0, -1.0)])


def image(motion: np.ndarray, seed: int) -> np.ndarray:
    """Four dots of radius 9 px on white paper, 16-bit grey, summed over instants of the motion."""
    rng = np.random.default_rng(seed)
    dark = np.zeros((230 * 4, 240 * 4), np.float32)
    instants = (np.arange(64) + 0.5) * np.pi / 64
    for centre, a in zip(CENTRES, motion, strict=True):
        for instant in instants if a.any() else [np.pi / 2]:
            x, y = (centre + a * np.cos(instant) + 0.5) * 4 - 0.5
            disc = np.zeros_like(dark)
            cv2.circle(disc, (round(x * 64), round(y * 64)), 36 * 64, 1.0, -1, cv2.LINE_8, 6)
            dark += disc / (len(instants) if a.any() else 1)
    dark = cv2.resize(cv2.GaussianBlur(dark, (0, 0), 3.2), (240, 230), interpolation=cv2.INTER_AREA)
    light = 30000 * (1 - 0.9 * dark)
    light += rng.normal(0, 1, light.shape) * np.sqrt(400 + 6.0 * light)
    return np.clip(light, 0, 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def arrays() -> tuple[np.ndarray, np.ndarray]:
    return image(np.zeros((4, 2)), 1), image(MOTION, 2)


@pytest.fixture(scope="module")
def files(arrays: tuple[np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("frames")
    for name, values in zip(("sharp", "run 7"), arrays, strict=True):
        assert cv2.imwrite(str(folder / f"{name}.png"), values)
    return folder / "sharp.png", folder / "run 7.png"


def test_paths_give_named_measurements(files: tuple[Path, Path]) -> None:
    motion = ld.measure(*files)
    assert [one.target for one in motion] == ["T01", "T02", "T03", "T04"]
    for one, truth in zip(motion, MOTION, strict=True):
        assert one.amplitude_px == pytest.approx(np.hypot(*truth), abs=0.1)
        assert 0 < one.sd_px < 0.1
        assert not one.flags
    assert motion["T02"].a_px[1] == pytest.approx(5.0, abs=0.1)
    assert "T02: 5.0" in repr(motion["T02"])
    assert "4 targets, 4 without flags" in repr(motion)
    with pytest.raises(KeyError, match="T99"):
        motion["T99"]


def test_arrays_and_frames_give_the_same_numbers_as_files(
    arrays: tuple[np.ndarray, np.ndarray], files: tuple[Path, Path]
) -> None:
    by_file = ld.measure(*files)
    by_array = ld.measure(*arrays)
    by_frame = ld.measure(ld.read_frame(files[0]), ld.read_frame(files[1]))
    for one in (by_array, by_frame):
        assert [m.a_px.tolist() for m in one] == [m.a_px.tolist() for m in by_file]


def test_the_command_writes_the_same_rows(files: tuple[Path, Path]) -> None:
    command = [sys.executable, "-m", "labdaemon", "measure", "--sharp", str(files[0]), str(files[1])]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == ld.measure(*files).to_csv()


def test_patches_and_several_sharp_images(arrays: tuple[np.ndarray, np.ndarray]) -> None:
    box = (int(CENTRES[0, 0]) - 20, int(CENTRES[0, 1]) - 20, 40, 40)
    motion = ld.measure([arrays[0], image(np.zeros((4, 2)), 3)], arrays[1], patches=[box])
    assert [one.target for one in motion] == ["P01"]
    assert motion[0].amplitude_px == pytest.approx(3.0, abs=0.15)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((100, 100, 3), np.uint8), "colour image"),
        (np.zeros((100, 100)), "white level"),
        (np.zeros(100, np.uint16), "no image"),
        (np.zeros((100, 100), bool), "no light"),
        (np.zeros((4, 100), np.uint16), "no image"),
        (np.full((100, 100), np.nan), "not finite"),
        (3.0, "no frame"),
        ([], "no frame"),
    ],
)
def test_unusable_arrays_are_refused_with_what_is_missing(values: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ld.measure(values, np.zeros((100, 100), np.uint16))  # type: ignore[arg-type]


def test_images_of_two_sizes_and_groups_without_windows_are_refused(arrays: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(UsageError, match="240x230"):
        ld.measure(arrays[0], arrays[1][:200])
    with pytest.raises(UsageError, match="one window for each"):
        ld.measure(arrays[0], [arrays[1], arrays[1]])
    with pytest.raises(UsageError, match="need 1 windows, not 2"):
        ld.measure(arrays[0], arrays[1], window=[ld.ExposureWindow(5.0, 1.0), ld.ExposureWindow(5.0, 1.0)])
    with pytest.raises(UsageError, match="bayer is one of"):
        ld.frame_from_array(arrays[0], bayer="XTRANS")
    with pytest.raises(DataError, match="no dots"):
        ld.measure(np.full((100, 100), 30000, np.uint16), np.full((100, 100), 30000, np.uint16))


def test_dataframe_has_the_columns_of_the_file(files: tuple[Path, Path]) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    table = ld.measure(*files).to_dataframe()
    assert list(table["target"]) == ["T01", "T02", "T03", "T04"]
    assert table["amplitude_px"].to_numpy() == pytest.approx(np.hypot(*MOTION.T), abs=0.1)
    assert list(table["flags"]) == [""] * 4


def test_importing_the_package_is_light() -> None:
    code = "import labdaemon, sys; print([m for m in ('numpy', 'cv2', 'scipy', 'zmq') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert {"measure", "process", "Client", "Flag", "errors"} <= set(dir(ld))
    with pytest.raises(AttributeError, match="no attribute 'mesure'"):
        ld.mesure  # noqa: B018
