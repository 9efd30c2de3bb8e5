"""The end of a label along 72 rays: dark and light grounds, narrow rims, unequal sides, corners."""

from typing import Any

import numpy as np
import pytest

from labdaemon.imaging import find_dots

ANGLE = 2 * np.pi * np.arange(72) / 72


def rectangle(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    """(72,) distance of a rectangle's edge from the origin inside it."""
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    with np.errstate(divide="ignore"):
        return np.minimum(
            np.where(c > 0, right, left) / np.maximum(np.abs(c), 1e-9),
            np.where(s > 0, bottom, top) / np.maximum(np.abs(s), 1e-9),
        )


def scene(canvas: Any, ground: float, left: int, top: int, right: int, bottom: int, seed: int = 3) -> np.ndarray:
    sheet = canvas(240, 240, ground=ground)
    sheet.box(120 - left, 120 - top, left + right, top + bottom, 0.85)
    sheet.ellipse(120, 120, 11, 11, 0, 0.04)
    return sheet.develop(np.random.default_rng(seed))


@pytest.mark.parametrize("ground", [0.05, 0.3, 0.55, 0.7, 0.78, 0.95])
def test_the_label_ends_on_dark_and_on_light_grounds(canvas: Any, ground: float) -> None:
    (dot,) = find_dots(scene(canvas, ground, 24, 24, 24, 24))
    error = np.array(dot.label_px) - rectangle(24, 24, 24, 24)
    assert np.max(error) < 2.5
    assert np.median(np.abs(error)) < 1.5
    assert dot.paper_px == min(dot.label_px)


@pytest.mark.parametrize("ground", [0.1, 0.7])
def test_each_side_has_its_own_distance(canvas: Any, ground: float) -> None:
    (dot,) = find_dots(scene(canvas, ground, 18, 40, 30, 22))
    ends = np.array(dot.label_px)
    assert ends[[0, 18, 36, 54]] == pytest.approx([30, 22, 18, 40], abs=2.0)


@pytest.mark.parametrize(("ground", "most"), [(0.4, 1.5), (0.7, 1.5)])
def test_a_narrow_rim_is_an_end(canvas: Any, ground: float, most: float) -> None:
    (dot,) = find_dots(scene(canvas, ground, 15, 15, 15, 15))
    along_sides = (np.array(dot.label_px) - rectangle(15, 15, 15, 15))[::18]
    assert np.max(np.array(dot.label_px) - rectangle(15, 15, 15, 15)) < 3.0
    assert np.max(along_sides) < most


def test_a_soft_shadow_is_no_end(canvas: Any) -> None:
    sheet = canvas(240, 240, ground=0.85)
    sheet.ellipse(120, 120, 11, 11, 0, 0.04)
    grey = sheet.develop(np.random.default_rng(4))
    shade = 1 - 0.15 / (1 + np.exp(-(np.arange(240) - 150) / 8.0))
    (dot,) = find_dots(grey * shade[None, :].astype(np.float32))
    assert dot.paper_px > 60
