"""Input that cannot be measured, or not as it looks: flagged, never a wrong number without a word."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur import Defocus, Dot, InitialGuess, Patch, fit_sharp, make_textured_patch, measure
from labdaemon.errors import DataError, UsageError
from labdaemon.flags import Flag

STILL = Defocus(0.0, 0.01)
SIZE = 64
DOT = Dot(32.0, 32.0, 12.0, 12.0, 0.0, name="t")


def grey(values, valid=None):
    return Patch(
        values, np.zeros(values.shape, np.uint8), np.ones(values.shape, bool) if valid is None else valid, (0, 0)
    )


@pytest.fixture(scope="module")
def scene(area):
    return area.Scene(radius_px=12.0)


@pytest.fixture(scope="module")
def still(area, scene):
    return area.render(scene, (SIZE, SIZE), (32.3, 31.8), seed=5)


@pytest.fixture(scope="module")
def moved(area, scene):
    return area.render(scene, (SIZE, SIZE), (32.3, 31.8), area.whole_cycles(4, 1), seed=6)


@pytest.fixture(scope="module")
def sharp(still):
    return fit_sharp(DOT, [still])


@pytest.mark.parametrize(
    "values",
    [np.full((SIZE, SIZE), np.nan), np.zeros((SIZE, SIZE)), np.full((SIZE, SIZE), 3000.0), np.zeros((0, 0))],
    ids=["nan", "black", "white", "off the frame"],
)
def test_no_picture_no_number(sharp, moved, values):
    patch = grey(values)
    lost = fit_sharp(DOT, [patch])
    assert Flag.NOT_FOUND in lost.flags
    for found in (measure(sharp, patch), measure(lost, moved)):
        assert Flag.NOT_FOUND in found.flags
        assert np.all(np.isnan(found.a_px))
        assert np.all(np.isnan(found.covariance_px2))


def test_all_clipped_white_is_called_saturated(sharp):
    patch = grey(np.full((SIZE, SIZE), 4095.0), np.zeros((SIZE, SIZE), bool))
    assert Flag.SATURATED in fit_sharp(DOT, [patch]).flags
    assert Flag.SATURATED in measure(sharp, patch).flags


def test_holes_are_left_out(sharp, moved):
    values = moved.values.copy()
    values[8:16, 30:44] = np.nan
    found = measure(sharp, grey(values), defocus=STILL)
    assert np.hypot(*(found.a_px - (4, 1))) < 0.03
    assert not found.flags


@pytest.mark.parametrize("smear", [1.5, 3.0, 5.0])
def test_a_sharp_frame_that_is_itself_smeared_is_flagged_through_to_the_result(area, scene, moved, smear):
    blurred = area.render(scene, (SIZE, SIZE), (32.3, 31.8), area.whole_cycles(smear, 0), seed=7)
    target = fit_sharp(DOT, [blurred])
    assert Flag.POOR_FIT in target.flags
    assert Flag.POOR_FIT in measure(target, moved).flags


def test_a_neighbour_is_masked_and_one_that_touches_is_flagged(area, scene, sharp):
    path = area.whole_cycles(4, 0)
    one = area.render(scene, (SIZE, 120), (32, 32), path, seed=8).values
    apart = area.render(scene, (SIZE, 120), (88, 32), path, seed=9).values
    near = area.render(scene, (SIZE, 120), (60, 34), path, seed=9).values
    start = InitialGuess(np.array([32.0, 32.0]))
    found = measure(sharp, grey(np.minimum(one, apart)), defocus=STILL, initial_guess=start)
    assert np.hypot(*(found.a_px - (4, 0))) < 0.03
    assert not found.flags
    assert measure(sharp, grey(np.minimum(one, near)), defocus=STILL, initial_guess=start).flags


@pytest.mark.parametrize("box", [(10, 20, 20, 30), (28, 0, 10, 64), (0, 0, 34, 64), (0, 0, 64, 64)])
def test_a_covered_target_is_never_measured_without_a_flag(area, scene, sharp, box):
    patch = area.render(scene, (SIZE, SIZE), (32.3, 31.8), area.whole_cycles(4, 1), seed=6, hidden=box)
    assert measure(sharp, patch, defocus=STILL).flags & {Flag.OCCLUDED, Flag.POOR_FIT, Flag.NOT_FOUND}


def test_a_small_cover_is_named_and_the_rest_believed(area, scene, sharp):
    patch = area.render(scene, (SIZE, SIZE), (32.3, 31.8), area.whole_cycles(4, 1), seed=6, hidden=(40, 30, 6, 6))
    found = measure(sharp, patch, defocus=STILL)
    assert found.flags == {Flag.OCCLUDED}
    assert np.hypot(*(found.a_px - (4, 1))) < 0.05


def test_the_papers_edge_is_reported(area, scene, still, moved):
    target = fit_sharp(Dot(32.0, 32.0, 12.0, 12.0, 0.0, paper_px=15.0), [still])
    assert Flag.PAPER_EDGE in measure(target, moved, defocus=STILL).flags


def test_other_depths_of_bits_are_the_same_picture(still, moved):
    target = fit_sharp(DOT, [grey(still.values * 4)])
    found = measure(target, grey(moved.values * 4), defocus=STILL)
    assert np.hypot(*(found.a_px - (4, 1))) < 0.03
    assert not found.flags


def test_a_filter_that_is_no_bayer_is_refused(still):
    channel = (np.add.outer(np.arange(SIZE), np.arange(SIZE)) % 3).astype(np.uint8)
    patch = Patch(still.values, channel, still.valid, (0, 0))
    with pytest.raises(DataError, match="two pixels"):
        fit_sharp(DOT, [patch])


def test_sharp_patches_must_be_of_one_rectangle(still):
    with pytest.raises(UsageError, match="rectangle"):
        fit_sharp(DOT, [still, still.crop(2, 2, 50, 50)])
    with pytest.raises(UsageError, match="at least one"):
        fit_sharp(DOT, [])


@pytest.mark.parametrize("values", [np.nan, 0.0, 3000.0], ids=["nan", "black", "white"])
def test_a_texture_that_is_not_there_is_not_found(still, values):
    target = make_textured_patch(still, (16, 16, 32, 32))
    found = measure(target, grey(np.full((SIZE, SIZE), values)))
    assert Flag.NOT_FOUND in found.flags
    assert np.all(np.isnan(found.a_px))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    direction=st.floats(0, 2 * np.pi),
    side=st.floats(0.0, 1.0),
    width=st.integers(4, 12),
    grey_level=st.floats(0.05, 0.9),
    length=st.floats(0.5, 6.0),
    seed=st.integers(0, 1000),
)
def test_whatever_hangs_in_front_no_wrong_number_goes_without_a_word(
    area, scene, sharp, direction, side, width, grey_level, length, seed
):
    path = area.whole_cycles(length * np.cos(direction), length * np.sin(direction))
    patch = area.render(scene, (SIZE, SIZE), (32.3, 31.8), path, seed=seed)
    left = int(18 + side * 26)
    values = patch.values.copy()
    strip = np.random.default_rng(seed).normal(2500 * grey_level, 15, values[:, left : left + width].shape)
    values[:, left : left + width] = strip
    found = measure(sharp, grey(values), defocus=STILL)
    assert found.flags
    if Flag.OCCLUDED in found.flags and np.isfinite(found.a_px).all():
        sd = np.sqrt(np.trace(found.covariance_px2[2:4, 2:4]))
        assert abs(np.hypot(*found.a_px) - length) < 5 * sd + 0.05
