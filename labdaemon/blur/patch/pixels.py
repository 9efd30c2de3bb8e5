"""A rectangle of one frame's sensor values, and their noise: all that the blur measurement sees of a frame.

Pixel centres are at integers, x to the right, y down. Values are linear in light: raw counts less the black level,
never demosaiced, never tone-mapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]

PIXEL_VARIANCE_PX2 = 1 / 12
"""Of a square pixel's aperture."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A rectangle cut from a frame.

    Attributes
    ----------
    values
        (h, w) float, counts above black (DN).
    channel
        (h, w) uint8, which colour channel each pixel belongs to (0 throughout for a grey sensor; 0..3 for a Bayer
        mosaic, where the two greens are two channels).
    valid
        (h, w) bool, False where saturated, hot, or beyond the frame.
    origin_px
        (x, y) of `values[0, 0]` in the frame.
    """

    values: FloatArray
    channel: NDArray[np.uint8]
    valid: BoolArray
    origin_px: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        height, width = self.values.shape
        return height, width

    def crop(self, left: int, top: int, width: int, height: int) -> Patch:
        """Cut a smaller patch; `left` and `top` are frame coordinates, and what lies outside is left away."""
        x0, y0 = max(left - self.origin_px[0], 0), max(top - self.origin_px[1], 0)
        x1, y1 = left - self.origin_px[0] + width, top - self.origin_px[1] + height
        part = (slice(y0, max(y1, y0)), slice(x0, max(x1, x0)))
        return Patch(
            self.values[part], self.channel[part], self.valid[part], (x0 + self.origin_px[0], y0 + self.origin_px[1])
        )


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Covariance of pixels: read noise, photon noise, and the paper's texture.

    Attributes
    ----------
    read_dn
        Standard deviation at zero signal, DN.
    gain_dn
        Photon variance per DN of signal (1 / (electrons per DN)), DN.
    texture
        Standard deviation of the paper's reflectance, relative to its mean. Unlike the other two it is correlated
        from pixel to pixel and moves with the paper.
    texture_px
        Its correlation length: the correlation at a distance r is exp(−r²/(4·texture_px²)), that of white noise
        smoothed by a Gaussian of this standard deviation.
    """

    read_dn: float
    gain_dn: float
    texture: float = 0.0
    texture_px: float = 1.0

    def variance(self, signal: FloatArray) -> FloatArray:
        """Variance (DN²), texture aside, of pixels whose expected value is `signal` (DN)."""
        result: FloatArray = self.read_dn**2 + self.gain_dn * np.maximum(signal, 0.0)
        return result

    def seen_through(self, lens_sigma_px: float) -> NoiseModel:
        """The same with the paper's own texture as lens and pixels show it: longer and weaker, its power at f = 0 kept.

        Parameters
        ----------
        lens_sigma_px
            Standard deviation of the lens' blur.
        """
        seen_px = math.sqrt(self.texture_px**2 + lens_sigma_px**2 + PIXEL_VARIANCE_PX2)
        return replace(self, texture=self.texture * self.texture_px / seen_px, texture_px=seen_px)


@dataclass(frozen=True, slots=True)
class Dot:
    """A dark dot on white paper as first found in a sharp frame: a start for the fit, good to a pixel or better.

    Attributes
    ----------
    x_px, y_px
        Centre in the frame.
    semi_major_px, semi_minor_px, angle_rad
        Its ellipse; the angle runs from +x towards +y to the major axis.
    paper_px
        Distance from the centre to the nearest edge of the white paper (what the smear may not reach); inf if unknown.
    name
        The target's name, empty until it has one.
    label_px
        Distance from the centre to the end of the paper along rays evenly around it, from +x towards +y; empty if
        unknown.
    """

    x_px: float
    y_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float
    paper_px: float = float("inf")
    name: str = ""
    label_px: tuple[float, ...] = ()
