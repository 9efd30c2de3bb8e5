from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from labdaemon.errors import SetupError
from labdaemon.processing.frame_size import check_frame_sizes

RIG = """
[cameras.left]
image_size = [64, 48]
focal_px = [80.0, 80.0]
principal_point_px = [31.5, 23.5]
[targets]
diameter_mm = 8.0
[control]
family = "apriltag-36h11"
size_mm = 36.0
"""


def frame(path: Path, width: int, height: int) -> Path:
    cv2.imwrite(str(path), np.full((height, width), 100, np.uint8))
    return path


def test_a_frame_of_another_size_is_refused_with_both_sizes(tmp_path: Path):
    (tmp_path / "rig.toml").write_text(RIG)
    check_frame_sizes(tmp_path, [("left", frame(tmp_path / "good.png", 64, 48))])
    with pytest.raises(SetupError, match=r"camera left delivers 60x40 pixels, but image_size says 64x48"):
        check_frame_sizes(tmp_path, [("left", frame(tmp_path / "other.png", 60, 40))])


def test_what_cannot_be_read_is_left_to_measuring(tmp_path: Path):
    (tmp_path / "broken.png").write_bytes(b"no frame at all")
    check_frame_sizes(tmp_path, [("left", tmp_path / "broken.png")])  # there is no rig file either
    (tmp_path / "rig.toml").write_text(RIG)
    check_frame_sizes(tmp_path, [("left", tmp_path / "broken.png"), ("up", frame(tmp_path / "up.png", 9, 9))])
