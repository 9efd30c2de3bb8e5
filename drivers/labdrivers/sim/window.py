"""A rectangle of the frame, finely divided: sharp shapes by area sampling, blurred along their true paths.

Shapes are drawn on a grid `FINE` times finer than the sensor's, each fine cell holding the fraction that the shape
covers. A moving shape is that drawing added up over thousands of moments of the exposure, each shifted to where the
lens put it at that moment; the adding up of shifted copies is done as one convolution with the map of dwell times.
Then comes the lens, and each sensor pixel is the sum over its own fine cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from labdrivers.sim.lens import FloatArray
from labdrivers.sim.optics import COLOURS, Optics
from labdrivers.sim.sensor import FloatImage

FINE = 4
"""Fine cells along a pixel's side."""

HALO_PX = 40
"""Margin around a shape for the lens to spread into."""

REACH = 2
"""A shift by a part of a fine cell is spread over 2·REACH + 1 cells so that its first four moments are exact."""


@dataclass(frozen=True, slots=True)
class PixelWindow:
    """Where a window lies.

    Attributes
    ----------
    x0, y0
        Its first pixel.
    width, height
        In pixels.
    fine
        Fine cells along a pixel's side.
    """

    x0: int
    y0: int
    width: int
    height: int
    fine: int = FINE

    @classmethod
    def around(cls, low_px: FloatArray, high_px: FloatArray, fine: int = FINE) -> PixelWindow:
        """Smallest convenient window that holds the box from `low_px` to `high_px` (x, y) and its halo."""
        x0, y0 = (int(np.floor(v)) - HALO_PX for v in low_px)
        size = [int(np.ceil(high)) + HALO_PX - start + 1 for high, start in zip(high_px, (x0, y0), strict=True)]
        width, height = (scipy.fft.next_fast_len(n, real=True) for n in size)
        return cls(x0, y0, width, height, fine)

    def meets(self, image_size: tuple[int, int]) -> bool:
        """Whether any of its pixels lie in the frame."""
        across = self.x0 < image_size[0] and self.x0 + self.width > 0
        return across and self.y0 < image_size[1] and self.y0 + self.height > 0

    def centres(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates x and y of the fine cells' centres in the frame's pixel coordinates."""
        offset = (0.5 - 0.5 * self.fine) / self.fine
        x = self.x0 + offset + np.arange(self.width * self.fine) / self.fine
        y = self.y0 + offset + np.arange(self.height * self.fine) / self.fine
        return x, y


def dwell_map(offsets_px: FloatArray, weights: FloatArray, window: PixelWindow) -> FloatImage:
    """How long the shape stayed at each shift: a fine image whose origin is no shift, wrapping round.

    Parameters
    ----------
    offsets_px
        (n, 2) shifts.
    weights
        (n,) time spent at each.
    """
    cells = offsets_px * window.fine
    whole = np.rint(cells).astype(np.int64)
    part_x, part_y = (cells - whole).T
    nodes = np.arange(-REACH, REACH + 1)
    weights_x, weights_y = _spread(part_x), _spread(part_y)
    rows, columns = window.height * window.fine, window.width * window.fine
    x = (whole[:, 0, None] + nodes) % columns
    y = (whole[:, 1, None] + nodes) % rows
    index = (y[:, :, None] * columns + x[:, None, :]).ravel()
    value = (weights[:, None, None] * weights_y[:, :, None] * weights_x[:, None, :]).ravel()
    flat = np.bincount(index, weights=value, minlength=rows * columns)
    return flat.reshape(rows, columns).astype(np.float32)


def _spread(part: FloatArray) -> FloatArray:
    """Lagrange weights (n, 2·REACH + 1) that put a unit mass `part` of a cell from the middle one."""
    nodes = np.arange(-REACH, REACH + 1)
    weights = np.ones((part.size, nodes.size))
    for i, node in enumerate(nodes):
        for other in nodes:
            if other != node:
                weights[:, i] *= (part - other) / (node - other)
    return weights


def transform(fine_image: FloatImage) -> NDArray[np.complex64]:
    """Spectrum of a fine image."""
    spectrum: NDArray[np.complex64] = scipy.fft.rfft2(fine_image)
    return spectrum


def develop(spectra: Sequence[NDArray[np.complex64]], window: PixelWindow, optics: Optics) -> list[list[FloatImage]]:
    """What the sensor's pixels see of fine images through the lens.

    Parameters
    ----------
    spectra
        Of fine images of one window, from `transform`.

    Returns
    -------
    list of list of (height, width)
        For each of them one image a colour, as if every pixel had it.
    """
    fine, height, width = window.fine, window.height, window.width
    cutoff = optics.cutoff_per_px()
    fy: FloatArray = np.fft.fftfreq(height * fine, 1.0 / fine).astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(width * fine, 1.0 / fine).astype(np.float64)
    parts = list(spectra)
    # Nothing beyond half a cycle per pixel passes a small aperture: only the middle of the spectrum is needed.
    small = cutoff is not None and cutoff < 0.5
    if small:
        keep_y = np.r_[0 : (height + 1) // 2, height * fine - height // 2 : height * fine]
        fy, fx = fy[keep_y], fx[: width // 2 + 1]
        parts = [part[keep_y][:, : width // 2 + 1] / fine**2 for part in parts]
    pixel = np.outer(_pixel(fy, fine), _pixel(fx, fine)).astype(np.complex64)
    radius = np.hypot(fy[:, None], fx[None, :])
    images: list[list[FloatImage]] = [[] for _ in parts]
    for colour in range(COLOURS):
        if colour and optics.kind == "gaussian":
            for seen in images:
                seen.append(seen[0])
            continue
        passed = pixel * optics.transfer(radius, colour).astype(np.float32)
        for part, seen in zip(parts, images, strict=True):
            if small:
                image = scipy.fft.irfft2(part * passed, s=(height, width))
            else:
                image = scipy.fft.irfft2(part * passed, s=(height * fine, width * fine))[::fine, ::fine]
            seen.append(np.asarray(image, np.float32))
    return images


def _pixel(frequency: FloatArray, fine: int) -> NDArray[np.complex128]:
    """Mean over a pixel's own fine cells, seen from the first of them (a pixel's fine cells are 0..fine-1)."""
    cells = np.arange(fine) / fine
    return np.asarray(np.exp(2j * np.pi * frequency[:, None] * cells[None, :]).mean(axis=1))
