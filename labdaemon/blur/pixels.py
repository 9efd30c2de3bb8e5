"""A rectangle of one frame's sensor values, and their noise: all that the blur measurement sees of a frame.

Pixel centres are at integers, x to the right, y down. Values are linear in light: raw counts less the black level,
never demosaiced, never tone-mapped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


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
    valid: NDArray[np.bool_]
    origin_px: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        height, width = self.values.shape
        return height, width


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Variance of a pixel as a function of its value: read noise and photon noise.

    Attributes
    ----------
    read_dn
        Standard deviation at zero signal, DN.
    gain_dn
        Photon variance per DN of signal (1 / (electrons per DN)), DN.
    """

    read_dn: float
    gain_dn: float

    def variance(self, signal: FloatArray) -> FloatArray:
        """Variance (DN²) of pixels whose expected value is `signal` (DN)."""
        result: FloatArray = self.read_dn**2 + self.gain_dn * np.maximum(signal, 0.0)
        return result


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
    """

    x_px: float
    y_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float
    paper_px: float = float("inf")
    name: str = ""
