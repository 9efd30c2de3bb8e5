"""Straight sides fitted on the mosaic, and the corners where they meet."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from labdaemon.blur import Patch
from labdaemon.imaging.edges import Side, corners_of, fit_side

CORNERS = np.array([[30.3, 28.6], [90.7, 31.2], [87.9, 92.4], [27.1, 89.0]])  # clockwise as seen, y down


def square(*, noise_dn: float = 3.0, bayer: bool = True, seed: int = 1) -> Patch:
    """A dark quadrilateral on white paper; each channel has its own levels, the edge a blur of 0.8 px."""
    y, x = np.mgrid[0:120, 0:120].astype(float)
    inside = np.ones((120, 120))
    for k in range(4):
        a, b = CORNERS[k], CORNERS[(k + 1) % 4]
        tx, ty = (b - a) / np.hypot(*(b - a))
        outward = (x - a[0]) * ty - (y - a[1]) * tx
        inside *= ndtr(-outward / 0.8)
    channel = np.zeros((120, 120), np.uint8)
    if bayer:
        channel[::2, 1::2], channel[1::2, ::2], channel[1::2, 1::2] = 1, 2, 3
    paper, ink = np.array([2000.0, 2600.0, 2500.0, 1500.0])[channel], np.array([150.0, 180.0, 170.0, 120.0])[channel]
    values = paper + (ink - paper) * inside + np.random.default_rng(seed).normal(0, noise_dn, x.shape)
    return Patch(values, channel, np.ones(x.shape, dtype=bool), (0, 0))


def fitted(patch: Patch, rough: np.ndarray) -> list[Side]:
    sides = [fit_side(patch, rough[k], rough[(k + 1) % 4], band_px=6.0, guard_px=6.0) for k in range(4)]
    assert all(side is not None for side in sides)
    return [side for side in sides if side is not None]


@pytest.mark.parametrize("bayer", [True, False])
@pytest.mark.parametrize("shift", [0.0, 1.5])
def test_corners_are_found_from_approximate_ones(bayer: bool, shift: float) -> None:
    found = corners_of(fitted(square(bayer=bayer), CORNERS + shift))
    assert found is not None
    corners, covariance = found
    assert np.abs(corners - CORNERS).max() < 0.05
    pulls = (corners - CORNERS).ravel() / np.sqrt(np.diag(covariance))
    assert np.sqrt(np.mean(pulls**2)) < 3.0
    assert np.sqrt(np.diag(covariance)).max() < 0.05


def test_neighbouring_corners_share_a_side_and_so_an_error() -> None:
    found = corners_of(fitted(square(), CORNERS))
    assert found is not None
    correlation = found[1] / np.sqrt(np.outer(np.diag(found[1]), np.diag(found[1])))
    assert np.abs(correlation - np.eye(8)).max() > 0.05
    np.testing.assert_allclose(found[1], found[1].T, atol=1e-12)


def test_a_side_points_to_the_paper() -> None:
    side = fitted(square(), CORNERS)[0]
    assert 0.85 < side.contrast < 0.97
    outside = side.place((CORNERS[0] + CORNERS[1]) / 2 + 5.0 * side.normal)
    assert outside[0] == pytest.approx(0.0, abs=0.01)
    assert outside[1] == pytest.approx(5.0, abs=0.05)


def test_where_nothing_is_no_side_is_found() -> None:
    paper = Patch(np.full((120, 120), 2000.0), np.zeros((120, 120), np.uint8), np.ones((120, 120), bool), (0, 0))
    assert fit_side(paper, CORNERS[0], CORNERS[1], band_px=6.0, guard_px=6.0) is None
    inverted = square()
    turned = Patch(3000.0 - inverted.values, inverted.channel, inverted.valid, (0, 0))
    assert fit_side(turned, CORNERS[0], CORNERS[1], band_px=6.0, guard_px=6.0) is None, "dark outside is no target"
    assert fit_side(square(), CORNERS[0], CORNERS[0] + 10.0, band_px=6.0, guard_px=6.0) is None, "too short"


def test_clipped_paper_is_left_out() -> None:
    spoilt = square()
    spoilt.valid[spoilt.values > 1800.0] = False
    side = fit_side(spoilt, CORNERS[0], CORNERS[1], band_px=6.0, guard_px=6.0)
    clean = fitted(square(), CORNERS)[0]
    assert side is None or np.abs(side.offset_px - clean.offset_px).max() < 0.2


def test_parallel_sides_meet_nowhere() -> None:
    sides = fitted(square(), CORNERS)
    assert corners_of([sides[0], sides[0], sides[2], sides[3]]) is None
