"""The sharp patch itself as the target: any texture, no shape assumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from labdaemon.blur.fit_sharp import average
from labdaemon.blur.mosaic import Grid
from labdaemon.blur.noise import estimate_noise
from labdaemon.blur.pixels import ComplexArray, FloatArray, NoiseModel, Patch
from labdaemon.blur.sharp import DISTORTION, SharpTarget
from labdaemon.errors import UsageError
from labdaemon.flags import Flag


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A sampled target.

    Attributes
    ----------
    channel
        (n,) channel numbers.
    dark
        (n, h, w) darkness at full resolution, as each channel sees it; 0 in the brightest part.
    centre_in_dark_px
        (2,) x and y of the box's centre in `dark`.
    box_size_px
        (width, height) of the part to be measured, about that centre.
    variance
        Noise variance of `dark`.
    """

    channel: NDArray[np.int64]
    dark: FloatArray
    centre_in_dark_px: FloatArray
    box_size_px: tuple[int, int]
    variance: float

    def spectra(self, grid: Grid, channel: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray]:
        """Discrete transform of the samples, and derivatives by a small linear distortion about the box's centre."""
        order = {int(number): row for row, number in enumerate(self.channel)}
        try:
            rows = [order[int(number)] for number in channel]
        except KeyError as missing:
            raise UsageError(f"colour channel {missing} is not in the sharp frame; use frames of one camera") from None
        x, y = self.centre_in_dark_px
        phase = np.exp(2j * np.pi * (grid.fx * x + grid.fy * y))
        _, height, width = self.dark.shape
        spectrum = fft.rfft2(self.dark, s=grid.size)[rows] * phase
        by_x = fft.rfft2(self.dark * (np.arange(width) - x), s=grid.size)[rows] * (phase * -2j * np.pi)
        by_y = fft.rfft2(self.dark * (np.arange(height) - y)[:, None], s=grid.size)[rows] * (phase * -2j * np.pi)
        return spectrum, np.stack((by_x * grid.fx, by_y * grid.fy, by_y * grid.fx, by_x * grid.fy))

    @property
    def prior_covariance(self) -> FloatArray:
        """Of a small linear distortion (xx, yy, xy, yx)."""
        return DISTORTION**2 * np.eye(4)

    @property
    def half_size_px(self) -> tuple[float, float]:
        """Half of the box."""
        return self.box_size_px[0] / 2, self.box_size_px[1] / 2

    @property
    def moment_px2(self) -> FloatArray:
        """Not defined for a texture that fills its box: zero."""
        return np.zeros((2, 2))

    @property
    def oversampling(self) -> int:
        """Samples know nothing beyond their own Nyquist frequency."""
        return 1


def sharp_texture(
    patches: Patch | Sequence[Patch],
    box: tuple[int, int, int, int],
    *,
    name: str = "",
    noise: NoiseModel | None = None,
) -> SharpTarget:
    """Take a sharp patch as it is for a target.

    Parameters
    ----------
    patches
        The same rectangle of one or several sharp frames (averaged). It should reach beyond the box by the motion and a
        few pixels, because what lies outside is smeared into the box.
    box
        (x, y, width, height) of the part to measure, frame coordinates.
    name
        The target's name.
    noise
        Noise of one frame; estimated if not given.

    Raises
    ------
    UsageError
        The box does not lie in the patch, or is smaller than 8 px.
    """
    given = [patches] if isinstance(patches, Patch) else list(patches)
    patch, count = average(given)
    left, top = box[0] - patch.origin_px[0], box[1] - patch.origin_px[1]
    height, width = patch.shape
    if min(box[2:]) < 8:
        raise UsageError(f"patch {box} is too small to measure; make it at least 8 px wide and high")
    if left < 0 or top < 0 or left + box[2] > width or top + box[3] > height:
        raise UsageError(f"patch {box} does not lie inside the sharp frame")
    known = noise is not None
    single = noise if noise is not None else estimate_noise([patch])
    channels, dark, spread = _full_resolution(patch)
    inside = (slice(top, top + box[3]), slice(left, left + box[2]))
    valid = patch.valid[inside] & np.isfinite(patch.values[inside])
    variance = float(np.mean(single.variance(patch.values[inside][valid]))) / spread**2 if valid.any() else np.inf
    if known:
        variance /= count
    flags: set[Flag] = set()
    contrast = float(np.std(dark[:, inside[0], inside[1]]))
    if np.count_nonzero(valid) < 0.5 * valid.size or not contrast**2 > 4 * variance or spread <= 0:
        flags.add(Flag.NOT_FOUND)
        if np.count_nonzero(patch.valid[inside]) < 0.5 * valid.size:
            flags.add(Flag.SATURATED)
    in_dark = np.array([left + (box[2] - 1) / 2, top + (box[3] - 1) / 2])
    centre = in_dark + np.asarray(patch.origin_px)
    form = Texture(channels, dark, in_dark, (box[2], box[3]), variance)
    return SharpTarget(
        name, centre, np.zeros((2, 2)), form, {int(c): 1.0 for c in channels}, single, known, flags=frozenset(flags)
    )


def _full_resolution(patch: Patch) -> tuple[NDArray[np.int64], FloatArray, float]:
    """Each channel's darkness at every pixel, and the mean brightness range that it is scaled by.

    The channels are matched by straight lines to one picture at full resolution; what each then differs from it by (its
    own lens blur) is smooth enough to be spread from its own pixels to all.
    """
    good = patch.valid & np.isfinite(patch.values)
    fallback = float(np.median(patch.values[good])) if good.any() else 0.0
    values = np.where(good, patch.values, np.nan)
    channels = np.unique(patch.channel).astype(np.int64)
    scaled = np.zeros(patch.shape)
    spreads = []
    for c in channels:
        here = patch.channel == c
        sample = values[here & good]
        low, high = np.percentile(sample, (1, 99)) if sample.size else (0.0, 1.0)
        spreads.append(max(float(high - low), 0.0))
        scaled[here] = ((high - np.where(good, patch.values, fallback)) / max(high - low, 1e-9))[here]
    scaled = _fill(scaled, good)
    dark = np.repeat(scaled[None], len(channels), axis=0)
    if len(channels) > 1:
        for _ in range(3):
            smooth = ndimage.convolve(scaled, np.outer([1, 2, 1], [1, 2, 1]) / 16.0, mode="nearest")
            for c in channels:
                here = (patch.channel == c) & good
                slope, offset = np.polyfit(scaled[here], smooth[here], 1)
                every = patch.channel == c
                scaled[every] = slope * scaled[every] + offset
        smooth = ndimage.convolve(scaled, np.outer([1, 2, 1], [1, 2, 1]) / 16.0, mode="nearest")
        detail = scaled - smooth
        shared = ndimage.gaussian_filter(detail, 1.2, mode="nearest")
        for row, c in enumerate(channels):
            here = patch.channel == c
            seen = (here & good).astype(np.float64)
            weight = ndimage.gaussian_filter(seen, 1.2, mode="nearest")
            own = ndimage.gaussian_filter(seen * detail, 1.2, mode="nearest") / np.maximum(weight, 1e-6)
            dark[row] = np.where(here, scaled, scaled + own - shared)
    return channels, dark, float(np.mean(spreads)) if spreads else 0.0


def _fill(values: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
    """Replace bad pixels by the mean of the good ones around."""
    if good.all():
        return values
    weight = ndimage.gaussian_filter(good.astype(np.float64), 1.5)
    mean = ndimage.gaussian_filter(np.where(good, values, 0.0), 1.5) / np.maximum(weight, 1e-9)
    return np.where(good, values, mean)
