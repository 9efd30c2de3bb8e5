from __future__ import annotations

import cv2
import numpy as np
import pytest

from labdaemon.processing.thumbnails import Thumbnail, find_thumbnail


def scene(shift: tuple[int, int], seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    picture = cv2.GaussianBlur(rng.normal(0.5, 0.2, (300, 400)).astype(np.float32), (0, 0), 3)
    noise = rng.normal(0, 0.002, picture.shape)
    return (np.roll(picture, shift[::-1], axis=(0, 1)) + noise).astype(np.float32)


@pytest.mark.parametrize("size", [20, 60])
@pytest.mark.parametrize("shift", [(0, 0), (7, -3), (-11, 12), (20, 20)])
def test_finds_a_shift_to_a_pixel_or_two(shift: tuple[int, int], size: int) -> None:
    thumbnail = Thumbnail.cut(scene((0, 0)), (151, 120, size, size))
    found, score = find_thumbnail(scene(shift), thumbnail, 24)
    assert np.abs(found - shift).max() <= 1
    assert score > 0.9


def test_at_the_rim_and_off_the_frame() -> None:
    picture = scene((0, 0))
    found, score = find_thumbnail(picture, Thumbnail.cut(picture, (0, 0, 40, 40)), 24)
    assert np.abs(found).max() <= 1
    assert score > 0.9
    lost = Thumbnail(picture[:40, :40], 500, 400)
    assert find_thumbnail(picture, lost, 8)[1] == -1.0


def test_another_scene_scores_low() -> None:
    assert find_thumbnail(scene((0, 0), seed=1), Thumbnail.cut(scene((0, 0)), (150, 120, 60, 60)), 24)[1] < 0.8
