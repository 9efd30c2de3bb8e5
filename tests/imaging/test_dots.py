from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labdaemon.blur.patch.pixels import Dot
from labdaemon.imaging.codes import dictionary
from labdaemon.imaging.dots import find_dots
from labdaemon.imaging.frame import RawFrame
from labdaemon.imaging.raw import read_frame

CELL = 200
KINDS = ["dot"] * 9 + ["text", "square", "hexagon", "dark", "tag", "annulus", "part", "bullet", "bolt", "lines", "code"]


def draw(canvas: Any, kind: str, x0: int, y0: int, rng: np.random.Generator) -> tuple[float, float] | None:
    """One label with something on it; where its centre is, if that is a dot."""
    x, y = x0 + CELL / 2 + rng.uniform(-5, 5), y0 + CELL / 2 + rng.uniform(-5, 5)
    paper, ink = float(rng.uniform(0.65, 0.95)), float(rng.uniform(0.02, 0.1))
    r, angle = float(np.exp(rng.uniform(np.log(6.5), np.log(70.0)))), float(rng.uniform(0, 180))
    canvas.box(x0 + 8, y0 + 8, CELL - 16, CELL - 16, 0.12 if kind == "dark" else paper)
    match kind:
        case "dot":
            canvas.ellipse(x, y, r, max(r * rng.uniform(0.4, 1.0), 4.5), angle, ink)
        case "dark":
            canvas.ellipse(x, y, r, r, 0.0, 0.02)
        case "text":
            for row in range(6):
                words = "".join(rng.choice(list("OoQ08.:;iDBeabdg%&@")) for _ in range(5))
                canvas.text(x0 + 20, y0 + 34 + 28 * row, words, rng.uniform(0.5, 1.0), int(rng.integers(2, 5)), ink)
        case "square" | "hexagon":
            n = 4 if kind == "square" else 6
            turn = np.radians(angle) + np.arange(n) * 2 * np.pi / n
            size = max(r, 12.0)
            canvas.polygon(np.stack([x + size * np.cos(turn), y + size * np.sin(turn)], axis=1), ink)
        case "tag":
            bits = cv2.aruco.generateImageMarker(dictionary("apriltag-36h11"), int(rng.integers(0, 500)), 10)
            cell = rng.uniform(7.0, 15.0)
            for row, column in np.argwhere(bits == 0):
                canvas.box(x + (column - 5) * cell, y + (row - 5) * cell, cell, cell, ink)
        case "annulus":
            canvas.ellipse(x, y, r + 8, r + 8, 0.0, ink)
            canvas.ellipse(x, y, 0.4 * r, 0.4 * r, 0.0, paper)
        case "part":
            canvas.ellipse(x, y, r, r, angle, ink, (0, rng.uniform(180, 330)))
        case "bullet":
            canvas.ellipse(x, y, r, r, 0.0, ink)
            canvas.box(x, y - r, r, 2 * r, ink)
        case "bolt":
            size = max(r, 15.0)
            canvas.ellipse(x, y, size, size, 0.0, 0.12)
            canvas.ellipse(x - 0.3 * size, y - 0.3 * size, 0.4 * size, 0.4 * size, 0.0, 0.35)
        case "lines":
            for row in range(8):
                canvas.box(x0 + 15, y0 + 20 + 20 * row, 160, rng.uniform(1, 10), ink)
        case "code":
            r = min(r, 28.0)
            canvas.ellipse(x, y, 3 * r, 3 * r, 0.0, ink)
            canvas.ellipse(x, y, 2 * r, 2 * r, 0.0, paper)
            for k in np.flatnonzero(rng.random(12) < 0.6):
                canvas.ellipse(x, y, 3.1 * r, 3.1 * r, 0.0, paper, (30 * k, 30 * k + 30))
            canvas.ellipse(x, y, r, r, 0.0, ink)
    return (x, y) if kind in ("dot", "code") else None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_dots_among_clutter_and_nothing_invented(canvas: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sheet = canvas(5 * CELL, 4 * CELL)
    kinds = list(rng.permutation(KINDS))
    places = [(x, y) for y in range(0, 4 * CELL, CELL) for x in range(0, 5 * CELL, CELL)]
    made = [draw(sheet, kind, x, y, rng) for kind, (x, y) in zip(kinds, places, strict=True)]
    truth = np.array([place for place in made if place is not None])
    grey = sheet.develop(rng, blur_px=float(rng.uniform(0.6, 1.3)))
    dots = find_dots(grey)
    found = np.array([(d.x_px, d.y_px) for d in dots])
    distance = np.hypot(*(truth[:, None] - found[None]).transpose(2, 0, 1))
    assert distance.min(axis=1).max() < 0.12, "a dot is missing or misplaced"
    assert len(found) == len(truth), "something else was called a dot"


@pytest.mark.parametrize("diameter", [12, 21, 50, 110, 198])
@pytest.mark.parametrize("ratio", [1.0, 0.5])
def test_every_size_is_found_to_a_tenth_of_a_pixel(canvas: Any, diameter: int, ratio: float) -> None:
    rng = np.random.default_rng(diameter)
    size = 3 * diameter + 80
    sheet = canvas(size, size, ground=0.8)
    x, y, angle = size / 2 + 0.3, size / 2 - 0.4, 35.0
    sheet.ellipse(x, y, diameter / 2, ratio * diameter / 2, angle, 0.05)
    (dot,) = find_dots(sheet.develop(rng, hot=20))
    assert np.hypot(dot.x_px - x, dot.y_px - y) < 0.1
    assert dot.semi_major_px == pytest.approx(diameter / 2, abs=0.25)
    assert dot.semi_minor_px == pytest.approx(ratio * diameter / 2, abs=0.25)
    if ratio < 1.0:
        assert np.degrees(dot.angle_rad) == pytest.approx(angle, abs=2.0)


def test_paper_is_measured_to_its_nearest_edge(canvas: Any) -> None:
    rng = np.random.default_rng(5)
    sheet = canvas(500, 400, ground=0.2)
    sheet.box(100, 80, 300, 240, 0.85)
    sheet.ellipse(230, 180, 14, 14, 0, 0.04)
    (dot,) = find_dots(sheet.develop(rng))
    assert dot.paper_px == pytest.approx(100.0, abs=3.0)


def test_another_dot_ends_the_paper(canvas: Any) -> None:
    sheet = canvas(500, 400, ground=0.85)
    sheet.ellipse(200, 200, 14, 14, 0, 0.04)
    sheet.ellipse(290, 200, 14, 14, 0, 0.04)
    dots = find_dots(sheet.develop(np.random.default_rng(6)))
    assert [d.paper_px for d in dots] == pytest.approx([76.0, 76.0], abs=3.0)


def test_a_crease_in_the_label_is_not_its_edge(canvas: Any) -> None:
    sheet = canvas(300, 300, ground=0.1)
    sheet.box(90, 90, 120, 120, 0.9)
    sheet.box(90, 90, 120, 48, 0.62)
    sheet.ellipse(150, 150, 16, 16, 0, 0.04)
    (dot,) = find_dots(sheet.develop(np.random.default_rng(7)))
    assert dot.paper_px == pytest.approx(60.0, abs=4.0)


def test_nothing_is_found_where_nothing_is() -> None:
    rng = np.random.default_rng(8)
    for level in (0.0, 0.5, 1.0):
        flat = np.clip(level + 0.02 * rng.normal(size=(300, 400)), 0, 1).astype(np.float32)
        assert find_dots(flat) == []
    assert find_dots(np.full((300, 400), np.nan, dtype=np.float32)) == []


def test_dots_within_excluded_polygons_are_left_out(canvas: Any) -> None:
    sheet = canvas(300, 200, ground=0.85)
    sheet.ellipse(80, 100, 14, 14, 0, 0.04)
    sheet.ellipse(220, 100, 14, 14, 0, 0.04)
    grey = sheet.develop(np.random.default_rng(9))
    around = np.array([[50.0, 70.0], [110.0, 70.0], [110.0, 130.0], [50.0, 130.0]])
    (dot,) = find_dots(grey, exclude=[around])
    assert dot.x_px > 150


def test_real_labels_all_found_and_nothing_else(shared_data: Path) -> None:
    dots = find_dots(read_frame(shared_data / "real_frame" / "sharp.png"))
    with (shared_data / "real_frame" / "truth.csv").open() as stream:
        rest = np.array([(float(row["rest_x_px"]), float(row["rest_y_px"])) for row in csv.DictReader(stream)])
    found = np.array([(d.x_px, d.y_px) for d in dots])
    assert len(found) == len(rest) == 28
    # The table's centres are grey-value centroids on unevenly lit labels, so they differ by up to two pixels.
    assert np.hypot(*(rest[:, None] - found[None]).transpose(2, 0, 1)).min(axis=1).max() < 2.0
    # One label is folded next to its dot: the fold counts as its end.
    assert sorted(d.paper_px for d in dots)[1] > 15.0
    assert all(12.0 < d.paper_px < 40.0 for d in dots)


@pytest.mark.parametrize(("folder", "count"), [("planar_example/sharp/front", 25), ("stereo_example/sharp/left", 12)])
def test_third_party_renderings(shared_data: Path, folder: str, count: int) -> None:
    assert len(find_dots(read_frame(shared_data / f"{folder}.dng"))) == count


def published_points(data: Path) -> dict[int, np.ndarray]:
    """PhotoModeler's points of each photograph, moved to pixel centres at integers."""
    points: dict[int, list[tuple[float, float]]] = {}
    for line in (data / "camcal" / "camcal-pmexport.txt").read_text().splitlines()[130:]:
        words = line.split()
        if len(words) == 6 and words[0].isdigit() and words[1].isdigit() and int(words[0]) < 21:
            points.setdefault(int(words[0]), []).append((float(words[2]) - 0.5, float(words[3]) - 0.5))
    return {photo: np.array(place) for photo, place in points.items()}


@pytest.mark.slow
def test_photographs_of_a_dot_sheet_against_a_published_measurement(shared_data: Path) -> None:
    """Another program's 2074 points in 21 photographs (here every third one): found, none invented, centres alike."""
    differences, published, invented = [], 0, 0
    everything = published_points(shared_data)
    assert sum(len(points) for points in everything.values()) == 2074
    for photo, points in list(everything.items())[::3]:
        file = shared_data / "camcal" / "images" / f"P82500{21 + photo}.JPG"
        grey = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255) ** np.float32(2.2)
        found = np.array([(d.x_px, d.y_px) for d in find_dots(grey)])
        offset = points[:, None] - found[None]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        near = distance.min(axis=1) < 1.0
        differences.append(offset[np.arange(len(points)), distance.argmin(axis=1)][near])
        published += len(points)
        invented += int((distance.min(axis=0) > 3.0).sum())
    every = np.concatenate(differences)
    assert len(every) >= published - 1
    assert invented == 0
    assert every.std(axis=0).max() < 0.15


