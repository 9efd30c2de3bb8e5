"""The figure of a calibration's residuals."""

from __future__ import annotations

import numpy as np

from labdaemon.report.residuals import WIDTH_PX, draw_residuals

RED = (0, 0, 220)


def points(count: int = 600) -> np.ndarray:
    return np.random.default_rng(1).uniform([0, 0], [3872, 2592], (count, 2))


def reddish(image: np.ndarray) -> int:
    blue, green, red = (image[..., k].astype(int) for k in range(3))
    return int(np.count_nonzero((red > 180) & (blue < 90) & (green < 90)))


def test_noise_leaves_short_means_and_a_pattern_long_ones() -> None:
    """What lines up is a lens model that does not fit: it must be seen."""
    at = points()
    noise = np.random.default_rng(2).normal(0, 0.05, at.shape)
    pattern = noise + 0.1 * (at / [3872, 2592] - 0.5)
    quiet, loud = (draw_residuals((3872, 2592), at, one, 0.05, "sigma0 0.05 px") for one in (noise, pattern))
    assert quiet.shape == loud.shape == (int(np.ceil(2592 * WIDTH_PX / 3872)) + 60, WIDTH_PX, 3)
    assert reddish(loud) > 1.2 * reddish(quiet) > 0


def test_no_points_and_no_residuals_are_drawn_all_the_same() -> None:
    empty = draw_residuals((800, 600), np.empty((0, 2)), np.empty((0, 2)), 0.0, "nothing")
    assert empty.dtype == np.uint8
    assert reddish(empty) == 0
    edge = np.array([[0.0, 0.0], [799.0, 599.0]])
    draw_residuals((800, 600), edge, np.zeros((2, 2)), 0.1, "corners")
