from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.errors import DataError, UsageError
from labdaemon.imaging.codes import by_name, centre_of, dictionary, families, find_tags
from labdaemon.imaging.frame import RawFrame
from labdaemon.imaging.raw import read_frame

RGGB = np.array([[0, 1], [3, 2]], dtype=np.uint8)
GAINS = np.array([0.55, 1.0, 0.72, 0.97])
SUB = 6


@dataclass(frozen=True)
class View:
    """A camera that sees a card of tags in the plane z = 0 of the card: where its points appear, and the reverse."""

    focal: float
    centre: tuple[float, float]
    rotation: np.ndarray
    translation: np.ndarray
    distortion: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        return np.array([[self.focal, 0, self.centre[0]], [0, self.focal, self.centre[1]], [0, 0, 1.0]])

    def project(self, plane: np.ndarray) -> np.ndarray:
        points = np.column_stack([plane, np.zeros(len(plane))])
        rvec, _ = cv2.Rodrigues(self.rotation)
        return cv2.projectPoints(points, rvec, self.translation, self.matrix, self.distortion)[0].reshape(-1, 2)

    def plane(self, pixels: np.ndarray) -> np.ndarray:
        rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, self.distortion).reshape(-1, 2)
        homography = np.column_stack([self.rotation[:, :2], self.translation])
        back = np.linalg.inv(homography) @ np.column_stack([rays, np.ones(len(rays))]).T
        return (back[:2] / back[2]).T


def look(rng: np.random.Generator, size: tuple[int, int], distance: float = 1000.0, tilt: float = 35.0) -> View:
    angles = np.radians([rng.uniform(-tilt, tilt), rng.uniform(-tilt, tilt), rng.uniform(-180, 180)])
    rotation = cv2.Rodrigues(np.array([0, 0, angles[2]]))[0] @ cv2.Rodrigues(np.array([angles[0], angles[1], 0]))[0]
    offset = rng.uniform(-15, 15, 2)
    return View(
        focal=1900.0,
        centre=(size[0] / 2 + 3.3, size[1] / 2 - 2.1),
        rotation=rotation,
        translation=np.array([*offset, distance]),
        distortion=np.array([-0.09, 0.07, 0.0003, -0.0002, 0.0]),
    )


def reflectance(plane: np.ndarray, tags: dict[tuple[float, float], int], side: float, family: str) -> np.ndarray:
    """White cards on grey, tags on them; plane (n, 2), y downwards like the tags' own rows."""
    value = np.full(len(plane), 0.3)
    for (x, y), number in tags.items():
        book = dictionary(family)
        cells = book.markerSize + 2
        bits = cv2.aruco.generateImageMarker(book, number, cells)
        local = (plane - [x, y]) / side + 0.5
        value[np.abs(local - 0.5).max(axis=1) < 0.8] = 0.85
        inside = ((local >= 0) & (local < 1)).all(axis=1)
        cell = np.floor(local[inside] * cells).astype(int)
        value[inside] = np.where(bits[cell[:, 1], cell[:, 0]] > 0, 0.85, 0.05)
    return value


def photograph(
    view: View,
    tags: dict[tuple[float, float], int],
    *,
    size: tuple[int, int] = (640, 480),
    side: float = 36.0,
    family: str = "apriltag-36h11",
    seed: int = 0,
    gain: float = 3000.0,
    noise: float = 1.0,
) -> RawFrame:
    """Sampled six by six in each pixel through the lens, blurred, mosaicked with unequal colours, noisy, clipped."""
    w, h = size
    fine = (np.arange(SUB) + 0.5) / SUB - 0.5
    total = np.zeros((h, w))
    yy, xx = np.mgrid[:h, :w].astype(np.float64)
    for dy in fine:
        for dx in fine:
            pixels = np.column_stack([(xx + dx).ravel(), (yy + dy).ravel()])
            total += reflectance(view.plane(pixels), tags, side, family).reshape(h, w)
    light = cv2.GaussianBlur(total / SUB**2, (0, 0), 0.8) * gain
    light *= GAINS[RGGB[yy.astype(int) % 2, xx.astype(int) % 2]] * (1.0 + 0.1 * (xx / w - 0.5))
    rng = np.random.default_rng(seed)
    counts = light + noise * rng.normal(size=light.shape) * np.sqrt(light / 8.5 + 0.8**2)
    return RawFrame(
        path=Path("card.dng"),
        values=np.clip(counts.round(), 0, 4095).astype(np.uint16),
        pattern=RGGB,
        black=np.zeros((1, 1)),
        white_level=4095.0,
    )


def corners_of(x: float, y: float, side: float) -> np.ndarray:
    h = side / 2
    return np.array([[x - h, y - h], [x + h, y - h], [x + h, y + h], [x - h, y + h]])


