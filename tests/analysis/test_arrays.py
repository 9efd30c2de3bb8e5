"""Plain arrays as frames, with a clear error where something is missing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from labdaemon.analysis.arrays import BAYER_CELLS, as_frames, frame_from_array
from labdaemon.errors import DataError, LabdaemonError, UsageError

GREY = np.random.default_rng(1).integers(200, 3000, (40, 48)).astype(np.uint16)


def test_whole_numbers_clip_at_the_end_of_their_type() -> None:
    assert frame_from_array(GREY).white_level == 65535.0
    assert frame_from_array((GREY // 16).astype(np.uint8)).white_level == 255.0
    assert frame_from_array(GREY, white_level=4095.0).white_level == 4095.0


def test_other_numbers_need_a_white_level() -> None:
    with pytest.raises(UsageError, match="white level of float64 values is not known"):
        frame_from_array(GREY.astype(float))
    assert frame_from_array(GREY.astype(float), white_level=4095.0).size == (48, 40)


@pytest.mark.parametrize("pattern", [*BAYER_CELLS, "rggb"])
def test_a_mosaic_says_its_pattern(pattern: str) -> None:
    frame = frame_from_array(GREY, bayer=pattern)
    assert sorted(frame.pattern.ravel().tolist()) == [0, 1, 2, 3]


@pytest.mark.parametrize(("values", "options", "words"), [
    (np.zeros((40, 48, 3), np.uint8), {}, "looks like a colour image"),
    (np.zeros((8, 48), np.uint8), {}, "at least 16 px a side"),
    (np.zeros(48, np.uint8), {}, "is no image"),
    (np.zeros((40, 48), bool), {}, "values of type bool are no light"),
    (np.zeros((40, 48), complex), {"white_level": 1.0}, "values of type complex128"),
    (np.full((40, 48), np.nan), {"white_level": 1.0}, "not finite"),
    (GREY, {"white_level": 10.0, "black_level": 20.0}, "white level 10 must be larger than the black level 20"),
    (GREY, {"bayer": "RGB"}, "bayer is one of RGGB, BGGR, GRBG, GBRG"),
])  # fmt: skip
def test_what_is_no_frame_is_refused_in_words(values: np.ndarray, options: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        frame_from_array(values, name="sharp", **options)


def test_a_mosaic_that_is_not_stated_is_noticed() -> None:
    mosaic = GREY.copy()
    mosaic[::2, ::2] //= 4
    mosaic[1::2, 1::2] //= 3
    with pytest.raises(DataError, match="mosaic"):
        frame_from_array(mosaic)


def test_one_or_several_frames_are_taken() -> None:
    frame = frame_from_array(GREY)
    assert as_frames(frame, "sharp") == [frame]
    assert len(as_frames([frame, GREY], "sharp")) == 2


@pytest.mark.parametrize(("source", "words"), [
    ([], "sharp: no frame was given"), (7, "a int is no frame"), ([GREY, 7], r"sharp\[1\]: a int is no frame"),
    ([GREY.astype(float)], r"sharp\[0\]: the white level"),
])  # fmt: skip
def test_whichever_is_wrong_is_named(source: Any, words: str) -> None:
    with pytest.raises(LabdaemonError, match=words):
        as_frames(source, "sharp")
