from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.errors import DataError, UsageError
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.network import Pose
from labdaemon.geometry.oriented_camera import rotation_from_vector
from labdaemon.imaging.codes import dictionary
from labdaemon.imaging.rings import code_book
from labdaemon.processing.boards import BoardImage, CharucoBoard
from labdaemon.processing.calibration import board_files, calibrate, find_weaknesses, read_board

LENS = Lens((960, 640), (1000.0, 1002.0), (484.0, 316.0), (-0.12, 0.08, 4e-4, -3e-4, 0.0))
BOARD = CharucoBoard(9, 6)


def poses(count: int, *, rolled: bool = True, tilted: bool = True, distance: float = 7.5) -> list[Pose]:
    """Cameras around a board of 9 × 6 squares in the plane z = 0, z away from the cameras."""
    result = []
    for k in range(count):
        roll = (k % 4) * np.pi / 2 if rolled else 0.02 * k
        tilt = np.array([0.55 * np.cos(2.1 * k), 0.55 * np.sin(2.1 * k), 0.0]) * (1 if tilted else 0.1)
        rotation = rotation_from_vector(np.array([0, 0, roll])) @ rotation_from_vector(tilt)
        across, along = ((1, 1), (1, -1), (-1, 1), (-1, -1))[(k + k // 4) % 4]
        aim = np.array([4.5 + 1.6 * across, 3.0 + 1.1 * along, 0.0])
        result.append(Pose(rotation, aim - rotation.T @ np.array([0.0, 0.0, distance])))
    return result


def board_numbers(count: int, sd: float = 0.05, **kind: bool) -> tuple[list[BoardImage], list[Pose]]:
    """What an ideal detector would report of the inner corners."""
    rng = np.random.default_rng(5)
    places = np.array([[x, y] for y in range(1, 6) for x in range(1, 9)], dtype=float)
    places = np.concatenate([places, places + np.array([0.5, 0.5])])
    pictures, cameras = [], poses(count, **kind)
    for k, pose in enumerate(cameras):
        local = (np.column_stack([places, np.zeros(len(places))]) - pose.position) @ pose.rotation.T
        pixels = LENS.distort(local[:, :2] / local[:, 2:]) + rng.normal(0, sd, (len(places), 2))
        seen = np.flatnonzero(LENS.contains(pixels))
        names = tuple(f"{i}" for i in seen)
        pictures.append(
            BoardImage(Path(f"{k}.png"), (960, 640), "", names, pixels[seen], places[seen], np.zeros(len(seen)))
        )
    return pictures, cameras


@cache
def sub_pixel_rays() -> np.ndarray:
    """(n, 3) rays of the quarters of all pixels, in camera axes."""
    u, v = np.meshgrid(np.arange(1920) / 2 - 0.25, np.arange(1280) / 2 - 0.25)
    slopes = LENS.undistort(np.column_stack([u.ravel(), v.ravel()]))
    return np.column_stack([slopes, np.ones(len(slopes))])


def charuco_print() -> np.ndarray:
    """The ChArUco board, 200 pixels a square, with a white margin of one square."""
    pattern = cv2.aruco.CharucoBoard((9, 6), 1.0, 0.75, dictionary("aruco-4x4-100"))
    printed = pattern.generateImage((1800, 1200), marginSize=0, borderBits=1).astype(np.float32) / 255
    return cv2.copyMakeBorder(printed, 200, 200, 200, 200, cv2.BORDER_CONSTANT, value=1.0)


def ring_print() -> np.ndarray:
    """A sheet of 9 × 6 conventional ring codes, one a step, drawn from the code book alone."""
    printed = np.full((1600, 2200), 255, np.uint8)
    radius = 26
    for place, code in enumerate(code_book(12)[:54]):
        x, y = 300 + 200 * (place % 9), 300 + 200 * (place // 9)
        for bit in range(12):
            if code >> (11 - bit) & 1:
                cv2.ellipse(printed, (x, y), (3 * radius, 3 * radius), 0, 30 * bit, 30 * bit + 30, 0, -1, cv2.LINE_AA)
        cv2.circle(printed, (x, y), 2 * radius, 255, -1, cv2.LINE_AA)
        cv2.circle(printed, (x, y), radius, 0, -1, cv2.LINE_AA)
    return printed.astype(np.float32) / 255


def render(pose: Pose, printed: np.ndarray) -> np.ndarray:
    """A photograph of a board: 16-bit linear grey, every pixel a mean of 2 × 2 rays."""
    rays = sub_pixel_rays() @ pose.rotation
    at = pose.position + rays * (-pose.position[2] / rays[:, 2])[:, None]
    places = (at[:, :2] * 200 + 200 - 0.5).astype(np.float32).reshape(1280, 1920, 2)
    seen = cv2.remap(printed, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.35)
    linear = seen.reshape(640, 2, 960, 2).mean(axis=(1, 3))
    noise = np.random.default_rng(1).normal(0, 0.004, linear.shape)
    return np.clip((0.08 + 0.8 * linear + noise) * 60000, 0, 65535).astype(np.uint16)


@pytest.fixture(scope="session")
def charuco_folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    for k, pose in enumerate(poses(12)):
        cv2.imwrite(str(folder / f"B{k:02d}.png"), render(pose, charuco_print()))
    return folder


def test_the_lens_comes_back_with_true_standard_deviations() -> None:
    pictures, _ = board_numbers(14)
    result = calibrate(pictures)
    pulls = (result.lens.parameters - LENS.parameters) / result.sd
    assert np.all(np.abs(pulls) < 3.5), pulls
    assert result.sigma0_px == pytest.approx(0.05, rel=0.06)
    assert result.left_out == ()


def test_a_board_that_is_neither_flat_nor_true_does_no_harm() -> None:
    """The board is adjusted with the lens: a sheet bent by a tenth of a square leaves the residuals at noise."""
    pictures, cameras = board_numbers(14)
    rng = np.random.default_rng(3)
    bent = []
    for picture, pose in zip(pictures, cameras, strict=True):
        x, y = picture.board.T
        board = np.column_stack([x * 1.003, y + 0.01 * np.sin(x), 0.1 * np.sin(0.6 * x)])
        local = (board - pose.position) @ pose.rotation.T
        pixels = LENS.distort(local[:, :2] / local[:, 2:])
        bent.append(replace(picture, image_px=pixels + rng.normal(0, 0.05, pixels.shape)))
    result = calibrate(bent)
    assert result.sigma0_px == pytest.approx(0.05, rel=0.1)
    pulls = (result.lens.parameters - LENS.parameters) / result.sd
    assert np.all(np.abs(pulls) < 4), pulls


def test_a_misread_corner_is_named() -> None:
    pictures, _ = board_numbers(12)
    pixels = pictures[3].image_px.copy()
    pixels[7] += [1.5, 1.0]
    pictures[3] = replace(pictures[3], image_px=pixels)
    result = calibrate(pictures)
    assert len(result.left_out) == 1
    assert result.left_out[0].startswith(f"3.png: point {pictures[3].names[7]} left out")


@pytest.mark.slow
def test_a_charuco_board_from_its_photographs(charuco_folder: Path) -> None:
    pictures, notes = read_board(board_files(charuco_folder), BOARD)
    assert len(pictures) == 12
    assert notes == []
    result = calibrate(pictures, notes)
    assert result.sigma0_px < 0.1
    x, y = np.meshgrid(np.linspace(20, 940, 12), np.linspace(20, 620, 9))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    apart = result.lens.distort(LENS.undistort(pixels)) - pixels
    pulls = np.abs(result.lens.parameters - LENS.parameters) / result.sd
    assert np.all(pulls < 5), pulls
    assert np.abs(apart).max() < 2.0


@pytest.mark.slow
def test_a_sheet_of_rings_from_its_photographs(tmp_path: Path) -> None:
    """What `labdaemon targets --kind rings` prints serves as a board: every node is a coded ring."""
    for k, pose in enumerate(poses(8, distance=9.0)):
        cv2.imwrite(str(tmp_path / f"R{k:02d}.png"), render(pose, ring_print()))
    pictures, notes = read_board(board_files(tmp_path))
    assert len(pictures) >= 8
    result = calibrate(pictures, notes)
    assert result.sigma0_px < 0.1
    pulls = np.abs(result.lens.parameters - LENS.parameters) / result.sd
    assert np.all(pulls < 5), pulls


@pytest.mark.slow
def test_camcal_from_our_own_detection(shared_data: Path) -> None:
    """Dots and rings found in the 21 photographs give a smaller sigma0 than the program's own points did."""
    files = board_files(shared_data / "camcal/images")
    pictures, notes = read_board(files, jpeg=True)
    assert len(pictures) == 21
    assert notes == []
    assert len({name for picture in pictures for name in picture.names}) == 100
    result = calibrate(pictures, notes)
    assert result.sigma0_px <= 0.2
    assert result.degrees_of_freedom > 3600
    assert len(result.left_out) < 20
    assert result.warnings == ()
    # The published camera constant, 7.457 mm with pixels of 5.43764/1704 mm, is 2336.8 px.
    assert result.lens.focal_px[1] == pytest.approx(7.457 / (5.43764 / 1704), abs=2.0)


class TestWeakSets:
    def sd(self) -> np.ndarray:
        return np.full(9, 1e-3)

    def pixels(self) -> np.ndarray:
        x, y = np.meshgrid(np.linspace(5, 955, 20), np.linspace(5, 635, 20))
        return np.column_stack([x.ravel(), y.ravel()])

    def test_a_good_set_has_none(self) -> None:
        assert find_weaknesses(LENS, self.sd(), poses(12), self.pixels()) == []

    def test_too_few(self) -> None:
        assert "only 5 photographs" in find_weaknesses(LENS, self.sd(), poses(5), self.pixels())[0]

    def test_no_rolled_views(self) -> None:
        found = find_weaknesses(LENS, self.sd(), poses(12, rolled=False), self.pixels())
        assert [line[:15] for line in found] == ["no rolled views"]

    def test_no_tilted_views(self) -> None:
        found = find_weaknesses(LENS, self.sd(), poses(12, tilted=False), self.pixels())
        assert len(found) == 1
        assert "tilt the board" in found[0]

    def test_uncovered_corners(self) -> None:
        pixels = self.pixels()
        pixels = pixels[~((pixels[:, 0] > 700) & (pixels[:, 1] < 200))]
        found = find_weaknesses(LENS, self.sd(), poses(12), pixels)
        assert [line.split(" corner")[0] for line in found] == ["no point in the top-right"]

    def test_a_lens_that_is_hardly_known(self) -> None:
        sd = self.sd()
        sd[0] = 5.0
        assert "add photographs" in find_weaknesses(LENS, sd, poses(12), self.pixels())[0]


class TestBadInput:
    def test_no_folder_and_an_empty_one(self, tmp_path: Path) -> None:
        with pytest.raises(DataError, match="no such folder"):
            board_files(tmp_path / "nowhere")
        with pytest.raises(DataError, match="holds 0 photographs"):
            board_files(tmp_path)

    def test_a_jpeg_in_place_of_a_raw(self, tmp_path: Path) -> None:
        for k in range(4):
            cv2.imwrite(str(tmp_path / f"{k}.jpg"), np.full((60, 80), 200, np.uint8))
        with pytest.raises(DataError, match=r"0\.jpg: is a JPEG, whose frame is another one"):
            read_board(board_files(tmp_path))

    @pytest.mark.slow
    def test_frames_of_two_sizes(self, charuco_folder: Path, tmp_path: Path) -> None:
        for k in range(5):
            picture = cv2.imread(str(charuco_folder / f"B{k:02d}.png"), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(tmp_path / f"{k}.png"), picture if k != 3 else picture[:-20])
        with pytest.raises(DataError, match=r"3\.png: is 960 × 620 px, 0\.png is 960 × 640 px"):
            read_board(board_files(tmp_path), BOARD)

    def test_photographs_of_something_else(self, tmp_path: Path) -> None:
        for k in range(4):
            cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((300, 400), 40000, np.uint16))
        with pytest.raises(DataError, match="recognised in 0 of 4"):
            read_board(board_files(tmp_path), BOARD)
        with pytest.raises(DataError, match="no sheet of dots with coded rings"):
            read_board(board_files(tmp_path))

    @pytest.mark.parametrize("text", ["9", "9x", "2x5", "axb", "9x6x3"])
    def test_a_board_that_is_none(self, text: str) -> None:
        with pytest.raises(UsageError, match="squares across and down"):
            CharucoBoard.parse(text, 0.75, "aruco-4x4-100")

    def test_a_marker_larger_than_its_square(self) -> None:
        with pytest.raises(UsageError, match="parts of a square"):
            CharucoBoard.parse("9x6", 22.0, "aruco-4x4-100")

    def test_pictures_that_say_nothing_of_the_lens(self) -> None:
        pictures, _ = board_numbers(4)
        same = [replace(pictures[0], file=Path(f"{k}.png")) for k in range(4)]
        with pytest.raises(DataError, match=r"do not determine|no lens explains|did not converge|parallel rays"):
            calibrate(same)
