"""The last step of a fit, with the paper's grain weighed as what it is: noise that neighbours share.

Photon and read noise differ from pixel to pixel; grain does not, and moving paper smears it along the path. A fit that
takes all of it for independent is unbiased but wastes up to half of what a long smear tells, and believes too much of
it. The weight used here is W^½ F W^½, with W the inverse variance of the independent noise and F a filter 1/(1 + κS),
S the grain's spectrum after the blur and κ the mean ratio of the two; the covariance is that of the true noise under
this weight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from labdaemon.blur import shapes
from labdaemon.blur.model import Motion, Setting
from labdaemon.blur.mosaic import interleave
from labdaemon.blur.pixels import ComplexArray, FloatArray, NoiseModel
from labdaemon.blur.render import single
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import Model, Prior, Solution, derivatives


def weigh_grain(
    sharp: SharpTarget, setting: Setting, solution: Solution, model: Model, motion: Motion | None, prior: Prior
) -> Solution:
    """One Gauss–Newton step from a solution with grain in the weights, and the covariance that goes with it.

    Parameters
    ----------
    sharp, setting
        The target and what was fitted.
    solution
        A converged fit with independent weights.
    model, motion, prior
        As it was fitted with.

    Returns
    -------
    Solution
        As given where the noise model has no grain.
    """
    noise = sharp.noise
    if noise.texture <= 0 or not sharp.noise_known:
        return solution
    planes = setting.planes
    columns, n, k = _columns(setting, solution, model)
    weight = np.where(solution.weight > 0, 1 / np.maximum(noise.variance(solution.signal), 1e-12), 0.0)
    root = interleave(planes, np.sqrt(weight))
    signal = interleave(planes, solution.signal)
    left = planes.values - solution.signal
    images = interleave(planes, np.concatenate((columns, left[None])))
    size = tuple(int(fft.next_fast_len(length + 8, real=True)) for length in root.shape)
    spectrum = _grain_spectrum(noise, solution.p, k, motion, size)
    paper = root > 0
    ratio = float(np.mean((root * signal)[paper] ** 2)) if paper.any() else 0.0
    keep = 1 / (1 + ratio * spectrum)
    flat = _filtered(images * root, keep, size) * root
    count = len(columns)
    normal = _products(flat[:-1], images)
    right = normal[:, -1].copy()
    precision = np.zeros((count, count))
    precision[:k, :k] = prior.precision
    right[:k] -= prior.precision @ (solution.p - prior.mean)
    inverse = _inverse(normal[:, :-1] + precision)
    step = inverse @ right
    # Under this weight the noise is W^-1 and grain.
    gain = np.tensordot(inverse[:k], flat[:-1], axes=1)
    own = np.zeros_like(root)
    own[paper] = 1 / root[paper] ** 2
    spread = gain * own + signal * _filtered(gain * signal, spectrum, size)
    covariance = _products(gain, spread) + inverse[:k, :k] @ prior.precision @ inverse[:k, :k]
    light = solution.light + step[k:].reshape(n, 4)
    return replace(solution, p=solution.p + step[:k], light=light, covariance=covariance, correlated=True)


def _columns(setting: Setting, solution: Solution, model: Model) -> tuple[FloatArray, int, int]:
    """Derivatives of all pixels by the parameters and by each lattice's own light, (k + 4n, n, h, w)."""
    planes = setting.planes
    dark, by_p = model(solution.p)
    n, k = len(planes.channel), len(by_p)
    own = derivatives(planes, solution.light, dark, by_p)
    columns = np.zeros((k + 4 * n, *dark.shape))
    columns[:k] = own[:, :k].swapaxes(0, 1)
    for index in range(n):
        columns[k + 4 * index : k + 4 * index + 4, index] = own[index, k:]
    return columns, n, k


def _products(first: FloatArray, second: FloatArray) -> FloatArray:
    """(i, j) sums over all pixels."""
    result: FloatArray = first.reshape(len(first), -1) @ second.reshape(len(second), -1).T
    return result


def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a normal matrix, scaled first; directions that nothing determines stay out."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scale = np.where(np.diag(matrix) > 0, scale, 1.0)
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-13, hermitian=True)
    result: FloatArray = inverse / np.outer(scale, scale)
    return result


def _grain_spectrum(
    noise: NoiseModel, p: FloatArray, k: int, motion: Motion | None, size: tuple[int, ...]
) -> FloatArray:
    """Power of the grain at each frequency of a picture of `size`, relative to the paper's brightness squared."""
    fy, fx = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None, :]
    f2 = fx**2 + fy**2
    length = noise.texture_px
    power: FloatArray = noise.texture**2 * 4 * np.pi * length**2 * np.exp(-4 * np.pi**2 * length**2 * f2)
    power = power * shapes.gaussian(f2, 2 * float(p[2]))
    if motion is not None:
        full_x, full_y = np.broadcast_arrays(fx, fy)
        transfer: FloatArray | ComplexArray = motion(full_x, full_y, p[k - _count(motion) :])[0]
        power = power * np.abs(transfer) ** 2
    return power


def _count(motion: Motion) -> int:
    return 2 if motion is shapes.straight else 3


def _filtered(images: FloatArray, keep: FloatArray, size: tuple[int, ...]) -> FloatArray:
    height, width = images.shape[-2:]
    result: FloatArray = fft.irfft2(fft.rfft2(single(images), s=size) * single(keep), s=size)[..., :height, :width]
    return result.astype(np.float64)
