"""Rough looks at patches."""

import numpy as np
import pytest

from labdaemon.blur.patch.locate import darkness_map, find_blob

CONTRAST = dict.fromkeys(range(4), 0.92)


def look(area, patch, near, radius, contrast=CONTRAST):
    return find_blob(patch, np.array(near), np.pi * radius**2, contrast)


@pytest.mark.parametrize("bayer", [False, True])
def test_a_large_dot_looks_the_same_at_half_the_resolution(area, bayer):
    scene = area.Scene(radius_px=14.0, bayer=bayer, gradient=(0.002, -0.001), white_dn=(2500.0,) * (4 if bayer else 1))
    patch = area.render(scene, (75, 81), (41.3, 36.6), area.whole_cycles(6, 2), seed=4)
    coarse, fine = look(area, patch, (40, 37), 14.0), look(area, patch, (40, 37), 14.0, contrast=None)
    assert coarse is not None
    assert fine is not None
    np.testing.assert_allclose(coarse.centre_px, fine.centre_px, atol=0.1)
    np.testing.assert_allclose(coarse.moment_px2, fine.moment_px2, atol=0.06 * np.trace(fine.moment_px2))
    np.testing.assert_allclose(coarse.box_px, fine.box_px, atol=3)
    assert coarse.area_px2 == pytest.approx(fine.area_px2, rel=0.05)
    assert not coarse.clipped
    assert not coarse.other_blobs.any()


def test_what_else_is_dark_is_marked_on_all_of_its_pixels(area):
    scene = area.Scene(radius_px=10.0)
    one = area.render(scene, (61, 91), (25.0, 30.0), seed=5)
    other = area.render(scene, (61, 91), (70.0, 30.0), seed=6)
    both = type(one)(np.minimum(one.values, other.values), one.channel, one.valid, (100, 200))
    blob = look(area, both, (125, 230), 10.0)
    assert blob is not None
    np.testing.assert_allclose(blob.centre_px, (125, 230), atol=0.2)
    assert blob.other_blobs.shape == both.shape
    y, x = np.mgrid[:61, :91]
    assert blob.other_blobs[np.hypot(x - 70, y - 30) < 11].all()
    assert not blob.other_blobs[np.hypot(x - 25, y - 30) < 15].any()


def test_blobs_along_a_path_are_one_target_and_others_are_not(area):
    """A lamp that is off for parts of the cycle divides a blur."""
    scene = area.Scene(radius_px=10.0)
    places = ((24.0, 30.0), (60.0, 30.0), (42.0, 62.0))
    parts = [area.render(scene, (81, 91), place, seed=k) for k, place in enumerate(places)]
    whole = type(parts[0])(
        np.min([one.values for one in parts], axis=0), parts[0].channel, parts[0].valid, parts[0].origin_px
    )
    near, path = np.array([42.0, 30.0]), np.array([18.0, 0.0])
    blob = find_blob(whole, near, np.pi * 100, CONTRAST, path_px=path)
    assert blob is not None
    np.testing.assert_allclose(blob.centre_px, near, atol=0.3)
    assert blob.box_px[0] < 16
    assert blob.box_px[2] > 68
    assert blob.box_px[3] < 45, "what lies off the path is another"
    y, x = np.mgrid[:81, :91]
    assert blob.other_blobs[np.hypot(x - 42, y - 62) < 10].all()


def test_channels_that_do_not_repeat_every_two_pixels_are_judged_one_by_one(area):
    scene = area.Scene(radius_px=9.0)
    patch = area.render(scene, (48, 48), (24.0, 24.0), seed=7)
    channel = (np.add.outer(np.arange(48), np.arange(48)) % 3).astype(np.uint8)
    values = patch.values * np.array([1.0, 0.5, 0.8])[channel]
    mixed = type(patch)(values, channel, patch.valid, patch.origin_px)
    np.testing.assert_allclose(darkness_map(mixed), darkness_map(patch), atol=0.06)
