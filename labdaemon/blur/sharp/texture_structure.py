"""The directions in which a texture can show motion (the aperture problem).

Motion along u shows by the gradient of the noise-free texture along u. The structure tensor, the mean of ∇T∇Tᵀ, has
the noise's gradient in it as well; that share is known from the noise and is subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.texture_settings import TEXTURE

MARGIN_PX = 8
"""Half of what an image is extended by before it is filtered. Numerics."""


@dataclass(frozen=True, slots=True, eq=False)
class TextureStructure:
    """Squared gradient of a texture along its principal directions, noise subtracted.

    Attributes
    ----------
    across, along
        (2,) unit vectors of most and of least structure.
    shows_across, shows_along
        Whether the structure in that direction is distinct from noise.
    """

    across: FloatArray
    along: FloatArray
    shows_across: bool
    shows_along: bool


def texture_structure(form: TexturedPatch, noise_variance: float) -> TextureStructure:
    """Structure of the box.

    Parameters
    ----------
    form
        The sharp patch.
    noise_variance
        Of `form.dark`, white.
    """
    dark = form.dark.mean(axis=0)
    gradient = np.stack([_smooth_derivative(dark, axis) for axis in (1, 0)])
    inside = _box(form, gradient).reshape(2, -1)
    inside = inside - inside.mean(axis=1, keepdims=True)  # a gradient of the light is no texture
    tensor = inside @ inside.T / inside.shape[1]
    impulse = np.zeros((31, 31))
    impulse[15, 15] = 1.0
    share = noise_variance * float(np.sum(_smooth_derivative(impulse, 1) ** 2))
    values, vectors = np.linalg.eigh(tensor)
    # Smoothing correlates the noise over 4πσ² pixels. The scatter is that of noise squared, and of noise times signal.
    independent = max(inside.shape[1] / (4 * np.pi * TEXTURE.smoothing_px**2), 1.0)
    clear = values - share
    scatter = np.sqrt((2 * share**2 + 4 * share * np.maximum(clear, 0)) / independent)
    least = np.maximum(TEXTURE.structure_sds * scatter, TEXTURE.min_relative_gradient**2 * values[1])
    shows = clear > least
    return TextureStructure(vectors[:, 1], vectors[:, 0], bool(shows[1]), bool(shows[0]))


@dataclass(frozen=True, slots=True, eq=False)
class TextureBand:
    """Spatial frequencies of an image's half-plane transform that its samples determine, weighed by the texture there.

    Attributes
    ----------
    places
        (h, w // 2 + 1) True where they are.
    fx, fy
        (f,) frequencies, cycles a pixel.
    weight
        (f,) S/(S + N) by the power of texture and noise, doubled where the transform leaves out the mirror image.
    count
        Number of frequencies of the whole plane: white noise of unit variance has as much power as it has pixels.
    """

    places: NDArray[np.bool_]
    fx: FloatArray
    fy: FloatArray
    weight: FloatArray
    count: float


def texture_band(form: TexturedPatch, shape: tuple[int, ...], noise_variance: float) -> TextureBand:
    """Weights of spatial frequencies for images of some (h, w).

    Parameters
    ----------
    form
        The sharp patch.
    shape
        Of the image.
    noise_variance
        Of a pixel of `form.dark`, where it was not interpolated.
    """
    height, width = shape[-2:]
    fy, fx = np.broadcast_arrays(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    mosaic = len(form.channel) > 1
    places = np.abs(fx) + np.abs(fy) < 0.5 if mosaic else np.ones(fx.shape, dtype=bool)
    dark = _box(form, form.dark.mean(axis=0))
    window = np.outer(np.hanning(dark.shape[0] + 2)[1:-1], np.hanning(dark.shape[1] + 2)[1:-1])
    whole = np.abs(fft.fft2((dark - np.average(dark, weights=window)) * window, s=(height, width))) ** 2
    # Over orders of magnitude a mean would smear the strong frequencies over the weak. The logarithm of an
    # exponentially distributed power is Euler's constant below that of its mean.
    smooth = ndimage.gaussian_filter(np.log(whole + 1e-300), TEXTURE.smoothing_bins, mode="wrap")
    power = np.exp(smooth + np.euler_gamma) / np.sum(window**2)
    # A chessboard's samples have their noise in half of all frequencies.
    noise = noise_variance * (2.0 if mosaic else 1.0)
    weight = np.clip(1 - noise / np.maximum(power[:, : fx.shape[1]], 1e-300), 0.0, 1.0)
    double = np.where((fx > 0) & (fx < 0.5), 2.0, 1.0)
    return TextureBand(places, fx[places], fy[places], (weight * double)[places], float(double[places].sum()))


def without_noise(form: TexturedPatch, noise_variance: float) -> TexturedPatch:
    """The most probable texture, by a Wiener filter: least squares with it reads no noise of the sharp frame as motion.

    Parameters
    ----------
    form, noise_variance
        As for `texture_band`.
    """
    pad = 2 * MARGIN_PX
    mean = form.dark.mean()
    wide = np.pad(form.dark - mean, ((0, 0), (pad, pad), (pad, pad)), mode="reflect")
    band = texture_band(form, wide.shape, noise_variance)
    double = np.where((band.fx > 0) & (band.fx < 0.5), 2.0, 1.0)
    kept = np.zeros(band.places.shape)
    kept[band.places] = band.weight / double
    kept[0, 0] = 1.0
    filtered = fft.irfft2(fft.rfft2(wide) * kept, s=wide.shape[-2:])
    return replace(form, dark=mean + filtered[:, pad:-pad, pad:-pad])


def _box(form: TexturedPatch, image: FloatArray) -> FloatArray:
    """The part of an image of the size of `form.dark` that is to be measured."""
    width, height = form.box_size_px
    left, top = (int(v) for v in np.rint(form.centre_in_dark_px - (np.array([width, height]) - 1) / 2))
    return image[..., max(top, 0) : top + height, max(left, 0) : left + width]


def _smooth_derivative(image: FloatArray, axis: int) -> FloatArray:
    order = [0, 0]
    order[axis] = 1
    result: FloatArray = ndimage.gaussian_filter(image, TEXTURE.smoothing_px, order=order, mode="nearest")
    return result
