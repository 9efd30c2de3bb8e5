"""A patch as its channels' colour planes, and models sampled on them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.patch.colour_planes import make_grid, make_planes, merge_planes, sample_plane, split_planes
from labdaemon.blur.patch.pixels import Patch
from labdaemon.errors import DataError


def patch(height: int, width: int, *, bayer: bool = True, seed: int = 0) -> Patch:
    values = np.random.default_rng(seed).uniform(0, 1000, (height, width))
    channel = np.zeros((height, width), np.uint8)
    if bayer:
        channel[::2, 1::2], channel[1::2, ::2], channel[1::2, 1::2] = 1, 2, 3
    return Patch(values, channel, np.ones((height, width), dtype=bool), (10, 20))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    height=st.integers(1, 12).map(lambda n: 2 * n), width=st.integers(1, 12).map(lambda n: 2 * n), bayer=st.booleans()
)
def test_planes_merge_to_the_patch_again(height: int, width: int, bayer: bool) -> None:
    whole = patch(height, width, bayer=bayer)
    planes = make_planes(whole)
    np.testing.assert_array_equal(merge_planes(planes, planes.values), whole.values)
    np.testing.assert_array_equal(split_planes(planes, whole.values), planes.values)
    assert planes.period == (2 if bayer else 1)
    assert planes.channel.tolist() == ([0, 1, 2, 3] if bayer else [0])


@pytest.mark.parametrize("shape", [(5, 7), (4, 7), (5, 6)])
def test_a_plane_that_is_one_short_is_padded_with_invalid_pixels(shape: tuple[int, int]) -> None:
    planes = make_planes(patch(*shape))
    assert planes.values.shape[1:] == ((shape[0] + 1) // 2, (shape[1] + 1) // 2)
    assert int(planes.valid.sum()) == shape[0] * shape[1]


def test_what_is_no_number_is_invalid() -> None:
    spoilt = patch(4, 4)
    spoilt.values[1, 2] = np.nan
    planes = make_planes(spoilt)
    assert np.isfinite(planes.values).all()
    assert int(planes.valid.sum()) == 15


def test_another_filter_than_bayers_is_refused() -> None:
    xtrans = patch(6, 6)
    xtrans.channel[:] = np.arange(36).reshape(6, 6) % 3
    with pytest.raises(DataError, match="does not repeat every two pixels"):
        make_planes(xtrans)
    with pytest.raises(DataError, match="lies off the frame"):
        make_planes(patch(0, 4))


@pytest.mark.parametrize("period", [1, 2])
@pytest.mark.parametrize("oversampling", [1, 2])
def test_a_model_in_closed_form_is_met_at_each_planes_own_pixels(period: int, oversampling: int) -> None:
    """A Gaussian of 1.5 px, whose transform is known: values at every pixel, or at every second one."""
    grid = make_grid((40, 48), oversampling)
    height, width = grid.size
    centre = np.array([24.3, 19.6])
    spectrum = 2 * np.pi * 1.5**2 * np.exp(-2 * np.pi**2 * 1.5**2 * (grid.fx**2 + grid.fy**2))
    spectrum = spectrum * np.exp(-2j * np.pi * (grid.fx * centre[0] + grid.fy * centre[1]))
    values = sample_plane(spectrum, grid, period)
    y, x = np.mgrid[0:height:period, 0:width:period]
    expected = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * 1.5**2))
    np.testing.assert_allclose(values, expected, atol=2e-5)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.integers(1, 200), st.integers(1, 200))
def test_a_grid_is_large_enough_and_divides_by_every_period(height: int, width: int) -> None:
    grid = make_grid((height, width))
    assert grid.size[0] >= height
    assert grid.size[1] >= width
    assert grid.size[0] % 4 == grid.size[1] % 4 == 0
