"""Single pixels that stand out from all neighbours of their own colour."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.imaging.hot_pixels import isolated, within_neighbours


def scene(spacing: int, seed: int = 1) -> np.ndarray:
    """A soft dark disc; on a mosaic the colours differ by a factor."""
    y, x = np.mgrid[0:80, 0:96].astype(float)
    values = 2000.0 - 1500.0 / (1.0 + np.exp((np.hypot(x - 50, y - 38) - 15.0) / 1.5))
    if spacing == 2:
        values[::2, ::2] *= 0.6
        values[1::2, 1::2] *= 0.7
    return values + np.random.default_rng(seed).normal(0, 12.0, values.shape)


@pytest.mark.parametrize("spacing", [1, 2])
def test_noise_and_edges_are_none(spacing: int) -> None:
    assert isolated(scene(spacing), spacing).mean() < 2e-3


@settings(max_examples=25, deadline=None, derandomize=True)
@given(row=st.integers(4, 75), column=st.integers(4, 91), step=st.sampled_from([-350.0, 350.0, 9000.0]))
def test_a_hot_or_dead_pixel_is_found_wherever_it_is(row: int, column: int, step: float) -> None:
    """Also on the edge of a dot, where its neighbours differ among themselves."""
    values = scene(2)
    around = values[row - 2 : row + 3 : 2, column - 2 : column + 3 : 2]
    values[row, column] = step + (around.max() if step > 0 else around.min())
    assert isolated(values, 2)[row, column]


def test_two_neighbours_of_one_colour_are_no_single_pixel() -> None:
    values = scene(2)
    values[40, 40] += 500.0
    values[40, 42] += 500.0
    found = isolated(values, 2)
    assert not found[40, 40]
    assert not found[40, 42]


def test_clipped_pixels_show_no_noise() -> None:
    """Half the frame at white would make the noise look like none, and every other pixel isolated."""
    values = scene(1)
    values[:, :60] = 4095.0
    unclipped = values < 4000.0
    assert isolated(values, 1, unclipped)[:, 62:].mean() < 5e-3


@pytest.mark.parametrize("spacing", [1, 2])
@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_each_pixel_is_brought_within_its_neighbours(spacing: int, kind: type) -> None:
    values = scene(spacing).astype(kind)
    values[30, 20] = 9999
    values[33, 50] = 0
    calm = within_neighbours(values, spacing)
    assert calm.dtype == values.dtype
    assert not isolated(calm.astype(float), spacing).any()
    around = values[30 - spacing : 31 + spacing : spacing, 20 - spacing : 21 + spacing : spacing].ravel()
    assert calm[30, 20] == np.delete(around, 4).max()
