from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.processing.tables import Row
from labdaemon.report.label_places import LabelPlacer
from labdaemon.report.overlay import (
    CLEAN,
    COLOURS,
    FLAGGED,
    LOST,
    READABLE_SHARE,
    RESTING,
    draw_overlay,
    overlay_path,
    readable_magnification,
    write_overlay,
)


def row(target: str, *numbers: float | None, flags: tuple[str, ...] = ()) -> Row:
    columns = ("x_px", "y_px", "ax_px", "ay_px", "bx_px", "by_px")
    return {
        "capture": "c1",
        "camera": "left",
        "target": target,
        **dict(zip(columns, numbers, strict=True)),
        "flags": [*flags],
    }


def painted(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """(n, 2) x and y of pixels of a colour, below the caption."""
    y, x = np.nonzero((np.abs(image.astype(int) - colour) < 45).all(axis=2))
    band = round(46 * max(image.shape[:2]) / 1000) + 1
    return np.column_stack([x, y])[y > band]


GREY = np.full((600, 800), 0.4, np.float32)


def test_a_vector_is_drawn_magnified_about_its_target() -> None:
    image = draw_overlay(GREY, [row("T01", 400.0, 300.0, 6.0, 0.0, 0.0, 0.0)], title="c1", magnify=20.0)
    at = painted(image, CLEAN)
    assert image.shape == (600, 800, 3)
    assert abs(at[:, 0].min() - (400 - 120)) <= 3
    assert abs(at[:, 0].max() - (400 + 120)) <= 3
    assert abs(at[:, 1].mean() - 300) < 3


def test_an_orbit_is_drawn_as_one() -> None:
    image = draw_overlay(GREY, [row("T01", 400.0, 300.0, 6.0, 0.0, 0.0, 3.0)], title="c1", magnify=20.0)
    at = painted(image, CLEAN)
    assert abs(at[:, 1].min() - (300 - 60)) <= 3
    assert abs(at[:, 1].max() - (300 + 60)) <= 3


def test_large_frames_are_reduced_with_their_vectors() -> None:
    image = draw_overlay(
        np.full((2700, 3600), 0.4, np.float32), [row("T", 1800.0, 1350.0, 10.0, 0.0, 0.0, 0.0)], title="", magnify=20.0
    )
    assert image.shape == (1350, 1800, 3)
    at = painted(image, CLEAN)
    assert abs(at[:, 0].max() - (900 + 100)) <= 4


@pytest.mark.parametrize(
    ("numbers", "flags", "colour"),
    [
        ((400.0, 300.0, 4.0, 0.0, 0.0, 0.0), (), CLEAN),
        ((400.0, 300.0, 0.2, 0.0, 0.0, 0.0), ("at_rest",), RESTING),
        ((400.0, 300.0, 4.0, 0.0, 0.0, 0.0), ("at_rest", "poor_fit"), FLAGGED),
        ((400.0, 300.0, None, None, None, None), ("not_found",), LOST),
    ],
)
def test_colours_say_what_a_row_is(
    numbers: tuple[float | None, ...], flags: tuple[str, ...], colour: tuple[int, int, int]
) -> None:
    image = draw_overlay(GREY, [row("T01", *numbers, flags=flags)], title="c1")
    for other in COLOURS.values():
        assert (len(painted(image, other)) > 10) == (other == colour)


@pytest.mark.parametrize("amplitude_px", [0.2, 0.7, 21.0, 300.0])
def test_the_largest_motion_is_readable_and_stays_inside_the_frame(amplitude_px: float) -> None:
    doubtful = row("T02", 400.0, 200.0, 50 * amplitude_px, 0.0, 0.0, 0.0, flags=("poor_fit",))
    rows = [row("T01", 400.0, 300.0, amplitude_px, 0.0, 0.0, 0.0), doubtful]
    factor = readable_magnification(rows, 3900.0)
    assert factor == 1.0 or 0.04 * 3900 < factor * amplitude_px <= READABLE_SHARE * 3900
    assert float(f"{factor:.0e}") == factor
    assert readable_magnification([], 3900.0) == 1.0


def test_names_cover_no_blur_no_vector_and_no_other_name() -> None:
    """A column of targets as close as on the demo's frame."""
    rows = [row(f"L{k:02d}", 380.0, 80.0 + 40.0 * k, 3.0, 0.2 * (k - 5), 0.0, 0.0) for k in range(12)]
    plain = draw_overlay(GREY, [one | {"target": ""} for one in rows], title="", magnify=20.0)
    named = draw_overlay(GREY, rows, title="", magnify=20.0)
    assert len(painted(named, CLEAN)) > 0.99 * len(painted(plain, CLEAN)), "the vectors stay visible"
    for one in rows:
        x, y = round(float(one["x_px"])), round(float(one["y_px"]))  # type: ignore[arg-type]
        assert (named[y - 7 : y + 8, x - 7 : x + 8] == plain[y - 7 : y + 8, x - 7 : x + 8]).all()


def test_what_is_taken_is_avoided() -> None:
    placer = LabelPlacer((100, 100), 10.0, np.array([[25.0, 25.0]]))
    corners = [(20.0, 20.0), (95.0, 50.0), (50.0, 5.0), (50.0, 50.0)]
    assert placer.place(corners, 10.0, 10.0) == (50.0, 50.0), "the others cover a point, or leave the image"
    assert placer.place(corners, 10.0, 10.0) == (20.0, 20.0), "a point is less than a name"


def test_a_target_without_a_place_draws_nothing() -> None:
    lost = row("T01", None, None, None, None, None, None, flags=("not_found",))
    image = draw_overlay(GREY, [lost], title="c1")
    assert all(len(painted(image, colour)) == 0 for colour in COLOURS.values())


def test_written_as_png_and_refused_where_it_cannot_be(tmp_path: Path) -> None:
    frame = tmp_path / "frame.png"
    cv2.imwrite(str(frame), np.full((300, 400), 20000, np.uint16))
    out = overlay_path(tmp_path / "results", "c1", "left")
    assert out == tmp_path / "results" / "overlay" / "c1-left.png"
    rows = [row("T01", 200.0, 150.0, 3.0, 1.0, 0.0, 0.0)]
    write_overlay(frame, rows, out, "c1 left", {"T01": 0.75})
    assert cv2.imread(str(out)).shape == (300, 400, 3)
    assert [p.name for p in out.parent.iterdir()] == ["c1-left.png"]
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_overlay(frame, rows, tmp_path / "file" / "x.png", "c1")
    with pytest.raises(DataError, match="no such file"):
        write_overlay(tmp_path / "gone.dng", rows, out, "c1")
