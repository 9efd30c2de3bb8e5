"""Flagged targets as image, model and difference: true to the frames, few, and the rest counted."""

from __future__ import annotations

import base64
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.processing import CaptureFacts
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, Row, write_csv
from labdaemon.report.flagged_patches import flagged_patches
from labdaemon.report.folder_page import report_folder
from labdaemon.report.target_patch import MAX_SIDE, PathWeights, modelled_patch, patch_strip

SIDE, RADIUS = 96, 9.0
A, B = np.array([7.0, 2.0]), np.array([-0.6, 2.1])


def dot(x: float, y: float, size: tuple[int, int] = (SIDE, SIDE)) -> np.ndarray:
    """A dark dot on white with a soft edge."""
    down, across = np.mgrid[: size[0], : size[1]]
    distance = np.hypot(across - x, down - y)
    return np.asarray(0.9 - 0.8 / (1 + np.exp((distance - RADIUS) / 0.6)))


def blurred(
    x: float, y: float, a: np.ndarray, b: np.ndarray, size: tuple[int, int] = (SIDE, SIDE), phase_rad: float = 0.0
) -> np.ndarray:
    """The dot on its path, by 120 instants of one cycle."""
    angle = phase_rad + 2 * math.pi * (np.arange(120) + 0.5) / 120
    places = np.array([x, y]) + np.outer(np.sin(angle), a) + np.outer(np.cos(angle), b)
    return np.asarray(np.mean([dot(*place, size) for place in places], axis=0))


def test_the_model_is_the_image_where_the_motion_is_right_and_only_there() -> None:
    still, seen = dot(47.0, 48.0), 0.8 * blurred(50.3, 46.6, A, B) + 0.05
    right = np.abs(seen - modelled_patch(still, PathWeights.of(A, B), seen)).max()
    wrong = np.abs(seen - modelled_patch(still, PathWeights.of(1.25 * A, B), seen)).max()
    assert right < 0.03, "less light, and a shift of 3 pixels, are fitted"
    assert wrong > 2.5 * right


def test_light_that_is_on_for_half_a_cycle_moves_the_model_only_there() -> None:
    angle = 2 * math.pi * (np.arange(64) + 0.5) / 64
    path = PathWeights.of(np.array([5.0, 0.0]), np.zeros(2), angle, (angle < math.pi).astype(float))
    assert path.weight @ path.displacement_px == pytest.approx([0.0, 0.0], abs=1e-12)
    lit = path.displacement_px[path.weight > 0]
    assert np.ptp(lit[:, 0]) < 5.1, "the way out alone"


def test_a_drawing_has_three_panels_and_a_grey_difference_where_there_is_none() -> None:
    image = dot(48.0, 48.0)
    strip = patch_strip(image, image)
    assert strip.shape == (MAX_SIDE, 3 * MAX_SIDE + 8)
    assert np.ptp(strip[:, -MAX_SIDE:].astype(int)) == 0
    assert patch_strip(image, None).shape == (MAX_SIDE, MAX_SIDE)


RIG = """
[cameras.left]
image_size = [200, 150]
focal_px = [400.0, 400.0]
principal_point_px = [100.0, 75.0]
[targets]
diameter_mm = 8.0
[control]
family = "apriltag-36h11"
size_mm = 36.0
"""


def pixels(target: str, x: float, y: float, *flags: str, has_numbers: bool = True) -> Row:
    row: Row = dict.fromkeys(MEASUREMENT_COLUMNS)
    row |= {"capture": "c1", "camera": "left", "target": target, "flags": [*flags], "sign": None}
    if has_numbers:
        row |= {"x_px": x, "y_px": y, "ax_px": 7.0, "ay_px": 2.0, "bx_px": -0.6, "by_px": 2.1}
    return row


def in_space(target: str, *flags: str) -> Row:
    return dict.fromkeys(ENVELOPE_COLUMNS) | {"capture": "c1", "target": target, "flags": [*flags]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(RIG)
    points = "".join(f"{k},{20.0 * k},0.0,{30.0 * (k % 2)},0.1\n" for k in range(6))
    (tmp_path / "control.csv").write_text("name,x_mm,y_mm,z_mm,sd_mm\n" + points)
    (tmp_path / "sharp").mkdir()
    (tmp_path / "captures" / "c1").mkdir(parents=True)
    still, moved = dot(60.0, 75.0, (150, 200)), blurred(60.0, 75.0, A, B, (150, 200))
    for name, image in (("sharp/left.png", still), ("captures/c1/left.png", moved)):
        cv2.imwrite(str(tmp_path / name), np.rint(image * 60_000).astype(np.uint16))
    return tmp_path


def test_the_page_shows_a_flagged_target_with_its_remedy(folder: Path) -> None:
    write_csv(folder / "results" / "measurements.csv", MEASUREMENT_COLUMNS, [pixels("T1", 60.0, 75.0, "poor_fit")])
    write_csv(folder / "results" / "envelope.csv", ENVELOPE_COLUMNS, [in_space("T1", "poor_fit")])
    path, _ = report_folder(folder, title="x")
    text = path.read_text()
    assert 'alt="c1 · left · T1: image, model and difference"' in text
    assert "check the frequency, and harmonics" in text


def test_a_flag_that_only_the_cameras_together_have_counts(folder: Path) -> None:
    found = flagged_patches(folder, [pixels("T1", 60.0, 75.0)], {"c1": [in_space("T1", "ambiguous")]}, {})
    assert [(one.name, one.flags, one.has_model) for one in found.patches] == [("c1 · left · T1", "ambiguous", True)]
    data = base64.b64decode(found.patches[0].data_uri.partition(",")[2])
    strip = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    width = (strip.shape[1] - 8) // 3
    assert strip[:, -width:].astype(int).std() < 12, "the difference is noise of the drawing's steps"


def test_what_is_shown_is_bounded_takes_each_flag_in_turn_and_counts_the_rest(folder: Path) -> None:
    names = [f"T{k}" for k in range(6)]
    flags = ["poor_fit"] * 5 + ["occluded"]
    rows = [pixels(name, 60.0, 75.0, flag) for name, flag in zip(names, flags, strict=True)]
    joined = {"c1": [in_space(name, flag) for name, flag in zip(names, flags, strict=True)]}
    found = flagged_patches(folder, rows, joined, {"c1": CaptureFacts(captures=("c1",))}, most=2)
    assert {one.flags for one in found.patches} == {"poor_fit", "occluded"}
    assert found.others == 4


def test_a_target_without_numbers_is_shown_where_it_usually_is_or_counted(folder: Path) -> None:
    lost = pixels("T1", 0.0, 0.0, "not_found", has_numbers=False)
    joined = {"c1": [in_space("T1", "not_found")]}
    usual = pixels("T1", 60.0, 75.0) | {"capture": "c0"}
    found = flagged_patches(folder, [lost, usual], joined, {})
    assert [one.has_model for one in found.patches] == [False]
    assert flagged_patches(folder, [lost], joined, {}).others == 1


def test_results_without_their_frames_only_count(folder: Path, tmp_path: Path) -> None:
    rows, joined = [pixels("T1", 60.0, 75.0, "poor_fit")], {"c1": [in_space("T1", "poor_fit")]}
    (folder / "captures" / "c1" / "left.png").unlink()
    assert flagged_patches(folder, rows, joined, {}).others == 1
    assert flagged_patches(tmp_path / "nowhere", rows, joined, {}).others == 1
