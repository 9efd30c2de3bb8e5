"""What a lens does to a point of light: diffraction by a round aperture, with defocus, for each colour of the mosaic.

The optical transfer function of a circular pupil with defocus is the autocorrelation of the pupil, and reduces to one
integral (Hopkins 1955), here with ν the spatial frequency as a fraction of the cut-off 1/(λN) and w the defocus in
waves at the pupil's edge:

    OTF(ν) = 4/π ∫_0^{1-ν} cos(8π w ν x) sqrt(1 - (x + ν)²) dx

With w = 0 its transform is the Airy pattern. Gaussian optics are offered for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from labdrivers.sim.lens import FloatArray

COLOURS = 3
"""Red, green, blue."""


@dataclass(frozen=True, slots=True)
class Optics:
    """A lens as it blurs.

    Attributes
    ----------
    kind
        ``airy`` (diffraction, per colour) or ``gaussian`` (one width for all colours).
    f_number
        Aperture.
    wavelengths_um
        Of red, green and blue; each colour is a band of ±`band_um` about it.
    pitch_um
        Size of a pixel.
    sigma_px
        Standard deviation for ``gaussian``.
    defocus_px
        Diameter of the geometric blur circle, pixels (with ``gaussian``: the same variance, added).
    """

    kind: Literal["airy", "gaussian"] = "airy"
    f_number: float = 32.0
    wavelengths_um: tuple[float, float, float] = (0.61, 0.54, 0.465)
    band_um: float = 0.03
    pitch_um: float = 6.1
    sigma_px: float = 0.8
    defocus_px: float = 0.0

    def cutoff_per_px(self) -> float | None:
        """Frequency (cycles/px) beyond which nothing passes in any colour; None when there is no such frequency."""
        if self.kind == "gaussian":
            return None
        return self.pitch_um / ((min(self.wavelengths_um) - self.band_um) * self.f_number)

    def transfer(self, frequency_per_px: FloatArray, colour: int) -> FloatArray:
        """Transfer function of one colour at radial frequencies (any shape), cycles per pixel."""
        frequency = np.asarray(frequency_per_px, float)
        if self.kind == "gaussian":
            variance = self.sigma_px**2 + self.defocus_px**2 / 16.0
            return np.asarray(np.exp(-2.0 * np.pi**2 * variance * frequency**2))
        grid, curve = _band_curve(self, colour)
        return np.asarray(np.interp(frequency, grid, curve, right=0.0))


@lru_cache(maxsize=64)
def _band_curve(optics: Optics, colour: int) -> tuple[FloatArray, FloatArray]:
    """Transfer function of one colour's band of wavelengths over frequency, cycles per pixel."""
    centre = optics.wavelengths_um[colour]
    wavelengths = (centre - optics.band_um, centre, centre + optics.band_um)
    highest = optics.pitch_um / (wavelengths[0] * optics.f_number)
    grid = np.linspace(0.0, highest, 6001)
    total = np.zeros_like(grid)
    for wavelength in wavelengths:
        waves = optics.defocus_px * optics.pitch_um / (8.0 * optics.f_number * wavelength)
        fraction, curve = _pupil_curve(round(waves, 9))
        cutoff = optics.pitch_um / (wavelength * optics.f_number)
        total += np.interp(grid / cutoff, fraction, curve, right=0.0)
    return grid, total / len(wavelengths)


@lru_cache(maxsize=64)
def _pupil_curve(waves: float) -> tuple[FloatArray, FloatArray]:
    """The integral above on a fine grid of ν in [0, 1]."""
    grid = np.linspace(0.0, 1.0, 4001)
    nodes, weights = np.polynomial.legendre.leggauss(96)
    # x = (1 - ν)(1 - s²) takes the square root's end point out of the integrand
    s = 0.5 * (nodes + 1.0)
    span = (1.0 - grid)[:, None]
    x = span * (1.0 - s**2)
    inside = np.sqrt(np.clip(1.0 - (x + grid[:, None]) ** 2, 0.0, None))
    integrand = np.cos(8.0 * np.pi * waves * grid[:, None] * x) * inside * 2.0 * s * span
    return grid, (4.0 / np.pi) * (integrand @ (0.5 * weights))
