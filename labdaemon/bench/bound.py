"""The Cramér–Rao bound: the least standard deviation that any unbiased measurement of a frame could have.

Fisher's information is J' C⁻¹ J with J the derivatives of the noise-free picture, taken numerically from the renderer,
and C the covariance of its pixels: photon and read noise, which are independent, and the paper's grain, which is not.
The grain moves with the paper, so the motion smears it: its spectrum is multiplied by that of the path's dwell time.
Counted as unknown: position, motion in both directions, ink and paper in each colour, and a slope of the light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.bench.simulator import Renderer
from labdaemon.blur.patch.pixels import FloatArray

PX_PER_MM = 24.0 / 6.1
"""Of the set-up at 1 m."""

LENS_SIGMA_PX = 1.25
"""Gaussian that stands in for the lens where grain is smeared (not where the dot is)."""


@dataclass(frozen=True, slots=True)
class Light:
    """Noise of a picture.

    Attributes
    ----------
    white_dn
        What white paper reads in green.
    electrons_per_dn, read_noise_e
        Photon transfer.
    texture, texture_length_mm
        The paper's grain.
    """

    white_dn: float = 2900.0
    electrons_per_dn: float = 8.5
    read_noise_e: float = 7.0
    texture: float = 0.004
    texture_length_mm: float = 0.3


def motion_bound_mm(
    render: Renderer, diameter_mm: float, amplitude_mm: float, light: Light, *, angle_rad: float = 0.5
) -> tuple[float, float]:
    """Least standard deviation of one target's motion.

    Parameters
    ----------
    render
        The renderer.
    diameter_mm, amplitude_mm
        Of dot and motion.
    light
        Noise.
    angle_rad
        Direction of the motion in the image.

    Returns
    -------
    along, across
        Of the semi-amplitude vector's component along the motion, and across it, mm.
    """
    along = np.array([np.cos(angle_rad), 0.0, np.sin(angle_rad)])
    across = np.array([-np.sin(angle_rad), 0.0, np.cos(angle_rad)])

    def picture(
        x: float = 0.0, y: float = 0.0, a: float = amplitude_mm, b: float = 0.0, ink: float = 0.05
    ) -> FloatArray:
        return _picture(render, diameter_mm, amplitude_mm, a * along + b * across, (x, y), ink, light)

    step = 0.02
    # The second-order rule is exact enough: the picture bends over a few tenths of a millimetre.
    by_x = (picture(x=step) - picture(x=-step)) / (2.0 * step)
    by_y = (picture(y=step) - picture(y=-step)) / (2.0 * step)
    by_a = (picture(a=amplitude_mm + step) - picture(a=amplitude_mm - step)) / (2.0 * step)
    by_b = (picture(b=step) - picture(b=-step)) / (2.0 * step)
    middle = picture()
    by_ink = (picture(ink=0.07) - picture(ink=0.03)) / 0.04
    colour = _colours(middle.shape)
    rows, columns = np.indices(middle.shape)
    slopes = [middle * (grid - grid.mean()) / grid.max() for grid in (rows, columns)]
    per_colour = [part * (colour == c) for part in (middle, by_ink) for c in range(3)]
    jacobian = np.stack([by_a, by_x, by_y, by_b, *slopes, *per_colour])
    inverse = _Covariance(middle, light, amplitude_mm * along[[0, 2]] * PX_PER_MM)
    weighted = np.stack([inverse.solve(column) for column in jacobian])
    information = np.einsum("ihw,jhw->ij", jacobian, weighted)
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale))
    bounds = np.sqrt(np.diag(covariance)) / scale
    return float(bounds[0]), float(bounds[3])


def _picture(
    render: Renderer,
    diameter_mm: float,
    amplitude_mm: float,
    vector_mm: FloatArray,
    centre_mm: tuple[float, float],
    ink: float,
    light: Light,
) -> FloatArray:
    """Noise-free picture of one dot on paper that reaches beyond the picture."""
    half = int(np.ceil((0.5 * diameter_mm + amplitude_mm) * PX_PER_MM)) + 14
    size = 2 * half + 1
    sheet = (size + 40) / PX_PER_MM
    x, z = centre_mm
    scene: dict[str, Any] = {
        "targets": [
            {"name": "T", "centre_mm": (x, 0.0, z), "diameter_mm": diameter_mm, "paper_mm": (sheet, sheet)},
        ],
        "ink": ink,
        "texture": 0.0,
        "gradient": (0.0, 0.0),
        "vignetting": 0.0,
        "clutter": 0,
        "still_paper": True,
    }
    camera = {
        "image_size": (size, size),
        "focal_px": (1000.0 * PX_PER_MM, 1000.0 * PX_PER_MM),
        "principal_point_px": (half + 0.3, half - 0.2),
        "position_mm": (0.0, -1000.0, 0.0),
    }

    def motion(t: FloatArray) -> FloatArray:
        return np.sin(2.0 * np.pi * 5.0 * t)[:, None] * vector_mm

    frame = render(scene, camera, motions={"T": motion}, white_dn=light.white_dn)
    return np.asarray(frame.mean_dn, np.float64)


def _colours(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Colour of each pixel of an RGGB mosaic."""
    row, column = np.indices(shape)
    return np.asarray((row % 2) + (column % 2))


