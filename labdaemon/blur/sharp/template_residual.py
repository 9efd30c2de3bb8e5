"""What a sharp image shows beyond an ideal dot: rough edges, folds and paper texture, a camera's tone curve.

All of it moves with the target, so it belongs to the image that is blurred. It is measured as the residual of the
sharp fit, kept as far as it stands above noise, and added to the dot's closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from labdaemon.blur.patch.colour_planes import ColourPlanes, FrequencyGrid, merge_planes
from labdaemon.blur.patch.pixels import BoolArray, ComplexArray, FloatArray, Patch
from labdaemon.blur.settings import TEMPLATE_RESIDUAL


@dataclass(frozen=True, slots=True, eq=False)
class TemplateResidual:
    """Measured darkness to be added to the ideal dot's.

    Attributes
    ----------
    dark
        (h, w) relative to the dot's own; 0 where nothing is known.
    known
        (h, w) the paper (dot included) on which it was measured.
    centre_px
        (2,) the dot's centre in these arrays, x and y.
    rms
        Of `dark` where known.
    """

    dark: FloatArray
    known: BoolArray
    centre_px: FloatArray
    rms: float

    @property
    def is_strong(self) -> bool:
        """Whether pixels that it does not reach had better be left out."""
        return self.rms > TEMPLATE_RESIDUAL.strong_rms

    def is_paper_texture(self, radius_px: float) -> bool:
        """Whether it is weak and nowhere stronger than on bare paper; a rough dot shows at its edge.

        Paper texture may stay behind when the dot moves, template residual may not.
        """
        height, width = self.dark.shape
        x, y = np.arange(width) - self.centre_px[0], np.arange(height)[:, None] - self.centre_px[1]
        out = np.hypot(x, y) - radius_px
        bare, edge = (
            self.known & (out > TEMPLATE_RESIDUAL.outline_band_px),
            self.known & (np.abs(out) <= TEMPLATE_RESIDUAL.outline_band_px),
        )
        if self.is_strong or not bare.any() or not edge.any():
            return False
        return bool(np.mean(self.dark[edge] ** 2) <= np.mean(self.dark[bare] ** 2))

    @property
    def needs_mask(self) -> bool:
        """Whether a blurred patch must be masked to what the sharp one showed."""
        return self.is_strong or not bool(self.known.all())

    def spectrum(self, grid: FrequencyGrid) -> ComplexArray:
        """(rows, columns) discrete transform about the dot's centre; nothing beyond the samples' Nyquist frequency."""
        return self._transform(self.dark, grid)

    def affine_derivatives(self, grid: FrequencyGrid) -> ComplexArray:
        """(4, rows, columns) derivatives by a small linear distortion (xx, yy, xy, yx) about the centre."""
        height, width = self.dark.shape
        x = self._transform(self.dark * (np.arange(width) - self.centre_px[0]), grid) * (-2j * np.pi)
        y = self._transform(self.dark * (np.arange(height) - self.centre_px[1])[:, None], grid) * (-2j * np.pi)
        return np.stack((x * grid.fx, y * grid.fy, y * grid.fx, x * grid.fy))

    def _transform(self, dark: FloatArray, grid: FrequencyGrid) -> ComplexArray:
        height, width = grid.size
        centre = self.centre_px
        extra_y, extra_x = max(dark.shape[0] - height, 0), max(dark.shape[1] - width, 0)
        if extra_y or extra_x:
            dark = dark[extra_y // 2 : extra_y // 2 + height, extra_x // 2 : extra_x // 2 + width]
            centre = centre - (extra_x // 2, extra_y // 2)
        base = fft.rfft2(dark, s=(height, width))
        rows, columns = grid.fx.shape
        result = np.zeros((rows, columns), dtype=np.complex128)
        half = height // 2
        result[:half, : base.shape[1]] = base[:half]
        result[rows - half :, : base.shape[1]] = base[half:]
        result *= np.exp(2j * np.pi * (grid.fx * centre[0] + grid.fy * centre[1]))
        return result


def find_paper(patch: Patch, centre_px: FloatArray, radius_px: float) -> BoolArray:
    """(h, w) the white paper that a dot sits on, dot included, without the paper's own blurred edge.

    Paper is what is connected to the ring around the dot and nearer to its brightness than to ink.
    """
    height, width = patch.shape
    y, x = np.mgrid[0:height, 0:width]
    distance = np.hypot(x + patch.origin_px[0] - centre_px[0], y + patch.origin_px[1] - centre_px[1])
    bright = np.zeros(patch.shape, dtype=bool)
    ring = (distance > radius_px + 2) & (distance < radius_px + 5)
    finite = np.isfinite(patch.values)
    for channel in np.unique(patch.channel):
        here = (patch.channel == channel) & finite
        outside, inside = here & ring, here & (distance < 0.6 * radius_px)
        if not outside.any() or not inside.any():
            bright |= here
            continue
        white, ink = float(np.median(patch.values[outside])), float(np.median(patch.values[inside]))
        bright |= here & (patch.values > ink + 0.6 * (white - ink))
    bright |= distance < radius_px + 1.5
    bright = ndimage.median_filter(bright, 3) | ~finite
    labels, _ = ndimage.label(bright)
    at = np.clip(np.rint(centre_px - patch.origin_px).astype(int), 0, (width - 1, height - 1))
    paper = labels == labels[at[1], at[0]] if labels[at[1], at[0]] else bright
    paper = ndimage.binary_erosion(paper, iterations=2, border_value=1)
    result: BoolArray = paper | (distance < radius_px + 1.5)
    return result


def find_template_residual(
    planes: ColourPlanes, residual_dark: FloatArray, variance: FloatArray, paper: BoolArray, centre_px: FloatArray
) -> TemplateResidual | None:
    """The residual of a sharp fit as far as it stands above noise; None where it does not.

    Each band of spatial frequency is kept in the proportion that exceeds the noise's power (Wiener).

    Parameters
    ----------
    residual_dark, variance
        (n, h, w) residual darkness and its noise variance, on the colour planes.
    paper
        (H, W) mask on all pixels.
    centre_px
        (2,) the dot's centre, frame coordinates.
    """
    dark, noise = merge_planes(planes, residual_dark), merge_planes(planes, variance)
    valid = merge_planes(planes, planes.valid.astype(np.float64)) > 0.5
    height, width = paper.shape
    dark, noise, valid = dark[:height, :width], noise[:height, :width], valid[:height, :width]
    good = paper & valid
    if np.count_nonzero(good) < 50:
        return None
    filled = np.where(good, dark, 0.0)
    spectrum = fft.fft2(filled)
    power = np.abs(spectrum) ** 2 / np.count_nonzero(good)
    floor = float(np.mean(noise[good]))
    f = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None, :])
    band = np.minimum((f * 24).astype(int), 12)
    mean = ndimage.mean(power, band, np.arange(13))
    keep = np.clip(1 - floor / np.maximum(mean, 1e-300), 0.0, 1.0)
    kept = np.real(fft.ifft2(spectrum * keep[band])) * good
    rms = float(np.sqrt(np.mean(kept[good] ** 2)))
    if rms < TEMPLATE_RESIDUAL.min_rms:
        return None
    return TemplateResidual(kept, paper, centre_px - np.asarray(planes.origin_px), rms)


def trusted_pixels(
    template_residual: TemplateResidual,
    patch: Patch,
    place_px: FloatArray,
    a_px: FloatArray,
    b_px: FloatArray,
    radius_px: float,
) -> BoolArray:
    """(h, w) pixels of a blurred patch all of whose light came from paper that the sharp frame showed.

    With a strong template residual only what is near the smear counts: folds and gloss further out change with the
    light as a label moves.

    Parameters
    ----------
    place_px
        (2,) the target's mean position in the blurred frame.
    a_px, b_px
        (2,) its semi-axes.
    radius_px
        The dot's.
    """
    height, width = patch.shape
    # A path that has run away reaches no further than all of the patch.
    reach_y = int(min(np.ceil(np.hypot(a_px[1], b_px[1])), height)) + 2
    reach_x = int(min(np.ceil(np.hypot(a_px[0], b_px[0])), width)) + 2
    move = np.rint(place_px - template_residual.centre_px - np.asarray(patch.origin_px)).astype(int)  # array to patch
    pad_y, pad_x = height + 2 * reach_y, width + 2 * reach_x
    fill = "constant" if template_residual.is_strong else "edge"
    known = np.pad(template_residual.known, ((pad_y, pad_y), (pad_x, pad_x)), mode=fill)  # type: ignore[call-overload]
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    steps = np.rint(np.sin(angle)[:, None] * a_px + np.cos(angle)[:, None] * b_px).astype(int)
    result = np.ones((height, width), dtype=bool)
    top, left = pad_y - move[1], pad_x - move[0]
    for dx, dy in {(int(x) + u, int(y) + v) for x, y in steps for u, v in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))}:
        y0, x0 = np.clip(top - dy, 0, known.shape[0] - height), np.clip(left - dx, 0, known.shape[1] - width)
        result &= known[y0 : y0 + height, x0 : x0 + width]
    if template_residual.is_strong:
        x = np.arange(width) - (place_px[0] - patch.origin_px[0])
        y = np.arange(height)[:, None] - (place_px[1] - patch.origin_px[1])
        path = np.sin(angle)[:, None] * a_px + np.cos(angle)[:, None] * b_px
        near = (
            np.min([np.hypot(x - dx, y - dy) for dx, dy in path], axis=0)
            < radius_px + TEMPLATE_RESIDUAL.smear_margin_px
        )
        result &= near
    return result
