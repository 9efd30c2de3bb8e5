from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labdaemon.errors import UsageError
from labdaemon.imaging.dots import find_dots
from labdaemon.imaging.rings import code_book, find_rings, smallest_rotation


def draw_ring(canvas: Any, x: float, y: float, r: float, code: int, bits: int, turn: float) -> None:
    """By the convention alone: clockwise in the picture, most significant bit first, segments from 2r to 3r."""
    for k in range(bits):
        if code >> (bits - 1 - k) & 1:
            first = turn + 360.0 * k / bits
            canvas.ellipse(x, y, 3 * r, 3 * r, 0.0, 0.05, (first, first + 360.0 / bits))
    canvas.ellipse(x, y, 2 * r, 2 * r, 0.0, 0.85)
    canvas.ellipse(x, y, r, r, 0.0, 0.05)


def test_the_code_books_are_the_published_ones() -> None:
    assert len(code_book(12)) == 147
    assert len(code_book(14)) == 516
    assert code_book(12)[:5] == (65, 71, 75, 77, 83)
    assert code_book(14)[:3] == (129, 135, 139)
    for bits in (12, 14):
        assert len(set(code_book(bits))) == len(code_book(bits))
        assert all(smallest_rotation(code, bits) == code for code in code_book(bits))
    with pytest.raises(UsageError, match="12 or 14"):
        code_book(10)


@pytest.mark.parametrize("bits", [12, 14])
def test_rings_are_read_at_any_turn_and_size_and_their_dots_stay_dots(canvas: Any, bits: int) -> None:
    rng = np.random.default_rng(bits)
    ids = sorted(int(n) for n in rng.choice(len(code_book(bits)), 8, replace=False) + 1)
    sheet = canvas(1000, 500, ground=0.85)
    places = {}
    for k, number in enumerate(ids):
        x, y, r = 125 + 250 * (k % 4), 125 + 250 * (k // 4), float(rng.uniform(8, 36))
        draw_ring(sheet, x, y, r, code_book(bits)[number - 1], bits, float(rng.uniform(0, 360)))
        places[str(number)] = (x, y)
    grey = sheet.develop(rng, hot=30)
    rings = find_rings(grey, bits=bits)
    assert [ring.name for ring in rings] == [str(n) for n in ids]
    for ring in rings:
        assert np.hypot(ring.dot.x_px - places[ring.name][0], ring.dot.y_px - places[ring.name][1]) < 0.1
    assert len(find_dots(grey)) == 8
    assert find_dots(grey, exclude=[ring.outline_px for ring in rings]) == []


def test_a_ring_seen_obliquely(canvas: Any) -> None:
    """The same target squeezed to 55 %, as at 57 degrees, and turned."""
    rng = np.random.default_rng(4)
    sheet = canvas(400, 400, ground=0.85)
    draw_ring(sheet, 200, 200, 40, code_book(12)[41], 12, 20.0)
    squeeze = cv2.getRotationMatrix2D((800.0, 800.0), 30.0, 1.0)
    squeeze[0] *= 0.55
    squeeze[0, 2] += 800 * 0.45
    sheet.fine = cv2.warpAffine(sheet.fine, squeeze, sheet.fine.shape[::-1], borderValue=0.85)
    (ring,) = find_rings(sheet.develop(rng, hot=10))
    assert ring.name == "42"


def test_mirrored_rings_are_another_number_or_none(canvas: Any) -> None:
    code = next(c for c in code_book(12) if smallest_rotation(int(f"{c:012b}"[::-1], 2), 12) != c)
    mirrored = smallest_rotation(int(f"{code:012b}"[::-1], 2), 12)
    sheet = canvas(300, 300, ground=0.85)
    draw_ring(sheet, 150, 150, 30, code, 12, 0.0)
    grey = np.ascontiguousarray(sheet.develop(np.random.default_rng(5), hot=0)[:, ::-1])
    (ring,) = find_rings(grey, unlisted=True)
    assert ring.code == mirrored


def test_plain_dots_and_broken_rings_are_no_codes(canvas: Any) -> None:
    sheet = canvas(600, 300, ground=0.85)
    sheet.ellipse(150, 150, 30, 30, 0, 0.05)
    draw_ring(sheet, 430, 150, 30, code_book(12)[9], 12, 0.0)
    sheet.box(400, 60, 60, 35, 0.85)
    assert find_rings(sheet.develop(np.random.default_rng(6), hot=0)) == []


def test_segments_that_do_not_divide_are_refused() -> None:
    with pytest.raises(UsageError, match="11 segments"):
        find_rings(np.zeros((50, 50), dtype=np.float32), bits=11, unlisted=True)


@pytest.mark.slow
def test_another_makers_rings_in_photographs(shared_data: Path) -> None:
    """PhotoModeler's sheet has four rings of eight segments from 2.4 to 4.2 radii; every view must agree on them."""
    for photo in range(21, 42, 4):
        file = shared_data / "camcal" / "images" / f"P82500{photo}.JPG"
        grey = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255) ** np.float32(2.2)
        rings = find_rings(grey, bits=8, ring=(2.4, 4.2), unlisted=True)
        assert [ring.code for ring in rings] == [31, 37, 51, 85]