def test_a_dot_has_no_name_yet(canvas: Any) -> None:
    sheet = canvas(200, 200, ground=0.85)
    sheet.ellipse(100, 100, 14, 14, 0, 0.04)
    (dot,) = find_dots(sheet.develop(np.random.default_rng(10)))
    assert isinstance(dot, Dot)
    assert dot.name == ""


@pytest.mark.parametrize("exposure", [0.01, 0.1, 1.6])
def test_under_and_overexposed_frames(canvas: Any, exposure: float) -> None:
    rng = np.random.default_rng(11)
    sheet = canvas(700, 300, ground=0.25)
    places = [(x, 150.0) for x in (90.0, 270.0, 450.0, 630.0)]
    for k, (x, y) in enumerate(places):
        sheet.box(x - 60, y - 60, 120, 120, 0.85)
        sheet.ellipse(x, y, 8 + 4 * k, 7 + 4 * k, 20.0, 0.06)
    light = sheet.develop(rng, noise=0.0, hot=0) * exposure
    counts = light * 4000 + rng.normal(size=light.shape) * np.sqrt(light * 4000 / 8.5 + 0.7)
    dots = find_dots(np.clip(counts / 4000, 0, 1).astype(np.float32))
    assert [d.x_px for d in sorted(dots, key=lambda d: d.x_px)] == pytest.approx([x for x, _ in places], abs=0.35)


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_noise_is_neither_dot_nor_hides_one(canvas: Any, noise: float) -> None:
    sheet = canvas(400, 300, ground=0.8)
    sheet.ellipse(120, 150, 9, 8, 0, 0.05)
    sheet.ellipse(280, 150, 30, 22, 40, 0.05)
    dots = find_dots(sheet.develop(np.random.default_rng(12), noise=noise, hot=200))
    assert len(dots) == 2


def test_a_hot_pixel_in_a_dot_does_not_hide_it(canvas: Any) -> None:
    sheet = canvas(300, 200, ground=0.85)
    sheet.ellipse(150, 100, 8, 8, 0, 0.05)
    rng = np.random.default_rng(13)
    light = sheet.develop(rng, hot=0)
    pattern = np.array([[0, 1], [3, 2]], dtype=np.uint8)
    for place in [(100, 150), (98, 147), (103, 155)]:
        values = (light * 4000).round().astype(np.uint16)
        values[place] = 4095
        frame = RawFrame(Path("a.dng"), values, pattern, np.zeros((1, 1)), 4095.0)
        (dot,) = find_dots(frame)
        assert np.hypot(dot.x_px - 150, dot.y_px - 100) < 0.15
