"""The Cramér–Rao bound: the least standard deviation that any unbiased measurement of a frame could have.

Fisher's information is J' C⁻¹ J with J the derivatives of the noise-free image, taken numerically from the renderer,
and C the covariance of its pixels: photon and read noise, which are independent, and the paper's texture, which is not.
The texture moves with the paper, so the motion blurs it: the path's dwell time multiplies its spectrum.
Unknowns are position, motion in both directions, ink and paper in each colour, and a slope of the light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.bench.simulator import Renderer
from labdaemon.blur import FloatArray

PX_PER_MM = 24.0 / 6.1
"""Of the set-up at 1 m."""

LENS_SIGMA_PX = 1.25
"""Gaussian that approximates the lens where paper texture is blurred (not where the dot is)."""


@dataclass(frozen=True, slots=True)
class ImageNoise:
    """Brightness and noise of an image.

    Attributes
    ----------
    white_dn
        What white paper reads in green.
    electrons_per_dn, read_noise_e
        Photon transfer.
    texture, texture_length_mm
        Relative sd of the paper's texture, and its correlation length.
    """

    white_dn: float = 2900.0
    electrons_per_dn: float = 8.5
    read_noise_e: float = 7.0
    texture: float = 0.004
    texture_length_mm: float = 0.3


def motion_bound_mm(
    render: Renderer, diameter_mm: float, amplitude_mm: float, light: ImageNoise, *, angle_rad: float = 0.5
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

    def image(x: float = 0.0, y: float = 0.0, a: float = amplitude_mm, b: float = 0.0, ink: float = 0.05) -> FloatArray:
        return _draw_image(render, diameter_mm, amplitude_mm, a * along + b * across, (x, y), ink, light)

    step = 0.02
    # The second-order rule is exact enough: the image curves over a few tenths of a millimetre.
    by_x = (image(x=step) - image(x=-step)) / (2.0 * step)
    by_y = (image(y=step) - image(y=-step)) / (2.0 * step)
    by_a = (image(a=amplitude_mm + step) - image(a=amplitude_mm - step)) / (2.0 * step)
    by_b = (image(b=step) - image(b=-step)) / (2.0 * step)
    middle = image()
    by_ink = (image(ink=0.07) - image(ink=0.03)) / 0.04
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


def _draw_image(
    render: Renderer,
    diameter_mm: float,
    amplitude_mm: float,
    vector_mm: FloatArray,
    centre_mm: tuple[float, float],
    ink: float,
    light: ImageNoise,
) -> FloatArray:
    """Noise-free image of one dot on paper that reaches beyond the image."""
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
    """Pixel covariance C = D + M K M: independent noise, and paper texture K scaled by the image's brightness M."""

    def __init__(self, middle: FloatArray, light: ImageNoise, semi_amplitude_px: FloatArray) -> None:
        self._noise = middle / light.electrons_per_dn + (light.read_noise_e / light.electrons_per_dn) ** 2
        self._bright = middle
        height, width = middle.shape
        fy, fx = np.fft.fftfreq(2 * height)[:, None], np.fft.rfftfreq(2 * width)[None, :]
        length = light.texture_length_mm * PX_PER_MM
        texture = light.texture**2 * 2.0 * np.pi * length**2 * np.exp(-2.0 * np.pi**2 * length**2 * (fx**2 + fy**2))
        lens = np.exp(-4.0 * np.pi**2 * LENS_SIGMA_PX**2 * (fx**2 + fy**2)) * np.sinc(fx) ** 2 * np.sinc(fy) ** 2
        moments = np.sin(2.0 * np.pi * (np.arange(256) + 0.5) / 256)
        # z is up and y is down
        turns = fx * semi_amplitude_px[0] - fy * semi_amplitude_px[1]
        dwell = np.zeros_like(turns, dtype=complex)
        for moment in moments:
            dwell += np.exp(-2j * np.pi * moment * turns)
        self._spectrum = texture * lens * np.abs(dwell / moments.size) ** 2

    def times(self, vector: FloatArray) -> FloatArray:
        """C applied to an image."""
        height, width = vector.shape
        spectrum = np.fft.rfft2(self._bright * vector, (2 * height, 2 * width)) * self._spectrum
        texture = np.fft.irfft2(spectrum, (2 * height, 2 * width))[:height, :width]
        return np.asarray(self._noise * vector + self._bright * texture)

    def solve(self, right: FloatArray) -> FloatArray:
        """C⁻¹ applied to an image, by conjugate gradients preconditioned with the independent noise."""
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


def bound_table(render: Renderer, diameters_mm: tuple[float, ...], light: ImageNoise, count: int = 7) -> BoundTable:
    """Tabulate the bound from 0.1 to 12 mm."""
    amplitudes = np.geomspace(0.1, 12.0, count)
    along: dict[float, FloatArray] = {}
    across: dict[float, FloatArray] = {}
    for diameter in diameters_mm:
        both = np.array([motion_bound_mm(render, diameter, float(a), light) for a in amplitudes])
        along[diameter], across[diameter] = both.T
    return BoundTable(amplitudes, along, across)
