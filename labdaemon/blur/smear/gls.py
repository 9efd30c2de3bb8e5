"""The last step of a fit, with the paper's grain weighed as what it is: noise that neighbours share.

Photon and read noise differ from pixel to pixel; grain does not, and moving paper smears it along the path. A fit that
takes all of it for independent is unbiased but wastes up to half of what a long smear tells, and believes too much of
it. Here

- what the sharp frame shows of the grain (`papermap`) is taken off, both smeared with the target and standing still,
  each in the proportion in which it is found: labels move with their dots, a wall behind a dot does not, and neither
  does the sensor's own pattern;
- the rest is weighed by W^½ F W^½, with W the inverse variance of the independent noise and F a filter 1/(1 + κS), S
  the spectrum of the grain that is left and κ the mean ratio of the two;
- light may bend: the diffracted skirts of the paper's own edges, and lamps, add a quadratic surface to the plane;
- the covariance is the inverse normal matrix: that of the true noise under this weight is 0 to 5 % smaller.

The light of each lattice is eliminated first, under W: what remains does not depend on it, whatever it is weighed by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft

from labdaemon.blur.patch.light import derivatives, light_coordinates, light_level, ridge
from labdaemon.blur.patch.mosaic import Planes, deal, interleave
from labdaemon.blur.patch.pixels import FloatArray, NoiseModel
from labdaemon.blur.sharp.papermap import grain_power, half_plane, left_power
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.model import Setting
from labdaemon.blur.solver.normal import Prior, Solution, inverse_scaled
from labdaemon.blur.solver.solve import Model
from labdaemon.blur.spectra import shapes
from labdaemon.blur.spectra.render import single

BENT = 0.02  # prior deviation of the light's curvature over a patch, relative
MOVING, STILL = (1.0, 0.5), (0.0, 0.5)  # how much of the mapped grain is expected to move and to stand, with deviations
MOST = 1.5  # of either, counted for what is left of it
ODD_CHI2 = 4.0  # residuals from which a fit is not improved by weighing noise
MARGIN_PX = 8  # of nothing around the pictures that are filtered


def weigh_grain(
    sharp: SharpTarget, setting: Setting, solution: Solution, model: Model, moment_px2: FloatArray, prior: Prior
) -> Solution:
    """One Gauss–Newton step from a solution with grain in the weights, and the covariance that goes with it.

    Parameters
    ----------
    sharp, setting
        The target and what was fitted.
    solution
        A converged fit with independent weights.
    model, prior
        As it was fitted with.
    moment_px2
        (3,) the motion's aaᵀ + bbᵀ, as m0, m1, m2.

    Returns
    -------
    Solution
        As given where the noise is not known, or the residuals are not noise.
    """
    if not sharp.noise_known or solution.chi2 > ODD_CHI2:
        return solution
    noise, planes, k = sharp.noise, setting.planes, len(solution.p)
    weight = np.where(solution.weight > 0, 1 / np.maximum(noise.variance(solution.signal), 1e-12), 0.0)
    level = light_level(planes, solution.light)
    dark, by_p = model(solution.p)
    columns = derivatives(planes, solution.light, dark, by_p)
    root = interleave(planes, np.sqrt(weight))
    signal = interleave(planes, solution.signal)
    grain = _Grain.seen(sharp, planes, solution, moment_px2, signal, interleave(planes, level))
    left = planes.values - solution.signal
    extra = [solution.signal * bend for bend in _bends(planes)] + [deal(planes, one) for one in grain.pictures]
    wanted = np.concatenate((columns[:, :k].swapaxes(0, 1), single(np.stack((*extra, left)))))
    free = interleave(planes, _without_light(wanted, columns[:, k:], single(weight)))
    size = tuple(int(fft.next_fast_len(length + MARGIN_PX, real=True)) for length in root.shape)
    share = grain.share(free[k + 3 : -1], free[-1], root)
    spectrum = grain.spectrum(share, _bared(sharp, planes, free[3 + setting.shapes : k], root), size)
    paper = root > 0
    ratio = float(np.mean((root * signal)[paper] ** 2)) if paper.any() else 0.0
    keep = 1 / (1 + ratio * spectrum)
    waves = fft.rfft2(free * single(root), s=size)
    normal = _power(waves[:-1], waves, keep, size)
    count = len(free) - 1
    precision, pull = np.zeros((count, count)), np.zeros(count)
    precision[:k, :k] = prior.precision
    pull[:k] = prior.precision @ (solution.p - prior.mean)
    expected = [(0.0, BENT)] * 3 + [MOVING, STILL][: len(grain.pictures)]
    for index, (mean, sd) in enumerate(expected, start=k):
        precision[index, index] = sd**-2
        pull[index] = -mean * sd**-2
    inverse = inverse_scaled(normal[:, :-1] + precision)
    step = inverse @ (normal[:, -1] - pull)
    light = solution.light - solution.light_part @ step[:k]
    return replace(solution, p=solution.p + step[:k], light=light, covariance=inverse[:k, :k], correlated=True)


@dataclass(frozen=True, slots=True, eq=False)
class _Grain:
    """What is known of the grain in one blurred patch.

    Attributes
    ----------
    pictures
        What the sharp frame's map predicts (darker: negative), DN: moved and smeared with the target, and standing
        still. Empty without a map.
    noise
        With the grain's strength and length.
    unseen
        Noise of the map; infinite without one.
    blur_px2, moment_px2
        Extra blur and motion.
    """

    pictures: list[FloatArray]
    noise: NoiseModel
    unseen: float
    blur_px2: float
    moment_px2: FloatArray

    @classmethod
    def seen(
        cls,
        sharp: SharpTarget,
        planes: Planes,
        solution: Solution,
        moment_px2: FloatArray,
        signal: FloatArray,
        level: FloatArray,
    ) -> _Grain:
        p, paper = solution.p, sharp.paper
        if paper is None:
            return cls([], sharp.noise, np.inf, float(p[2]), moment_px2)
        origin = np.asarray(planes.origin_px)
        height, width = signal.shape
        moved = paper.blurred(float(p[2]), moment_px2, p[:2] - origin, (height, width))
        still = paper.shifted(sharp.centre_px - origin, (height, width))
        return cls([-level * moved, -signal * still], sharp.noise, paper.noise, float(p[2]), moment_px2)

    def share(self, pictures: FloatArray, left: FloatArray, root: FloatArray) -> tuple[float, float]:
        """How much of the grain moves with the target and how much stands: by least squares, from what is left over.

        Parameters
        ----------
        pictures, left
            (2, h, w) predictions and (h, w) residuals, light eliminated.
        root
            (h, w) inverse deviations.
        """
        if not self.pictures:
            return 1.0, 0.0
        flat = (pictures * root).reshape(2, -1)
        mean, sd = np.array([MOVING, STILL]).T
        normal = flat @ flat.T + np.diag(sd**-2)
        found = np.linalg.solve(normal, flat @ (left * root).ravel() + mean * sd**-2)
        moving, still = np.clip(found, 0.0, MOST)
        return float(moving), float(still)

    def spectrum(self, share: tuple[float, float], bared: float, size: tuple[int, ...]) -> FloatArray:
        """Spectrum of the grain that no map tells of, relative to the paper's brightness squared.

        Parameters
        ----------
        share
            How much of the grain moves, and how much stands.
        bared
            Part of what the motion shows by that is seen against paper which the dot at rest covered.
        size
            Of the pictures (h, w).
        """
        fx, fy = half_plane(size)
        power = grain_power(self.noise, fx**2 + fy**2)
        left = left_power(power, self.unseen, fx, fy)
        smear = shapes.smear(fx, fy, self.blur_px2, self.moment_px2)
        standing = left + bared * (power - left)
        result: FloatArray = share[0] ** 2 * left * smear**2 + share[1] ** 2 * standing
        return result


def _bared(sharp: SharpTarget, planes: Planes, by_motion: FloatArray, root: FloatArray) -> float:
    """Part of the motion's information that lies where the dot was at rest: nobody has seen the paper there.

    Parameters
    ----------
    by_motion
        (m, h, w) derivatives by the motion's parameters.
    root
        (h, w) inverse deviations.
    """
    x, y = sharp.centre_px - np.asarray(planes.origin_px)
    height, width = root.shape
    covered = np.hypot(np.arange(width) - x, np.arange(height)[:, None] - y) < max(sharp.form.half_size_px)
    told = np.sum((by_motion * root) ** 2, axis=0)
    return float(np.sum(told[covered]) / max(float(np.sum(told)), 1e-300))


def _bends(planes: Planes) -> list[FloatArray]:
    """Quadratic surfaces over the patch."""
    u, v = light_coordinates(planes)
    return [u * u - 1 / 3, u * v, v * v - 1 / 3]


def _without_light(pictures: FloatArray, light: FloatArray, weight: FloatArray) -> FloatArray:
    """(m, n, h, w) pictures less what each lattice's light explains of them.

    Parameters
    ----------
    light
        (n, 4, h, w) derivatives by the light.
    weight
        (n, h, w) inverse variances.
    """
    n = len(light)
    own, w = light.reshape(n, 4, -1), weight.reshape(n, 1, -1)
    flat = pictures.swapaxes(0, 1).reshape(n, len(pictures), -1)
    scaled = own * w
    normal = (scaled @ own.transpose(0, 2, 1)).astype(np.float64)
    part = np.linalg.solve(normal + ridge(normal, 1e-12), scaled @ flat.transpose(0, 2, 1)).astype(flat.dtype)
    result: FloatArray = (flat - part.transpose(0, 2, 1) @ own).reshape(n, len(pictures), *weight.shape[1:])
    return result.swapaxes(0, 1)


def _power(first: Any, second: Any, spectrum: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """(i, j) sums over all pixels of filtered pictures times others, from their half spectra (Parseval)."""
    twice = np.full(spectrum.shape[1], 2.0)
    twice[0] = 1.0
    if size[1] % 2 == 0:
        twice[-1] = 1.0
    factor = spectrum * twice / (size[0] * size[1])
    left = (first * factor).reshape(len(first), -1).view(np.float64)
    right = second.astype(np.complex128).reshape(len(second), -1).view(np.float64)
    result: FloatArray = left @ right.T
    return result
