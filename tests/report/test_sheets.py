from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.errors import UsageError
from labdaemon.imaging.codes import find_tags
from labdaemon.imaging.dots import find_dots
from labdaemon.imaging.frame import RawFrame
from labdaemon.imaging.rings import find_rings
from labdaemon.report import sheets

DPI = 200
PX_PER_MM = DPI / 25.4


def rasterised(data: bytes, folder: Path, page: int = 1) -> RawFrame:
    """A page as a third-party program draws it, as a grey frame."""
    program = shutil.which("pdftoppm")
    if program is None:
        pytest.skip("pdftoppm (poppler-utils) is not installed")
    (folder / "sheet.pdf").write_bytes(data)
    arguments = ["-r", str(DPI), "-gray", "-f", str(page), "-l", str(page), "-singlefile", "sheet.pdf", "sheet"]
    subprocess.run([program, *arguments], cwd=folder, check=True, capture_output=True)
    picture = cv2.imread(str(folder / "sheet.pgm"), cv2.IMREAD_GRAYSCALE)
    return RawFrame(
        path=folder / "sheet.pgm",
        values=picture.astype(np.uint16),
        pattern=np.zeros((1, 1), dtype=np.uint8),
        black=np.zeros((1, 1)),
        white_level=300.0,
    )


def test_printed_dots_have_their_true_size_and_nothing_else_looks_like_one(tmp_path: Path) -> None:
    frame = rasterised(sheets.sheets([sheets.dot(8.0)] * 7, 40.0), tmp_path)
    dots = find_dots(frame)
    assert len(dots) == 7
    for dot in dots:
        assert 2 * dot.semi_major_px / PX_PER_MM == pytest.approx(8.0, abs=0.03)
        assert 2 * dot.semi_minor_px / PX_PER_MM == pytest.approx(8.0, abs=0.03)
    pitch = np.diff(sorted({round(d.x_px / PX_PER_MM, 1) for d in dots}))
    assert pitch == pytest.approx(45.0, abs=0.15)


@pytest.mark.parametrize("family", ["apriltag-36h11", "aruco-5x5-50"])
def test_printed_tags_are_read_and_have_their_true_size(tmp_path: Path, family: str) -> None:
    numbers = [0, 7, 31, 49]
    frame = rasterised(sheets.sheets([sheets.tag(family, n, 36.0) for n in numbers], 54.0), tmp_path)
    tags = find_tags(frame, family)
    assert [tag.name for tag in tags] == [str(n) for n in numbers]
    for tag in tags:
        sides = np.hypot(*(tag.corners_px - np.roll(tag.corners_px, 1, axis=0)).T) / PX_PER_MM
        # The rasteriser rounds rectangles outwards to whole pixels.
        assert sides == pytest.approx(36.0, abs=1.0 / PX_PER_MM)
        # Upright on paper: the tag's own top-left corner is the picture's.
        assert np.argmin(tag.corners_px.sum(axis=1)) == 0


@pytest.mark.parametrize(("bits", "numbers"), [(12, [1, 2, 50, 146, 147]), (14, [1, 300, 516])])
def test_printed_rings_are_read(tmp_path: Path, bits: int, numbers: list[int]) -> None:
    data = sheets.sheets([sheets.ring(bits, n, 10.0) for n in numbers], 38.0, paper="letter", landscape=True)
    rings = find_rings(rasterised(data, tmp_path), bits=bits)
    assert [ring.name for ring in rings] == [str(n) for n in numbers]


def test_as_many_pages_as_needed(tmp_path: Path) -> None:
    across, up = sheets.grid(40.0, paper="a4", landscape=False)
    data = sheets.sheets([sheets.dot(8.0)] * (across * up + 3), 40.0)
    assert data.count(b"/Type /Page ") == 2
    assert len(find_dots(rasterised(data, tmp_path, page=2))) == 3


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: sheets.tag("apriltag-36h11", 587, 36.0), "0 to 586"),
        (lambda: sheets.ring(12, 0, 10.0), "1 to 147"),
        (lambda: sheets.ring(12, 148, 10.0), "1 to 147"),
        (lambda: sheets.ring(13, 1, 10.0), "12 or 14"),
        (lambda: sheets.sheets([sheets.dot(8.0)], 40.0, paper="a9"), "a4, a3, letter"),
        (lambda: sheets.sheets([sheets.dot(150.0)], 400.0), "does not fit on a4"),
        (lambda: sheets.sheets([], 40.0), "nothing to print"),
    ],
)
def test_what_cannot_be_printed_is_refused(make: Callable[[], object], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        make()
