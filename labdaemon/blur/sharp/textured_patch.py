"""The sharp patch itself as the target: any texture, no shape assumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from labdaemon.blur.patch.colour_planes import FrequencyGrid
from labdaemon.blur.patch.noise import estimate_noise
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray, NoiseModel, Patch
from labdaemon.blur.settings import TARGET_SHAPE
from labdaemon.blur.sharp.fit_sharp import average_patches
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.texture_settings import TEXTURE
from labdaemon.errors import UsageError
from labdaemon.flags import Flag

MIN_SIDE_PX = 8
"""Least width and height of a patch. Trial: less shows hardly any motion."""


@dataclass(frozen=True, slots=True, eq=False)
class TexturedPatch:
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
    frames
        Number of sharp frames in the mean.
    spread_dn
        Brightness, DN, of which `dark` is a part.
    contrast
        `spread_dn` over the brightness where `dark` is 0.
    """

    channel: NDArray[np.int64]
    dark: FloatArray
    centre_in_dark_px: FloatArray
    box_size_px: tuple[int, int]
    frames: int
    spread_dn: float = 1.0
    contrast: float = 1.0

    def spectra(self, grid: FrequencyGrid, channel: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray]:
        """Discrete transform of the samples (the first one's for channels not in use).

        The derivatives are by a small linear distortion about the box's centre.
        """
        order = {int(number): row for row, number in enumerate(self.channel)}
        if not any(int(number) in order for number in channel):
            raise UsageError(
                "the sharp and the blurred frame have no colour channel in common; use frames of one camera"
            )
        rows = [order.get(int(number), 0) for number in channel]
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
        return TARGET_SHAPE.distortion_sd**2 * np.eye(4)

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

    @property
    def psf_margin_px(self) -> int:
        """Its samples end where they end."""
        return 4


