"""Textured patches in a data-set folder: measured with the dots, or refused by name."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from labdaemon.bench.textures import moved, random_texture
from labdaemon.blur import Dot
from labdaemon.errors import DataError
from labdaemon.imaging import read_frame
from labdaemon.processing import measure_capture, prepare_sharp
from labdaemon.processing.control import ControlTargets
from labdaemon.processing.patches import without_patches
from labdaemon.processing.survey import PatchBox, read_patches
from labdrivers.sim.dng import write_dng

HEADER = "name,camera,x_px,y_px,width_px,height_px\n"
SIDE, MOTION = 48, np.array([2.0, 1.0])


def cover(file: Path, centre: tuple[int, int], image: np.ndarray, rng: np.random.Generator) -> None:
    """Put a square of a textured surface over a part of a frame, as its sensor sees it."""
    with tifffile.TiffFile(file) as dng:
        pages = [page for first in dng.pages for page in (first, *(first.pages or ()))]
        values = next(page for page in pages if page.photometric == 32803).asarray().copy()
    half = len(image) // 2
    rows, columns = (slice(v - half, v - half + len(image)) for v in centre[::-1])
    gain = np.tile(np.array([[0.58, 1.0], [1.0, 0.72]]), (len(values) // 2 + 1, values.shape[1] // 2 + 1))
    values[rows, columns] = np.rint((1500 + image + rng.normal(0, 13, image.shape)) * gain[rows, columns])
    write_dng(file, values)


@pytest.fixture(scope="module")
def textured(planar: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one capture, and two textured squares between the dots: one moves, one is at rest."""
    folder = tmp_path_factory.mktemp("textured") / "set"
    shutil.copytree(planar, folder, ignore=shutil.ignore_patterns("results", "c2"))
    rng = np.random.default_rng(8)
    dots = prepare_sharp(folder).cameras[0].centres_px
    apart = dots[np.argsort(np.hypot(*(dots - dots[0]).T))[1]] - dots[0]
    lines = [HEADER]
    for name, at, motion in (("WALL", dots[0] + apart / 2, MOTION), ("FLOOR", dots[-1] - apart / 2, 0 * MOTION)):
        x, y = (round(float(v)) for v in at)
        texture = 250 * random_texture(rng, 104, 1.6)
        for file in (folder / "sharp").glob("*.dng"):
            cover(file, (x, y), texture, rng)
        cover(next((folder / "captures" / "c1").glob("*.dng")), (x, y), moved(texture, motion), rng)
        lines.append(f"{name},front,{x - SIDE // 2},{y - SIDE // 2},{SIDE},{SIDE}\n")
    (folder / "patches.csv").write_text("".join(lines))
    return folder


def test_patches_are_measured_with_the_dots(textured: Path) -> None:
    sharp = prepare_sharp(textured)
    assert sharp.targets[-2:] == ("WALL", "FLOOR")
    result = measure_capture(textured, sharp, ("c1",), "c1")
    rows = {str(row["target"]): row for row in result.measurement_rows}
    found = np.array([rows["WALL"]["ax_px"], rows["WALL"]["ay_px"]], dtype=float)
    sd = np.array([rows["WALL"]["sd_ax_px"], rows["WALL"]["sd_ay_px"]], dtype=float)
    assert np.all(np.abs(found - MOTION) < 4 * sd + 0.02)
    assert np.all(sd < 0.2)
    assert rows["WALL"]["flags"] == []
    assert rows["FLOOR"]["flags"] == ["at_rest"]
    assert [name for name, row in rows.items() if row["flags"]] == ["FLOOR"]
    wall = next(row for row in result.envelope_rows if row["target"] == "WALL")
    length = np.linalg.norm([float(str(wall[f"a{axis}_mm"])) for axis in "xyz"])
    size_px = np.hypot(*found)
    dot = next(row for row in result.envelope_rows if row["target"] == sharp.targets[0])
    scale = np.linalg.norm([float(str(dot[f"a{axis}_mm"])) for axis in "xyz"]) / np.hypot(
        *(float(str(rows[sharp.targets[0]][key])) for key in ("ax_px", "ay_px"))
    )
    assert length / size_px == pytest.approx(scale, rel=0.05)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("W,side,10,10,40,40", "the rig has no camera side; it has front"),
        ("W,front,1900,10,60,60", r"patch W \(1900,10,60,60\) does not lie inside the frame of 1936x1296 px"),
        ("0,front,10,10,40,40", "0 is the name of another target"),
        ("W,front,10.5,10,40,40", "W: x_px, y_px, width_px and height_px are whole pixels"),
        ("W,front,10,10,4,40", "W: .* at least 8 px"),
        ("W,front,10,10,40,40\nW,front,20,20,40,40", "line 3: W front is given twice"),
        ("W,,10,10,40,40", "line 2: a camera is missing"),
        ("", "names no patches"),
    ],
)
def test_a_bad_patch_is_refused_by_name(planar: Path, tmp_path: Path, row: str, said: str) -> None:
    shutil.copytree(planar, tmp_path / "set", ignore=shutil.ignore_patterns("results", "captures"))
    (tmp_path / "set" / "patches.csv").write_text(f"{HEADER}{row}\n")
    with pytest.raises(DataError, match=said):
        prepare_sharp(tmp_path / "set")


def test_a_dot_in_a_patch_is_texture_and_a_control_target_is_refused(planar: Path) -> None:
    frame = read_frame(next((planar / "sharp").glob("*.dng")))
    dots = [Dot(x, 60.0, 8.0, 8.0, 0.0, paper_px=20.0) for x in (50.0, 95.0, 200.0)]
    box = PatchBox("W", "front", 30, 40, 50, 50)
    kept, notes = without_patches("front", dots, [box], ControlTargets("apriltag-36h11"), frame)
    assert [dot.x_px for dot in kept] == [95.0, 200.0]
    assert [note.split(" at ")[1] for note in notes] == [
        "(50, 60) lies in patch W and is not measured by itself",
        "(95, 60) has its label partly in patch W: a label that moves by itself spoils the patch",
    ]
    square = np.array([(70.0, 50.0), (120.0, 50.0), (120.0, 100.0), (70.0, 100.0)])
    control = replace(ControlTargets("apriltag-36h11"), names=("7",), outlines=(square,))
    with pytest.raises(DataError, match=r"patch W \(30,40,50,50\) reaches onto control target 7"):
        without_patches("front", [], [box], control, frame)


def test_one_patch_may_be_seen_by_several_cameras(tmp_path: Path) -> None:
    file = tmp_path / "patches.csv"
    file.write_text(f"{HEADER}W,left,10,20,40,40\nW,right,30,20,40,50\n")
    assert [(one.camera, one.box) for one in read_patches(file, ("left", "right"))] == [
        ("left", (10, 20, 40, 40)),
        ("right", (30, 20, 40, 50)),
    ]