def centre_error(view: View, corners: np.ndarray, x: float, y: float) -> np.ndarray:
    """Centre from corners with the lens taken off and put on again, less the truth."""
    rays = cv2.undistortPoints(corners.reshape(-1, 1, 2), view.matrix, view.distortion).reshape(-1, 2)
    ray = np.array([[*centre_of(rays), 1.0]])
    centre = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), view.matrix, view.distortion)[0].ravel()
    return np.asarray(centre - view.project(np.array([[x, y]]))[0])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_corners_and_centres_on_the_mosaic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    view = look(rng, (420, 300), distance=rng.uniform(700, 1000))
    tags = {(-32.0, -2.0): 3, (34.0, 3.0): 17}
    found = by_name(find_tags(photograph(view, tags, size=(420, 300), seed=seed)))
    seen = {str(n): place for place, n in tags.items() if inside(view.project(corners_of(*place, 54.0)), (420, 300))}
    assert set(seen) <= set(found) <= {"3", "17"}
    assert seen
    for name, (x, y) in seen.items():
        tag, true = found[name], view.project(corners_of(x, y, 36.0))
        assert tag.measured
        assert np.abs(tag.corners_px - true).max() < 0.08
        assert np.sqrt(np.mean((tag.corners_px - true) ** 2)) < 0.03
        assert np.abs(centre_error(view, tag.corners_px, x, y)).max() < 0.04


def test_stated_standard_deviation_is_true() -> None:
    """Over many noisy tags the centre's error in units of its stated deviation has unit size."""
    pulls = []
    for seed in range(14):
        view = look(np.random.default_rng(seed), (170, 150), tilt=25.0)
        view = View(view.focal, view.centre, view.rotation, np.array([0.0, 0.0, 1000.0]), view.distortion)
        frame = photograph(view, {(0.0, 0.0): seed}, size=(170, 150), seed=seed, noise=6.0)
        (tag,) = find_tags(frame)
        assert tag.measured
        pulls.append(centre_error(view, tag.corners_px, 0.0, 0.0) / tag.sd_px)
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.4


def inside(points: np.ndarray, size: tuple[int, int]) -> bool:
    return bool(points.min() > 5 and points[:, 0].max() < size[0] - 6 and points[:, 1].max() < size[1] - 6)


def test_two_prints_of_one_tag_are_named() -> None:
    view = look(np.random.default_rng(5), (420, 420), tilt=10.0)
    frame = photograph(view, {(-35.0, 0.0): 7, (35.0, 0.0): 7}, size=(420, 420))
    tags = find_tags(frame)
    assert [tag.name for tag in tags] == ["7", "7"]
    with pytest.raises(DataError, match=r"card\.dng: tag 7 is in view twice"):
        by_name(tags, where="card.dng")


@pytest.mark.parametrize("family", ["aruco-4x4-50", "aruco-original", "apriltag-25h9"])
def test_other_families(family: str) -> None:
    view = look(np.random.default_rng(6), (240, 240), tilt=15.0)
    frame = photograph(view, {(0.0, 0.0): 11}, size=(240, 240), family=family)
    (tag,) = find_tags(frame, family)
    assert tag.name == "11"
    assert np.abs(tag.corners_px - view.project(corners_of(0.0, 0.0, 36.0))).max() < 0.08
    assert find_tags(frame) == []


def test_overexposed_paper_still_yields_the_tag() -> None:
    """Red and blue stay below white where green clips, and the edge's dark half is linear in all."""
    view = look(np.random.default_rng(7), (240, 240), tilt=15.0)
    frame = photograph(view, {(0.0, 0.0): 11}, size=(240, 240), gain=6000.0)
    (tag,) = find_tags(frame)
    assert np.abs(tag.corners_px - view.project(corners_of(0.0, 0.0, 36.0))).max() < 0.3


def test_unknown_family_lists_those_there_are() -> None:
    assert {"apriltag-36h11", "apriltag-16h5", "aruco-4x4-50", "aruco-original"} <= set(families())
    with pytest.raises(UsageError, match=r"apriltag-36h11"):
        dictionary("qr")


def test_noise_holds_no_tags() -> None:
    rng = np.random.default_rng(8)
    blocks = np.kron(rng.integers(0, 2, (60, 80)), np.ones((9, 9))) * 2500 + 200
    frame = RawFrame(Path("n.dng"), blocks.astype(np.uint16), RGGB, np.zeros((1, 1)), 4095.0)
    assert find_tags(frame) == []


def test_diagonals_meet_at_the_image_of_the_centre() -> None:
    homography = np.array([[1.2, 0.1, 5.0], [-0.2, 0.9, 7.0], [0.05, -0.03, 1.0]])
    points = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1], [0, 0, 1.0]]) @ homography.T
    places = points[:, :2] / points[:, 2:]
    assert centre_of(places[:4]) == pytest.approx(places[4])


def test_third_party_renderings_hold_the_tags_of_their_survey(shared_data: Path) -> None:
    frame = read_frame(shared_data / "planar_example" / "sharp" / "front.dng")
    tags = find_tags(frame)
    assert [tag.name for tag in tags] == ["0", "1", "2", "3", "4", "5"]
    assert all(tag.measured and tag.sd_px < 0.02 for tag in tags)