def make_textured_patch(
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
        The box does not lie in the patch, or is smaller than `MIN_SIDE_PX`.
    """
    given = [patches] if isinstance(patches, Patch) else list(patches)
    patch, count = average_patches(given)
    left, top = box[0] - patch.origin_px[0], box[1] - patch.origin_px[1]
    height, width = patch.shape
    if min(box[2:]) < MIN_SIDE_PX:
        raise UsageError(f"patch {box} is too small to measure; make it at least {MIN_SIDE_PX} px wide and high")
    if left < 0 or top < 0 or left + box[2] > width or top + box[3] > height:
        raise UsageError(f"patch {box} does not lie inside the sharp frame")
    known = noise is not None
    single = noise if noise is not None else estimate_noise([given[0]])
    channels, dark, spread, bright = _interpolate_channels(patch)
    inside = (slice(top, top + box[3]), slice(left, left + box[2]))
    valid = patch.valid[inside] & np.isfinite(patch.values[inside])
    variance = (
        float(np.mean(single.variance(patch.values[inside][valid]))) / max(spread, 1e-9) ** 2 if valid.any() else np.inf
    )
    variance /= count
    flags: set[Flag] = set()
    contrast = float(np.std(dark[:, inside[0], inside[1]]))
    if np.count_nonzero(valid) < 0.5 * valid.size or not contrast**2 > 4 * variance or spread <= 0:
        flags.add(Flag.NOT_FOUND)
        if np.count_nonzero(patch.valid[inside]) < 0.5 * valid.size:
            flags.add(Flag.SATURATED)
    if np.mean(~patch.valid[np.isin(patch.channel, channels)]) > TEXTURE.max_clipped:
        flags.add(Flag.SATURATED)
    in_dark = np.array([left + (box[2] - 1) / 2, top + (box[3] - 1) / 2])
    centre = in_dark + np.asarray(patch.origin_px)
    form = TexturedPatch(channels, dark, in_dark, (box[2], box[3]), count, spread, spread / max(bright, 1e-9))
    return SharpTarget(
        name, centre, np.zeros((2, 2)), form, {int(c): 1.0 for c in channels}, single, known, flags=frozenset(flags)
    )


def _interpolate_channels(patch: Patch) -> tuple[NDArray[np.int64], FloatArray, float, float]:
    """The channels in use, each one's darkness at every pixel, the brightness range that it is scaled by, and its top.

    On a Bayer sensor the two greens are used: they see through the same colour and so the same lens blur, and together
    they sample finely enough to be interpolated.
    """
    good = patch.valid & np.isfinite(patch.values)
    channels = _select_greens(patch, good)
    use = np.isin(patch.channel, channels)
    scaled = np.zeros(patch.shape)
    spreads, tops = [], []
    for c in channels:
        here = patch.channel == c
        sample = patch.values[here & good]
        low, high = np.percentile(sample, (1, 99)) if sample.size else (0.0, 1.0)
        spreads.append(max(float(high - low), 0.0))
        tops.append(float(high))
        scaled[here] = ((high - np.where(good, patch.values, high)) / max(high - low, 1e-9))[here]
    if len(channels) == 1:
        return channels, _fill_gaps(scaled, good)[None], spreads[0], tops[0]
    neighbours = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4.0
    for _ in range(3):  # the greens may differ a little in gain and offset
        around = ndimage.convolve(np.where(use, scaled, 0.0), neighbours, mode="nearest")
        mean = ndimage.convolve(np.where(use, scaled, around), np.outer([1, 2, 1], [1, 2, 1]) / 16.0, mode="nearest")
        for c in channels:
            here = (patch.channel == c) & good
            if np.ptp(scaled[here]) > 0:
                slope, offset = np.polyfit(scaled[here], mean[here], 1)
                scaled[patch.channel == c] = slope * scaled[patch.channel == c] + offset
    return (
        channels,
        np.repeat(_interpolate_checkerboard(scaled, use & good)[None], len(channels), axis=0),
        float(np.mean(spreads)),
        float(np.mean(tops)),
    )


def _select_greens(patch: Patch, good: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The two channels of a mosaic's diagonal with the most similar response; all channels where it is no mosaic."""
    channels = np.unique(patch.channel).astype(np.int64)
    if len(channels) < 4 or min(patch.shape) < 4:
        return channels
    best, best_ratio = channels[:2], np.inf
    for first, second in (((0, 0), (1, 1)), ((0, 1), (1, 0))):
        pair = [int(patch.channel[at]) for at in (first, second)]
        levels = [float(np.median(patch.values[(patch.channel == c) & good])) for c in pair]
        ratio = abs(float(np.log(max(levels[0], 1e-9) / max(levels[1], 1e-9))))
        if ratio < best_ratio:
            best, best_ratio = np.array(pair, dtype=np.int64), ratio
    return best


def _interpolate_checkerboard(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Fill a chessboard's gaps with the smoothest image that its spatial frequencies allow (Papoulis–Gerchberg)."""
    pad = 8
    wide, mask = np.pad(values, pad, mode="reflect"), np.pad(known, pad, mode="reflect")
    weight = ndimage.gaussian_filter(mask.astype(np.float64), 0.8)
    image = np.where(mask, wide, ndimage.gaussian_filter(np.where(mask, wide, 0.0), 0.8) / np.maximum(weight, 1e-9))
    fy, fx = np.abs(np.fft.fftfreq(wide.shape[0]))[:, None], np.abs(np.fft.rfftfreq(wide.shape[1]))[None, :]
    band = fy + fx < 0.5
    for _ in range(25):
        smooth = fft.irfft2(fft.rfft2(image) * band, s=wide.shape)
        image = np.where(mask, wide, smooth)
    # The known pixels stay as they are: dropping what they hold beyond the band makes a later frame look defocused.
    return image[pad:-pad, pad:-pad]


def _fill_gaps(values: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
    """Replace bad pixels by the mean of the good ones around."""
    if good.all():
        return values
    weight = ndimage.gaussian_filter(good.astype(np.float64), 1.5)
    mean = ndimage.gaussian_filter(np.where(good, values, 0.0), 1.5) / np.maximum(weight, 1e-9)
    return np.where(good, values, mean)