class _Covariance:
    """Pixel covariance C = D + M K M: independent noise, and grain K seen through the picture's brightness M."""

    def __init__(self, middle: FloatArray, light: Light, semi_amplitude_px: FloatArray) -> None:
        self._noise = middle / light.electrons_per_dn + (light.read_noise_e / light.electrons_per_dn) ** 2
        self._bright = middle
        height, width = middle.shape
        fy, fx = np.fft.fftfreq(2 * height)[:, None], np.fft.rfftfreq(2 * width)[None, :]
        length = light.texture_length_mm * PX_PER_MM
        grain = light.texture**2 * 2.0 * np.pi * length**2 * np.exp(-2.0 * np.pi**2 * length**2 * (fx**2 + fy**2))
        lens = np.exp(-4.0 * np.pi**2 * LENS_SIGMA_PX**2 * (fx**2 + fy**2)) * np.sinc(fx) ** 2 * np.sinc(fy) ** 2
        moments = np.sin(2.0 * np.pi * (np.arange(256) + 0.5) / 256)
        # z is up and y is down
        turns = fx * semi_amplitude_px[0] - fy * semi_amplitude_px[1]
        dwell = np.zeros_like(turns, dtype=complex)
        for moment in moments:
            dwell += np.exp(-2j * np.pi * moment * turns)
        self._spectrum = grain * lens * np.abs(dwell / moments.size) ** 2

    def times(self, vector: FloatArray) -> FloatArray:
        """C applied to a picture."""
        height, width = vector.shape
        spectrum = np.fft.rfft2(self._bright * vector, (2 * height, 2 * width)) * self._spectrum
        grain = np.fft.irfft2(spectrum, (2 * height, 2 * width))[:height, :width]
        return np.asarray(self._noise * vector + self._bright * grain)

    def solve(self, right: FloatArray) -> FloatArray:
        """C⁻¹ applied to a picture, by conjugate gradients preconditioned with the independent noise."""
        x = np.zeros_like(right)
        residual = right.copy()
        z = residual / self._noise
        direction = z.copy()
        rho = float((residual * z).sum())
        start = rho
        for _ in range(200):
            image = self.times(direction)
            step = rho / float((direction * image).sum())
            x += step * direction
            residual -= step * image
            z = residual / self._noise
            now = float((residual * z).sum())
            if now < 1e-12 * start:
                break
            direction = z + (now / rho) * direction
            rho = now
        return x


@dataclass(frozen=True, slots=True, eq=False)
class BoundTable:
    """The bound for a set of dots, over amplitude.

    Attributes
    ----------
    amplitude_mm
        (n,) ascending.
    along_mm, across_mm
        Diameter -> (n,): of the semi-amplitude's length, and of its component across the motion.
    """

    amplitude_mm: FloatArray
    along_mm: dict[float, FloatArray]
    across_mm: dict[float, FloatArray]

    def at(self, diameter_mm: float, amplitude_mm: float) -> float:
        """The bound of the semi-amplitude between tabulated ones (logarithmic), mm."""
        return self._between(self.along_mm[diameter_mm], amplitude_mm)

    def direction_deg(self, diameter_mm: float, amplitude_mm: float) -> float:
        """The bound of the motion's direction."""
        across = self._between(self.across_mm[diameter_mm], amplitude_mm)
        return float(np.degrees(np.arctan2(across, amplitude_mm)))

    def _between(self, table: FloatArray, amplitude_mm: float) -> float:
        return float(np.exp(np.interp(np.log(amplitude_mm), np.log(self.amplitude_mm), np.log(table))))


def bound_table(render: Renderer, diameters_mm: tuple[float, ...], light: Light, count: int = 7) -> BoundTable:
    """Tabulate the bound from 0.1 to 12 mm."""
    amplitudes = np.geomspace(0.1, 12.0, count)
    along: dict[float, FloatArray] = {}
    across: dict[float, FloatArray] = {}
    for diameter in diameters_mm:
        both = np.array([motion_bound_mm(render, diameter, float(a), light) for a in amplitudes])
        along[diameter], across[diameter] = both.T
    return BoundTable(amplitudes, along, across)
