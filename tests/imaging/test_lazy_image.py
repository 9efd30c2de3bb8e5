"""What is computed where it is cut is the same image."""

import numpy as np
import pytest

from labdaemon.imaging.frame import RawFrame


def frame(shape, pattern, black, tmp_path):
    rng = np.random.default_rng(3)
    values = rng.integers(100, 4000, shape).astype(np.uint16)
    return RawFrame(tmp_path / "f.dng", values, np.array(pattern, np.uint8), np.asarray(black, float), 4095.0)


@pytest.mark.parametrize(
    "black", [[[50.0]], [[40.0, 60.0, 50.0]], np.full((301, 419), 50.0)], ids=["one", "row", "all"]
)
@pytest.mark.parametrize("pattern", [[[0]], [[0, 1], [2, 3]]], ids=["grey", "bayer"])
def test_any_part_is_that_part_of_the_whole(pattern, black, tmp_path):
    raw = frame((301, 419), pattern, black, tmp_path)
    whole, lazy = raw.grey(), raw.lazy_grey()
    assert whole.shape == lazy.shape == (301, 419)
    for place in (np.s_[0:301, 0:419], np.s_[17:60, 3:4], np.s_[290:999, 400:999], np.s_[5:5, 0:9], np.s_[1:300, 2:3]):
        np.testing.assert_array_equal(lazy[place], whole[place])


def test_its_sample_tells_how_bright_it_is(tmp_path):
    raw = frame((301, 419), [[0, 1], [2, 3]], [[50.0]], tmp_path)
    assert np.mean(raw.lazy_grey().sample) == pytest.approx(float(raw.grey().mean()), rel=0.01)
