"""The RAW file through LibRaw: pixels, pattern, levels, and what the camera says of itself."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import rawpy

from labdrivers.sim.dng import write_dng


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_libraw_reads_back_what_was_written(tmp_path: Path, pattern: str) -> None:
    mosaic = np.random.default_rng(2).integers(0, 4096, (133, 202)).astype(np.uint16)
    file = tmp_path / "frame.dng"
    write_dng(file, mosaic, pattern, 64, 4000, serial="6000001", captured_at="2026:05:04 10:11:12", exposure_s=1.3)
    with rawpy.imread(str(file)) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, mosaic)
        letters = "".join(raw.color_desc.decode()[i] for i in raw.raw_pattern.ravel())
        assert letters == pattern
        assert raw.black_level_per_channel == [64] * 4
        assert raw.white_level == 4000
        assert raw.other.shutter_speed == pytest.approx(1.3)
        assert f"{raw.other.timestamp:%Y:%m:%d %H:%M:%S}" == "2026:05:04 10:11:12"


def test_a_sensor_without_mosaic() -> None:
    mosaic = np.random.default_rng(2).integers(0, 4096, (100, 121)).astype(np.uint16)
    file = io.BytesIO()
    write_dng(file, mosaic, "GRAY")
    file.seek(0)
    with rawpy.imread(file) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, mosaic)
        assert raw.num_colors == 1
