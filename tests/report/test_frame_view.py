"""A frame for the live page: small, with vectors where it is measured, and written on standard output."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.processing.result_reader import read_csv
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, Row, write_csv
from labdaemon.report.frame_view import WIDTH_PX, frame_view
from labdaemon.report.overlay import CLEAN


@pytest.fixture
def results(tmp_path: Path) -> Path:
    cv2.imwrite(str(tmp_path / "left.png"), np.full((900, 1200), 20000, np.uint16))
    row: Row = dict.fromkeys(MEASUREMENT_COLUMNS)
    row |= {"capture": "c1", "camera": "left", "target": "A", "flags": [], "x_px": 600.0, "y_px": 450.0}
    row |= {"ax_px": 8.0, "ay_px": 0.0, "bx_px": 0.0, "by_px": 0.0}
    others = [row | {"camera": "right", "y_px": 200.0}, row | {"capture": "c2", "y_px": 700.0}]
    write_csv(tmp_path / "measurements.csv", MEASUREMENT_COLUMNS, [row, *others])
    length: Row = dict.fromkeys(ENVELOPE_COLUMNS) | {"capture": "c1", "target": "A", "flags": []}
    length |= {f"{name}{axis}_mm": 0.0 for name in "ab" for axis in "xyz"}
    write_csv(tmp_path / "envelope.csv", ENVELOPE_COLUMNS, [length | {"ax_mm": 2.5}])
    return tmp_path


def vectors(jpeg: bytes) -> np.ndarray:
    """(n, 2) places of the colour of vectors, below the caption."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (675, WIDTH_PX, 3)
    y, x = np.nonzero((np.abs(image.astype(int) - CLEAN) < 60).all(axis=2))
    return np.column_stack([x, y])[y > 45]


def test_the_vectors_of_this_capture_and_camera_are_drawn(results: Path) -> None:
    found = vectors(frame_view(results / "left.png", "left", "c1", results))
    assert len(found) > 50
    assert np.abs(found[:, 1] - 450 * 0.75).max() < 12, "no other capture's, no other camera's"


def test_all_cameras_of_a_capture_have_one_magnification(results: Path) -> None:
    rows = list(read_csv(results / "measurements.csv"))
    write_csv(results / "measurements.csv", MEASUREMENT_COLUMNS, [rows[0], rows[1] | {"ax_px": 80.0}])
    found = vectors(frame_view(results / "left.png", "left", "c1", results))
    assert np.ptp(found[:, 0]) < 0.75 * 2 * 8.0 * 2, "as small as the other camera's larger motion asks for"


def test_what_is_not_measured_has_none(results: Path) -> None:
    assert len(vectors(frame_view(results / "left.png", "left", "c1", None))) == 0
    assert len(vectors(frame_view(results / "left.png", "left", "c3", results))) == 0


def test_a_frame_that_is_gone_is_refused_in_a_line(results: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        frame_view(results / "gone.png", "left", "c1", results)
    words = [sys.executable, "-m", "labdaemon.report.frame_view", str(results / "gone.png"), "left", "c1", ""]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
