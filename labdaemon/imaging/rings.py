"""Ring codes, the conventional circular coded targets: a dot, and around it a ring whose segments spell a number.

The dot has radius r; the ring reaches from 2r to 3r and is cut into 12 or 14 equal segments. Dark segments are ones,
read clockwise as one looks at the target, the most significant first, from wherever the number becomes smallest
(Schneider 1991; patent DE 197 33 466 A1, expired).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import Dot, Ellipse
from labdaemon.errors import UsageError
from labdaemon.imaging.dots import find_dots
from labdaemon.imaging.frame import Grey, RawFrame

FloatArray = NDArray[np.float64]

BITS = (12, 14)
_SAMPLES = 840
"""Samples around the ring: a multiple of 12 and of 14."""
_CORE = 0.5
"""Middle part of a segment that must be all dark or all light."""


@dataclass(frozen=True, slots=True)
class Ring:
    """A ring-coded target in a frame.

    Attributes
    ----------
    name
        Its place in the code book, from 1, as text; for a code that is not in the book, `code` in brackets.
    code
        The number its segments spell, in its smallest rotation.
    dot
        The dot in its middle, which is what is measured.
    reach
        How far the whole target reaches, in radii of the dot.
    """

    name: str
    code: int
    dot: Dot
    reach: float = 3.2

    @property
    def outline_px(self) -> FloatArray:
        """(48, 2) polygon around the whole target: to be excluded where plain dots are looked for."""
        return _shape(self.dot).points(np.arange(48) * (2.0 * np.pi / 48), self.reach)


def smallest_rotation(code: int, bits: int) -> int:
    """Smallest number that a cyclic rotation of `bits` bits makes of `code`."""
    mask = (1 << bits) - 1
    return min(((code << k) & mask) | (code >> (bits - k)) for k in range(bits))


@cache
def code_book(bits: int) -> tuple[int, ...]:
    """The codes of `bits` segments; a code's id is its place, from 1. 147 codes of 12 bits, 516 of 14.

    Kept are numbers in their smallest rotation that have an even count of ones and at least one pair of opposite
    segments that are both dark.

    Raises
    ------
    UsageError
        `bits` is neither 12 nor 14.
    """
    if bits not in BITS:
        raise UsageError(f"ring codes have 12 or 14 segments, not {bits}")
    half = bits // 2
    book: dict[int, None] = {}
    for i in range(1 << (bits - 2)):
        code = smallest_rotation(2 * i + 1, bits)
        opposite = code & (code >> half) & ((1 << half) - 1)
        if code.bit_count() % 2 == 0 and opposite:
            book.setdefault(code)
    return tuple(book)


def find_rings(
    frame: RawFrame | Grey,
    *,
    bits: int = 12,
    dots: Sequence[Dot] | None = None,
    unlisted: bool = False,
    ring: tuple[float, float] = (2.0, 3.0),
) -> list[Ring]:
    """Find and read ring-coded targets in a sharp frame.

    Parameters
    ----------
    frame
        The frame, or its `grey()`.
    bits
        Number of segments: 12 or 14, with `unlisted` any divisor of 840.
    dots
        Dots already found in it, the rings' own among them; found anew if None.
    unlisted
        Return rings whatever their code (other makers' sheets), those not in a book named by the code in brackets.
    ring
        Inner and outer radius of the ring in radii of the dot.

    Returns
    -------
    Rings by id; one id twice if two prints of it are in view.

    Raises
    ------
    UsageError
        There is no book for `bits` segments, or they do not divide the circle's samples.
    """
    if unlisted and (bits < 4 or _SAMPLES % bits):
        raise UsageError(f"a ring of {bits} segments cannot be read; take a divisor of {_SAMPLES} from 4 on")
    book = {} if unlisted and bits not in BITS else {code: place + 1 for place, code in enumerate(code_book(bits))}
    grey = frame.grey() if isinstance(frame, RawFrame) else np.ascontiguousarray(frame, dtype=np.float32)
    found: list[tuple[int, Ring]] = []
    for dot in find_dots(grey) if dots is None else dots:
        code = _read(grey, dot, bits, ring)
        if code is None or not (code in book or unlisted):
            continue
        place = book.get(code, 0)
        found.append((place, Ring(str(place) if place else f"[{code}]", code, dot, ring[1] + 0.2)))
    return [ring for _, ring in sorted(found, key=lambda pair: (pair[0], pair[1].code))]


def _shape(dot: Dot) -> Ellipse:
    return Ellipse(dot.x_px, dot.y_px, dot.semi_major_px, dot.semi_minor_px, dot.angle_rad)


def _read(grey: Grey, dot: Dot, bits: int, ring: tuple[float, float]) -> int | None:
    """The number around a dot in its smallest rotation, None where there is no cleanly cut ring."""
    angles = np.arange(_SAMPLES) * (2.0 * np.pi / _SAMPLES)
    # Inside the dot, in the gap, and three circles of the ring, clear of its edges.
    inner, width = ring[0], ring[1] - ring[0]
    scales = np.array([0.0, 0.4, 0.5 * (1.0 + inner), *(inner + part * width for part in (0.3, 0.5, 0.7))])
    points = _shape(dot).points(angles[:, None], np.tile(scales, (_SAMPLES, 1)))
    height, across = grey.shape
    if points.min() < 0.0 or points[..., 0].max() > across - 1 or points[..., 1].max() > height - 1:
        return None
    at = points.astype(np.float32)
    values = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    ink, paper = float(np.median(values[:, :2])), float(np.median(values[:, 2]))
    darkness = (paper - values[:, 2:]) / max(paper - ink, 1e-9)
    if (darkness[:, 0] > 0.5).any():
        return None
    dark = darkness[:, 1:] > 0.5
    if dark.all() or not dark.any() or (dark.min(axis=1) != dark.max(axis=1)).mean() > 0.1:
        return None
    return _decode(dark.mean(axis=1), bits)


def _decode(around: FloatArray, bits: int) -> int | None:
    """Cut darkness (samples in 0..1, clockwise) into segments at the phase that fits best, and read them."""
    width = len(around) // bits
    core = slice(int(width * (1.0 - _CORE) / 2.0), int(width * (1.0 + _CORE) / 2.0))
    best, best_doubt = None, 1.0
    for phase in range(width):
        segments = np.roll(around, -phase).reshape(bits, width)
        doubt = float(np.abs(segments - np.round(segments.mean(axis=1))[:, None]).mean())
        if doubt < best_doubt:
            best, best_doubt = segments, doubt
    if best is None or best_doubt > 0.12:
        return None
    level = best[:, core].mean(axis=1)
    if (np.abs(level - 0.5) < 0.35).any():
        return None
    code = 0
    for bit in level > 0.5:
        code = 2 * code + int(bit)
    return smallest_rotation(code, bits) if 0 < code < (1 << bits) - 1 else None
