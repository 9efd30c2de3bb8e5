"""First sieve for dots: dark, compact regions surrounded by something brighter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.imaging.blobs import find_blobs

RANGE_PX = (6.0, 120.0)


def scene(*dots: tuple[float, float, float, float, float], paper: float = 0.7, ink: float = 0.05) -> np.ndarray:
    """Ellipses (x, y, semi-axes, angle) on paper, edges blurred by a pixel."""
    y, x = np.mgrid[0:240, 0:320].astype(np.float32)
    image = np.full(x.shape, paper, np.float32)
    for cx, cy, a, b, angle in dots:
        u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        v = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
        distance = (np.sqrt((u / a) ** 2 + (v / b) ** 2) - 1.0) * min(a, b)
        image -= (paper - ink) / (1.0 + np.exp(2.0 * np.clip(distance, -20, 20)))
    return image


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    x=st.floats(90, 220),
    y=st.floats(80, 160),
    a=st.floats(6, 45),
    ratio=st.floats(0.5, 1.0),
    angle=st.floats(-1.5, 1.5),
)
def test_a_dot_of_any_size_is_found_to_about_a_pixel(x: float, y: float, a: float, ratio: float, angle: float) -> None:
    found = find_blobs(scene((x, y, a, ratio * a, angle)), RANGE_PX)
    assert found
    best = min(found, key=lambda one: np.hypot(one.x_px - x, one.y_px - y))
    assert np.hypot(best.x_px - x, best.y_px - y) < 1.0
    assert best.semi_major_px == pytest.approx(a, rel=0.15, abs=1.0)
    assert best.semi_minor_px == pytest.approx(ratio * a, rel=0.2, abs=1.0)


def test_several_are_found_and_nothing_between_them() -> None:
    dots = [(60.0, 60.0, 10.0, 10.0, 0.0), (160.0, 60.0, 14.0, 12.0, 0.3), (250.0, 180.0, 20.0, 15.0, 1.0)]
    found = find_blobs(scene(*dots), RANGE_PX)
    for blob in found:
        assert min(np.hypot(blob.x_px - x, blob.y_px - y) for x, y, *_ in dots) < 1.5
    for x, y, *_ in dots:
        assert min(np.hypot(blob.x_px - x, blob.y_px - y) for blob in found) < 1.0


@pytest.mark.parametrize("paper", [0.05, 0.3, 0.95])
def test_dark_and_bright_paper_are_treated_equally(paper: float) -> None:
    assert find_blobs(scene((150.0, 120.0, 12.0, 12.0, 0.0), paper=paper, ink=0.07 * paper), RANGE_PX)


def test_lines_edges_and_even_paper_are_none() -> None:
    image = scene()
    assert find_blobs(image, RANGE_PX) == []
    image[100:104] = 0.05
    image[:, 300:] = 0.05
    assert find_blobs(image, RANGE_PX) == []


def test_a_flat_ellipse_and_a_cut_one_are_none() -> None:
    assert find_blobs(scene((150.0, 120.0, 50.0, 6.0, 0.4)), RANGE_PX) == []
    assert find_blobs(scene((2.0, 120.0, 14.0, 14.0, 0.0)), RANGE_PX) == []


def test_a_frame_smaller_than_a_dot_has_none() -> None:
    assert find_blobs(np.full((6, 6), 0.5, np.float32), RANGE_PX) == []
