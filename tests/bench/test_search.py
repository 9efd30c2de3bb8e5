"""The bench of covered targets: its covers and its pushed frames are what they say."""

from pathlib import Path

import numpy as np
import pytest

from labdaemon.bench.search import COVER_PX, cover, shift_and_turn
from labdaemon.imaging import RawFrame

PATTERN = np.array([[0, 1], [2, 3]], np.uint8)


def frame() -> RawFrame:
    rng = np.random.default_rng(1)
    values = rng.integers(2000, 2600, (300, 400)).astype(np.uint16)
    return RawFrame(Path("f.dng"), values, PATTERN, np.zeros((1, 1)), 4095.0)


def test_a_card_covers_its_target_and_nothing_else():
    whole = frame()
    covered = cover(whole, np.array([[200.0, 150.0]]))
    changed = np.argwhere(covered.values != whole.values)
    assert np.ptp(changed, axis=0) == pytest.approx((COVER_PX - 1, COVER_PX - 1), abs=1)
    assert np.mean(covered.values[150, 180:220]) < 0.5 * np.mean(whole.values)


def test_a_cluttered_card_has_spots_of_the_size_of_dots():
    plain, spots = (cover(frame(), np.array([[200.0, 150.0]]), clutter=c).values[110:190, 160:240] for c in (0.0, 0.17))
    assert np.std(spots) > 5 * np.std(plain)
    assert np.mean(np.abs(np.diff(spots.astype(float), axis=0))) < 0.3 * np.std(spots), "smooth over several pixels"


def test_a_card_at_the_border_is_cut():
    assert cover(frame(), np.array([[3.0, 299.0]])).values.shape == (300, 400)


def test_a_pushed_frame_keeps_its_mosaic():
    whole = frame()
    moved = shift_and_turn(whole, (20, -8), 0.0)
    assert np.array_equal(moved.values[50:250, 60:360], whole.values[58:258, 40:340])
