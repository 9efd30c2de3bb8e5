"""Pictures with known contents: files written by tifffile, scenes drawn four times oversampled."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

FINE = 4


def patch_short(path: Path, tag: int, value: int) -> None:
    """Put another value in a TIFF tag of one short."""
    data = bytearray(path.read_bytes())
    place = data.find(struct.pack("<HHI", tag, 3, 1))
    assert place > 0
    data[place + 8 : place + 10] = struct.pack("<H", value)
    path.write_bytes(data)


def write_dng(
    path: Path,
    values: np.ndarray,
    *,
    cfa: tuple[int, ...] | None = (0, 1, 1, 2),
    repeat: tuple[int, int] = (2, 2),
    active: tuple[int, int, int, int] | None = None,
    black: tuple[int, ...] | None = None,
    black_repeat: tuple[int, int] = (1, 1),
    delta_v: np.ndarray | None = None,
    delta_h: np.ndarray | None = None,
    white: int = 4095,
    serial: str = "",
    more: tuple[tuple[Any, ...], ...] = (),
    exposures: int = 1,
) -> Path:
    """A DNG by the book: `cfa` None makes it monochrome. Levels and active area as in the specification 1.4.

    `more` are further tags. Values (h, w, n) are n values for each pixel of the mosaic; `exposures` writes as many.
    """
    extra: list[tuple[Any, ...]] = [
        *more,
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50708, "s", 0, "Test", True),
        (50717, "I", 1, white, True),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (50778, "H", 1, 21, True),
    ]
    if cfa is not None:
        extra += [(33421, "H", 2, repeat, True), (33422, "B", len(cfa), cfa, True)]
    if active is not None:
        extra.append((50829, "I", 4, active, True))
    if black is not None:
        extra += [(50713, "H", 2, black_repeat, True), (50714, "I", len(black), black, True)]
    for code, delta in ((50715, delta_h), (50716, delta_v)):
        if delta is not None:
            pairs = [n for d in delta for n in (int(d), 1)]
            extra.append((code, "2i", len(delta), pairs, True))
    if serial:
        extra.append((50735, "s", 0, serial, True))
    several = values.ndim == 3
    layout: dict[str, Any] = {"photometric": 1, "planarconfig": "contig"} if several else {"photometric": 32803}
    with tifffile.TiffWriter(path) as writer:
        for _ in range(exposures):
            kind = {"photometric": 1} if cfa is None else layout
            writer.write(values, **kind, extratags=extra, metadata=None, software=False)
    if several:  # tifffile itself writes mosaics of one value a pixel
        patch_short(path, 262, 32803)
    if cfa is None:  # one-sample LinearRaw, which tifffile itself does not write
        patch_short(path, 262, 34892)
    return path


@pytest.fixture(name="write_dng")
def _write_dng() -> Callable[..., Path]:
    return write_dng


@dataclass
class Canvas:
    """A picture drawn at four times its size in linear light, then blurred, sampled and made noisy."""

    width: int
    height: int
    ground: float = 0.3
    fine: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.fine = np.full((self.height * FINE, self.width * FINE), self.ground, dtype=np.float32)

    def _at(self, x: float, y: float) -> tuple[int, int]:
        """Fixed-point (4 bits) coordinates on the fine canvas of a point in pixels."""
        return round(((x + 0.5) * FINE - 0.5) * 16), round(((y + 0.5) * FINE - 0.5) * 16)

    def box(self, x: float, y: float, w: float, h: float, level: float) -> None:
        a, b = self._at(x, y), self._at(x + w, y + h)
        cv2.rectangle(self.fine, a, b, level, -1, cv2.LINE_8, 4)

    def ellipse(
        self, x: float, y: float, a: float, b: float, angle: float, level: float, span: tuple[float, float] = (0, 360)
    ) -> None:
        axes = (round(a * FINE * 16), round(b * FINE * 16))
        cv2.ellipse(self.fine, self._at(x, y), axes, angle, span[0], span[1], level, -1, cv2.LINE_8, 4)

    def polygon(self, points: np.ndarray, level: float) -> None:
        fixed = np.array([self._at(x, y) for x, y in points], dtype=np.int32)
        cv2.fillPoly(self.fine, [fixed], level, cv2.LINE_8, 4)

    def text(self, x: int, y: int, words: str, scale: float, weight: int, level: float) -> None:
        mask = np.zeros(self.fine.shape, dtype=np.uint8)
        where = (x * FINE, y * FINE)
        cv2.putText(mask, words, where, cv2.FONT_HERSHEY_SIMPLEX, scale * FINE, 255, weight * FINE)
        self.fine[mask > 127] = level

    def develop(
        self, rng: np.random.Generator, *, blur_px: float = 0.8, noise: float = 1.0, hot: int = 100
    ) -> np.ndarray:
        """(h, w) float32: lens blur, pixels, light falling off to the corners, photon and read noise, hot pixels."""
        soft = cv2.GaussianBlur(self.fine, (0, 0), blur_px * FINE)
        picture = cv2.resize(soft, (self.width, self.height), interpolation=cv2.INTER_AREA)
        yy, xx = np.mgrid[: self.height, : self.width]
        picture *= 1.0 - 0.5 * ((xx / self.width - 0.5) ** 2 + (yy / self.height - 0.5) ** 2)
        picture += noise * rng.normal(size=picture.shape) * np.sqrt(2e-6 + 1e-4 * picture)
        picture.ravel()[rng.integers(0, picture.size, hot)] = rng.uniform(0.3, 1.0, hot)
        return np.clip(picture, 0.0, 1.0).astype(np.float32)


@pytest.fixture
def canvas() -> type[Canvas]:
    return Canvas
