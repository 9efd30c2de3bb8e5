"""From light to the numbers in a RAW file: mosaic, photon and read noise, fixed pattern, clipping, compression."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.scene import Mosaic

FloatImage = NDArray[np.float32]

D80_LEVELS = 683
"""Distinct values in a Nikon D80's compressed NEF."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """A 12-bit CMOS or CCD sensor behind a Bayer mosaic.

    Attributes
    ----------
    pattern
        Four letters, row by row from the top left pixel; ``GRAY`` for none.
    gains
        Sensitivity of red, green and blue relative to green.
    electrons_per_dn, read_noise_e
        Photon transfer.
    black, white
        Level of no light, and the largest value.
    prnu
        Relative standard deviation of the pixels' own sensitivities.
    hot
        Fraction of pixels that are hot.
    nef
        Quantise along a curve as the D80's compressed NEF does.
    serial
        Seed of the fixed pattern: each body has its own.
    """

    pattern: str = "RGGB"
    gains: tuple[float, float, float] = (0.58, 1.0, 0.72)
    electrons_per_dn: float = 8.5
    read_noise_e: float = 7.0
    black: int = 0
    white: int = 4095
    prnu: float = 0.004
    hot: float = 2e-5
    nef: bool = False
    serial: int = 1

    def colour(self, row: int, column: int) -> int:
        """Colour index (0 red, 1 green, 2 blue) of a pixel."""
        return 1 if self.pattern == "GRAY" else "RGB".index(self.pattern[2 * (row % 2) + column % 2])

    def gain(self, colour: int) -> float:
        """Sensitivity of a colour relative to green."""
        return 1.0 if self.pattern == "GRAY" else self.gains[colour]

    def expose(self, mean_dn: FloatImage, seed: int) -> Mosaic:
        """Numbers read out for an expected image (h, w) in DN above black, before PRNU."""
        rng = np.random.default_rng([seed, 3])
        height, width = mean_dn.shape
        pattern, hot = fixed_pattern(self.serial, height, width, self.prnu, self.hot)
        signal = mean_dn * pattern
        noise = np.multiply(signal, 1.0 / self.electrons_per_dn)
        noise += (self.read_noise_e / self.electrons_per_dn) ** 2
        np.sqrt(noise, out=noise)
        noise *= rng.standard_normal((height, width), dtype=np.float32)
        signal += noise
        signal += self.black
        rows, columns, level = hot
        signal[rows, columns] += level * (self.white - self.black)
        np.rint(signal, out=signal)
        np.clip(signal, 0, self.white, out=signal)
        counts = signal.astype(np.uint16)
        if self.nef:
            counts = nef_curve(self.white)[counts]
        return counts


@lru_cache(maxsize=4)
def fixed_pattern(
    serial: int, height: int, width: int, prnu: float, hot: float
) -> tuple[FloatImage, tuple[NDArray[np.intp], NDArray[np.intp], FloatImage]]:
    """A body's own sensitivities (h, w), and its hot pixels: rows, columns, fraction of the range added."""
    rng = np.random.default_rng([serial, 11])
    pattern = rng.standard_normal((height, width), dtype=np.float32)
    pattern *= np.float32(prnu)
    pattern += 1.0
    pattern.flags.writeable = False
    count = round(hot * height * width)
    where = rng.integers(0, height * width, count)
    level = rng.uniform(0.15, 1.2, count).astype(np.float32)
    return pattern, (where // width, where % width, level)


@lru_cache(maxsize=4)
def nef_curve(white: int) -> Mosaic:
    """Table (white + 1,) that maps each value to the nearest of the 683 levels of a D80's compressed NEF.

    Linear in the shadows, then steps that grow with the level and stay below photon noise (about 16 DN at the top).
    """
    linear = 215
    index = np.arange(D80_LEVELS, dtype=float)
    over = np.clip(index - linear, 0.0, None)
    curve = index + (white - (D80_LEVELS - 1)) * (over / (D80_LEVELS - 1 - linear)) ** 2
    levels = np.rint(curve).astype(np.int64)
    values = np.arange(white + 1)
    upper = np.clip(np.searchsorted(levels, values), 1, D80_LEVELS - 1)
    nearest = np.where(values - levels[upper - 1] < levels[upper] - values, levels[upper - 1], levels[upper])
    return np.asarray(nearest, np.uint16)
